import type { Conditions } from "./dgs-player.js";
import { Controls } from "./dgs_viewer.js";

/** What of conditions holds: the link at the server, and its scheduler. */
export interface Granted {
  link: boolean;
  scheduler: boolean;
}

/**
 * What blocks are painted by: nothing, the level that they are shown at, how long ago a level came (bright to dark
 * over a second), or the utility of what has not come.
 */
export type Overlay = "none" | "levels" | "arrivals" | "missing";

/** All of them, in the order in which the key O goes through them. */
export const OVERLAYS: readonly Overlay[];

/** Levels there are, base included. */
export const LEVELS: 4;

/** Names of what blocks are shown at: stand-ins, base, refinements. */
export const LEVEL_NAMES: readonly string[];

/** What is drawn: share of the pixels of a side, degree of harmonics, highest level, share of the Gaussians. */
export interface Drawn {
  scale: number;
  degree: number;
  cap: number;
  share: number;
}

/** Where to decode: `worker: false` for the thread of the page. */
export interface DecodingOptions {
  worker?: boolean;
}

/** A stream that is shown: clock and camera on the page's thread, packets and Gaussians with its decoder. */
export class Session extends Controls {
  private constructor();
  /** The `.dgs` file of these bytes, which are given away. */
  static open(bytes: Uint8Array, options?: DecodingOptions): Promise<Session>;
  /** A file of `length` bytes that begins with `first`, which hold its manifest; the rest is `wanted`. */
  static fetch(first: Uint8Array, length: number, options?: DecodingOptions): Promise<Session>;
  /** A stream that a server sends: its DGSM message. */
  static receive(message: Uint8Array, options?: DecodingOptions): Promise<Session>;
  /** Where it is decoded: `worker`, or `page` and the reason. */
  readonly decoding: string;
  /** What of the file, as far as it is there, could not be used; empty for a whole one. */
  readonly damage: string;
  /** Share of the file that is there; of what a server sends, the share of its packets, as last answered. */
  readonly loaded: number;
  /** Highest level shown: 0, 1, 2 or 3. Anything else is a RangeError. */
  cap: number;
  /** What blocks are painted by. Anything else is a RangeError. */
  overlay: Overlay;
  /** What is drawn now: less where pictures come late, unless `keepsUp` is false. `reduced` says it to people. */
  readonly drawn: Drawn;
  /** It is `now`, milliseconds, and the number of pixels is fixed or not: true while anything moves. */
  moves(now: number, pixelsAreFixed: boolean): boolean;
  /** A picture came at `now` that had been due for `waited`, milliseconds. */
  cameLate(now: number, waited: number): void;
  /** Whether the clock waits for whoever makes the stream: it was ahead of what there is. */
  readonly isAhead: boolean;
  /** Whether packets are on their way through the emulated network. */
  readonly busy: boolean;
  /** Whether the screen has the picture of what is requested. */
  readonly settled: boolean;
  /** Packets that wait for the decoder. */
  readonly waiting: number;
  /** Pictures uploaded to the screen that there is. */
  readonly uploads: number;
  /** Frames, frames per second, most Gaussians of a frame, packets of the stream. */
  info(): [number, number, number, number];
  /** Blocks of the frame by level, as last answered: proxies, base, refinements 1 to 3. */
  levels(): Uint32Array;
  /** Packets that came, those that were decoded, and bytes that the emulated network has delivered, as last answered. */
  packets(): Float64Array;
  /** Takes a packet; the promise is kept once the decoder has it. */
  push(packet: Uint8Array): Promise<void>;
  /** Which bytes to ask for next: first and past; one number for the whole file; none when all is there. */
  wanted(): Promise<number[]>;
  /** Takes bytes of the file from offset `at` on; they are given away. */
  take(at: number, bytes: Uint8Array): Promise<void>;
  /** Takes the whole file after all; its bytes are given away. */
  takeWhole(bytes: Uint8Array): Promise<void>;
  /** A receipt for the server: its number, and when the first frame of the round was shown, microseconds. */
  receipt(sequence: number, playout: number): Promise<Uint8Array>;
  /** When the first frame is due of the round that the server sends for `time`, seconds. */
  roundStart(time: number): Promise<number>;
  /** An estimate of how good the frame is, whatever the cap, from what of it has come: 0 to 1, as last answered. */
  readonly estimatedQuality: number;
  /**
   * Asks whoever sends for other conditions: resolves with what is granted, or with null where a later request
   * took its place. Null where nobody does.
   */
  server: ((conditions: Conditions) => Promise<Granted | null>) | null;
  /** Puts an emulated network before the decoder; throws a RangeError for what is out of range. */
  impair(conditions?: Pick<Conditions, "loss" | "burst" | "rate" | "delay" | "seed">): void;
  /**
   * Asks whoever sends for `conditions`; what is not granted of the network is emulated here. Rejects with a RangeError
   * for what is out of range.
   */
  setConditions(conditions: Conditions): Promise<Granted | null>;
  /** Forgets every packet: the server begins as if nothing had arrived. */
  restart(): Promise<void>;
  /** Which way is up, as the stream says: `y`, `minus-z` and so on. */
  readonly upOfStream: string;
  /**
   * Moves the camera so that every Gaussian of the frame is in the picture; where none has come yet, once some have,
   * unless the view is another by then.
   */
  lookAtAll(aspect: number, up: string): Promise<void>;
}
