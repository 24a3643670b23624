/* tslint:disable */
/* eslint-disable */

/**
 * Clock, camera and background of a viewer, and what it leaves out to keep up, for JavaScript.
 */
export class Controls {
    free(): void;
    [Symbol.dispose](): void;
    /**
     * Lets `dt` seconds pass: 1 the clip began again, 2 it ended, 4 it waits for a base level, or nothing of
     * these. It waits up to `base_timeout` seconds for frames of `missing`: first and past of each range.
     */
    advance(dt_s: number, base_timeout_s: number, missing: Uint32Array | number[]): number;
    /**
     * A picture came at `now_s` that had been due for `waited_s` seconds.
     */
    came(now_s: number, waited_s: number): void;
    /**
     * The camera of a picture: rotation (9, row by row), translation (3), focal lengths and principal point,
     * near plane. For tests.
     */
    camera(width: number, height: number): Float64Array;
    /**
     * What is drawn now: share of the pixels of width and of height, degree of harmonics, highest level,
     * share of the Gaussians.
     */
    drawnNow(): Float64Array;
    /**
     * Moves right, up, forward, in shares of the distance.
     */
    fly(right: number, up: number, forward: number): void;
    /**
     * Back to the view it began with.
     */
    home(aspect: number): void;
    /**
     * Moves the camera so that what lies within `radius` of a middle is in a picture `aspect` times as wide
     * as high; `up` is `y`, `minus-z` and so on.
     */
    lookAround(middle: Float64Array | number[], radius: number, aspect: number, up: string): void;
    /**
     * It is `now_s`: true while the clock runs or the camera moves, and less may be drawn. What is drawn at
     * most: harmonics of this degree, levels up to `cap`, the pixels as they are if they are fixed.
     */
    look(now_s: number, sh_degree: number, cap: number, fixed_pixels: boolean): boolean;
    /**
     * For a clip of `frames` frames at `rate` of them a second, standing at its beginning.
     */
    constructor(frames: number, rate: number);
    /**
     * Takes the next way up, and its name.
     */
    nextUp(): string;
    /**
     * Pans by a drag, pixels.
     */
    pan(dx: number, dy: number, height: number): void;
    /**
     * Nothing moves: the next picture is whole.
     */
    rest(): void;
    /**
     * Sets the colour behind everything, 0 to 1 each.
     */
    setBackground(red: number, green: number, blue: number): void;
    /**
     * Takes the way up of this name; false for what is none.
     */
    setUp(up: string): boolean;
    /**
     * Takes a view; false for numbers that are none.
     */
    setView(view: Float64Array | number[]): boolean;
    /**
     * Goes `frames` frames on and stands.
     */
    step(frames: number): void;
    /**
     * Turns by a drag, pixels.
     */
    turn(dx: number, dy: number, height: number): void;
    /**
     * Comes so many times as near.
     */
    zoom(factor: number): void;
    /**
     * Length of the clip, seconds.
     */
    readonly duration: number;
    /**
     * The frame that is due.
     */
    readonly frame: number;
    /**
     * Whether less is drawn where pictures come late.
     */
    keepsUp: boolean;
    /**
     * Whether the clip begins again at its end.
     */
    looping: boolean;
    /**
     * Whether the clock runs.
     */
    playing: boolean;
    /**
     * Seconds of the clip per second.
     */
    rate: number;
    /**
     * What is left out now, for people; empty for nothing.
     */
    readonly reduced: string;
    /**
     * Where the clock is, seconds.
     */
    time: number;
    /**
     * Which way is up.
     */
    readonly up: string;
    /**
     * The view: azimuth, elevation, distance, target.
     */
    readonly view: Float64Array;
}

/**
 * One stream; its clock and camera are [`Controls`](super::Controls).
 */
export class Decoder {
    private constructor();
    free(): void;
    [Symbol.dispose](): void;
    /**
     * Where the Gaussians of the frame are: their middle (3), and a radius; nothing if none of them is seen.
     */
    bounds(): Float64Array;
    /**
     * Sets the highest level shown, 0 to 3, and what blocks are painted by: the place of an [`Overlay`]
     * among all of them.
     */
    choose(cap: number, overlay: number): void;
    /**
     * Copies what was packed to `into`, which is as long.
     */
    copyPacked(into: Float32Array): void;
    /**
     * Lets the emulated network deliver; true while packets are on their way.
     */
    deliver(now_s: number): boolean;
    /**
     * A file of `length` bytes that begins with `first`, which hold its manifest; the rest is `wanted`.
     */
    static fetch(first: Uint8Array | number[], length: number): Decoder;
    /**
     * Goes to frame `frame`.
     */
    goTo(frame: number): void;
    /**
     * Puts an emulated network before the player: share lost, mean run of losses, bits per second (0 for all
     * at once), seconds of delay, seed.
     */
    impair(loss: number, burst: number, rate_bps: number, delay_s: number, seed: number): void;
    /**
     * Frames, frames per second, most Gaussians of a frame, packets of the stream.
     */
    info(): Float64Array;
    /**
     * Blocks of the frame by level: proxies, base, refinements 1 to 3.
     */
    levels(): Uint32Array;
    /**
     * Looks from where the controls do, which receipts may tell: their view, and which way is up. What is no
     * view changes nothing.
     */
    look(view: Float64Array | number[], up: string): void;
    /**
     * Frames whose base a clock waits for: first and past of each range.
     */
    missing(): Uint32Array;
    /**
     * The `.dgs` file of these bytes.
     */
    static open(file: Uint8Array | number[]): Decoder;
    /**
     * Decodes and packs the Gaussians of the frame; nothing where they are those that were packed last, and
     * not wanted `anew`.
     */
    pack(anew: boolean): Picture | undefined;
    /**
     * Packets that came, those that were decoded, and bytes that the emulated network has delivered.
     */
    packets(): Float64Array;
    /**
     * Takes a packet that a server sent.
     */
    push(packet: Uint8Array | number[]): void;
    /**
     * An estimate of how good the frame last packed is, from what of it has come: 0 to 1.
     */
    quality(): number;
    /**
     * A receipt for the server: its number, and when the first frame of the round was shown, microseconds
     * since the round began; 0 before.
     */
    receipt(sequence: number, playout_us: number): Uint8Array;
    /**
     * A stream that a server sends: its DGSM message.
     */
    static receive(message: Uint8Array | number[]): Decoder;
    /**
     * Decodes no level above `cap`, and gives the `share` of Gaussians that can cover most, above 0 and up
     * to 1.
     */
    reduce(cap: number, share: number): void;
    /**
     * Forgets every packet: the server begins as if nothing had arrived.
     */
    restart(): void;
    /**
     * When the first frame is due of the round that the server sends for `time`, seconds.
     */
    roundStart(time_s: number): number;
    /**
     * Takes the whole file after all.
     */
    takeWhole(file: Uint8Array | number[]): void;
    /**
     * Takes bytes of the file from offset `at` on.
     */
    take(at: number, bytes: Uint8Array | number[]): void;
    /**
     * Which bytes to ask for next: first and past; one number for the whole file; none when all is there.
     */
    wanted(): Float64Array;
    /**
     * How long a clock waits for a base level, seconds.
     */
    readonly base_timeout: number;
    /**
     * What of the file, as far as it is there, could not be used; empty for a whole one.
     */
    readonly damage: string;
    /**
     * Degree of the harmonics of its Gaussians.
     */
    readonly degree: number;
    /**
     * Whether something was packed in a colour that changes with time.
     */
    readonly fading: boolean;
    /**
     * The number of the footprint that Gaussians are drawn with.
     */
    readonly footprint: number;
    /**
     * Whether anything has come of what is shown at the frame.
     */
    readonly hasCome: boolean;
    /**
     * Share of the file that is there.
     */
    readonly loaded: number;
    /**
     * Which way is up: `y`, `minus-z` and so on.
     */
    readonly up: string;
}

/**
 * Gaussians of a frame, packed.
 */
export class Picture {
    private constructor();
    free(): void;
    [Symbol.dispose](): void;
    /**
     * Bytes of all.
     */
    readonly bytes: number;
    /**
     * Number of Gaussians.
     */
    readonly count: number;
    /**
     * Degree of their harmonics.
     */
    readonly degree: number;
    /**
     * Whether harmonics are left out, being those of the picture before.
     */
    readonly onlyMoved: boolean;
}

/**
 * A canvas with a device.
 */
export class Screen {
    private constructor();
    free(): void;
    [Symbol.dispose](): void;
    /**
     * Gives the device up, as a browser may at any time: for tests.
     */
    destroy(): void;
    /**
     * Draws what was uploaded on `width` × `height` pixels.
     */
    draw(controls: Controls, width: number, height: number): void;
    /**
     * Opens a device that can draw on `canvas`.
     */
    static open(canvas: HTMLCanvasElement): Promise<Screen>;
    /**
     * Uploads a picture that a decoder has packed: number of Gaussians, degree of their harmonics, whether
     * these are left out, the bytes; and the number of the footprint that its Gaussians are drawn with.
     */
    upload(count: number, degree: number, only_moved: boolean, footprint: number, bytes: Uint8Array | number[]): void;
    /**
     * Name of the adapter; empty where the browser keeps it to itself.
     */
    readonly adapter: string;
    /**
     * Bytes on the device.
     */
    readonly bytes: number;
    /**
     * Frames that the device has finished.
     */
    readonly finished: number;
    /**
     * Whether the device is gone: open another screen on the canvas.
     */
    readonly lost: boolean;
    /**
     * Frames that it still draws.
     */
    readonly pending: number;
    /**
     * Whether the last picture was not whole: draw again.
     */
    readonly stale: boolean;
}

/**
 * Bytes to ask for first when a file is fetched in pieces.
 */
export function firstBytes(): number;

/**
 * How many bytes of a file are needed for its manifest, which begins with `first`; 0 when they are there.
 */
export function manifestBytes(first: Uint8Array | number[]): number;

/**
 * Bytes of WebAssembly memory.
 */
export function memoryBytes(): number;

/**
 * Colours that blocks are painted in by the overlay at this place among all, r g b of 0 to 1 each: of
 * levels, proxies, base, refinements; else from the most to the least.
 */
export function overlayColours(overlay: number): Float32Array;

export type InitInput = RequestInfo | URL | Response | BufferSource | WebAssembly.Module;

export interface InitOutput {
    readonly memory: WebAssembly.Memory;
    readonly __wbg_controls_free: (a: number, b: number) => void;
    readonly __wbg_decoder_free: (a: number, b: number) => void;
    readonly __wbg_get_picture_bytes: (a: number) => number;
    readonly __wbg_get_picture_count: (a: number) => number;
    readonly __wbg_get_picture_degree: (a: number) => number;
    readonly __wbg_get_picture_onlyMoved: (a: number) => number;
    readonly __wbg_picture_free: (a: number, b: number) => void;
    readonly __wbg_screen_free: (a: number, b: number) => void;
    readonly controls_advance: (a: number, b: number, c: number, d: number, e: number) => number;
    readonly controls_came: (a: number, b: number, c: number) => void;
    readonly controls_camera: (a: number, b: number, c: number) => [number, number, number, number];
    readonly controls_drawnNow: (a: number) => [number, number];
    readonly controls_duration: (a: number) => number;
    readonly controls_fly: (a: number, b: number, c: number, d: number) => void;
    readonly controls_frame: (a: number) => number;
    readonly controls_home: (a: number, b: number) => void;
    readonly controls_keepsUp: (a: number) => number;
    readonly controls_look: (a: number, b: number, c: number, d: number, e: number) => number;
    readonly controls_lookAround: (a: number, b: number, c: number, d: number, e: number, f: number, g: number) => [number, number];
    readonly controls_looping: (a: number) => number;
    readonly controls_new: (a: number, b: number) => number;
    readonly controls_nextUp: (a: number) => [number, number];
    readonly controls_pan: (a: number, b: number, c: number, d: number) => void;
    readonly controls_playing: (a: number) => number;
    readonly controls_rate: (a: number) => number;
    readonly controls_reduced: (a: number) => [number, number];
    readonly controls_rest: (a: number) => void;
    readonly controls_setBackground: (a: number, b: number, c: number, d: number) => void;
    readonly controls_setUp: (a: number, b: number, c: number) => number;
    readonly controls_setView: (a: number, b: number, c: number) => number;
    readonly controls_set_keepsUp: (a: number, b: number) => void;
    readonly controls_set_looping: (a: number, b: number) => void;
    readonly controls_set_playing: (a: number, b: number) => void;
    readonly controls_set_rate: (a: number, b: number) => void;
    readonly controls_set_time: (a: number, b: number) => void;
    readonly controls_step: (a: number, b: number) => void;
    readonly controls_time: (a: number) => number;
    readonly controls_turn: (a: number, b: number, c: number, d: number) => void;
    readonly controls_up: (a: number) => [number, number];
    readonly controls_view: (a: number) => [number, number];
    readonly controls_zoom: (a: number, b: number) => void;
    readonly decoder_base_timeout: (a: number) => number;
    readonly decoder_bounds: (a: number) => [number, number, number, number];
    readonly decoder_choose: (a: number, b: number, c: number) => void;
    readonly decoder_copyPacked: (a: number, b: any) => [number, number];
    readonly decoder_damage: (a: number) => [number, number];
    readonly decoder_degree: (a: number) => number;
    readonly decoder_deliver: (a: number, b: number) => number;
    readonly decoder_fading: (a: number) => number;
    readonly decoder_fetch: (a: number, b: number, c: number) => [number, number, number];
    readonly decoder_footprint: (a: number) => number;
    readonly decoder_goTo: (a: number, b: number) => void;
    readonly decoder_hasCome: (a: number) => number;
    readonly decoder_impair: (a: number, b: number, c: number, d: number, e: number, f: number) => [number, number];
    readonly decoder_info: (a: number) => [number, number];
    readonly decoder_levels: (a: number) => [number, number, number, number];
    readonly decoder_loaded: (a: number) => number;
    readonly decoder_look: (a: number, b: number, c: number, d: number, e: number) => void;
    readonly decoder_missing: (a: number) => [number, number];
    readonly decoder_open: (a: number, b: number) => [number, number, number];
    readonly decoder_pack: (a: number, b: number) => [number, number, number];
    readonly decoder_packets: (a: number) => [number, number];
    readonly decoder_push: (a: number, b: number, c: number) => void;
    readonly decoder_quality: (a: number) => number;
    readonly decoder_receipt: (a: number, b: number, c: number) => [number, number, number, number];
    readonly decoder_receive: (a: number, b: number) => [number, number, number];
    readonly decoder_reduce: (a: number, b: number, c: number) => void;
    readonly decoder_restart: (a: number) => [number, number];
    readonly decoder_roundStart: (a: number, b: number) => number;
    readonly decoder_take: (a: number, b: number, c: number, d: number) => void;
    readonly decoder_takeWhole: (a: number, b: number, c: number) => [number, number];
    readonly decoder_up: (a: number) => [number, number];
    readonly decoder_wanted: (a: number) => [number, number];
    readonly firstBytes: () => number;
    readonly manifestBytes: (a: number, b: number) => [number, number, number];
    readonly memoryBytes: () => number;
    readonly overlayColours: (a: number) => [number, number];
    readonly screen_adapter: (a: number) => [number, number];
    readonly screen_bytes: (a: number) => number;
    readonly screen_destroy: (a: number) => void;
    readonly screen_draw: (a: number, b: number, c: number, d: number) => [number, number];
    readonly screen_finished: (a: number) => number;
    readonly screen_lost: (a: number) => number;
    readonly screen_open: (a: any) => any;
    readonly screen_pending: (a: number) => number;
    readonly screen_stale: (a: number) => number;
    readonly screen_upload: (a: number, b: number, c: number, d: number, e: number, f: number, g: number) => [number, number];
    readonly wasm_bindgen__convert__closures_____invoke__h3a3cc99aafc18d64: (a: number, b: number, c: any, d: any) => void;
    readonly wasm_bindgen__convert__closures_____invoke__h4b3a6ba54fdd672b: (a: number, b: number, c: any) => [number, number];
    readonly wasm_bindgen__convert__closures_____invoke__h4b3a6ba54fdd672b_85: (a: number, b: number, c: any) => [number, number];
    readonly wasm_bindgen__convert__closures_____invoke__h4b3a6ba54fdd672b_88: (a: number, b: number, c: any) => [number, number];
    readonly wasm_bindgen__convert__closures_____invoke__h4b3a6ba54fdd672b_89: (a: number, b: number, c: any) => [number, number];
    readonly wasm_bindgen__convert__closures_____invoke__h0ae33fcf43171043: (a: number, b: number, c: any) => void;
    readonly wasm_bindgen__convert__closures_____invoke__h0ae33fcf43171043_87: (a: number, b: number, c: any) => void;
    readonly __wbindgen_malloc: (a: number, b: number) => number;
    readonly __wbindgen_realloc: (a: number, b: number, c: number, d: number) => number;
    readonly __wbindgen_free: (a: number, b: number, c: number) => void;
    readonly __wbindgen_exn_store: (a: number) => void;
    readonly __externref_table_alloc: () => number;
    readonly __wbindgen_externrefs: WebAssembly.Table;
    readonly __wbindgen_destroy_closure: (a: number, b: number) => void;
    readonly __externref_table_dealloc: (a: number) => void;
    readonly __wbindgen_start: () => void;
}

export type SyncInitInput = BufferSource | WebAssembly.Module;

/**
 * Instantiates the given `module`, which can either be bytes or
 * a precompiled `WebAssembly.Module`.
 *
 * @param {{ module: SyncInitInput }} module - Passing `SyncInitInput` directly is deprecated.
 *
 * @returns {InitOutput}
 */
export function initSync(module: { module: SyncInitInput } | SyncInitInput): InitOutput;

/**
 * If `module_or_path` is {RequestInfo} or {URL}, makes a request and
 * for everything else, calls `WebAssembly.instantiate` directly.
 *
 * @param {{ module_or_path: InitInput | Promise<InitInput> }} module_or_path - Passing `InitInput` directly is deprecated.
 *
 * @returns {Promise<InitOutput>}
 */
export default function __wbg_init (module_or_path?: { module_or_path: InitInput | Promise<InitInput> } | InitInput | Promise<InitInput>): Promise<InitOutput>;
