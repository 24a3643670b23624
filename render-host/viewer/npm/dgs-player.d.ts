import type { Engine } from "./engine.js";
import type { Overlay, Session } from "./session.js";

/** What an emulated network does to packets, and a server to a session. What is out of range is a RangeError. */
export interface Conditions {
  /** Share of packets lost, 0 to 0.9. */
  loss?: number;
  /**
   * Mean number of packets lost in a row, 1 to 100; at 1 losses are independent. Above 1 they are loss / (1 - loss) at
   * least, the shortest that lose so many.
   */
  burst?: number;
  /** Bits per second, 1000 to 1e9; 0 for all at once. */
  rate?: number;
  /** Seconds on the way to the viewer, 0 to 1; a round trip takes as much longer. */
  delay?: number;
  /** Which packets are lost: a whole number, 0 to 4294967295. */
  seed?: number;
  /** What chooses packets, of a server's session; "" is the server's own. */
  scheduler?: "" | "layered" | "dash" | "dependency" | "deadline-utility" | "deadline-utility-paper";
  /** Whether each round of a server's session begins as if nothing had arrived; true unless told otherwise. */
  anew?: boolean;
}

/** A stream as a server lists it. */
export interface ServedStream {
  name: string;
  file?: string;
  web_address?: string;
}

/** Azimuth, elevation (radians), distance, target x, y, z (scene units). */
export type View = [number, number, number, number, number, number];

export interface DgsPlayerEventMap extends Omit<HTMLElementEventMap, "progress"> {
  loadstart: Event;
  progress: Event;
  loadedmetadata: Event;
  load: Event;
  firstframe: Event;
  timeupdate: Event;
  play: Event;
  pause: Event;
  playing: Event;
  waiting: Event;
  seeked: Event;
  ended: Event;
  loop: Event;
  ratechange: Event;
  loopchange: Event;
  backgroundchange: Event;
  levelchange: Event;
  camerachange: Event;
  devicelost: Event;
  devicerestored: Event;
  error: ErrorEvent;
}

/**
 * `<dgs-player src time autoplay loop controls background quality up pixel-ratio worker adapt>`: like `<video>`, with
 * a camera. `worker="off"` decodes on the page's thread; `data-decoding` says where it is done, and why. `adapt="off"`
 * leaves nothing out where pictures come late.
 */
export class DgsPlayer extends HTMLElement {
  static wasmUrl: string | URL;
  src: string | null;
  /** The attribute: whether a stream plays as soon as it begins, unless less motion is preferred. */
  autoplay: boolean;
  /** The attribute: whether there is a bar. */
  controls: boolean;
  /** The attribute `pixel-ratio`: device pixels per CSS pixel; null for the display's own. */
  pixelRatio: number | null;
  /** Whether less is drawn where pictures come late: but for the attribute `adapt="off"`. */
  adaptive: boolean;
  /** The attribute: when streams begin, seconds. */
  time: number;
  currentTime: number;
  /** Seconds of the clip per second, -4 to 4. This and what follows hold for what is played next, too. */
  playbackRate: number;
  /** True but for `loop="false"`. */
  loop: boolean;
  /** Highest level shown: 0, 1, 2 or 3. Anything else is a RangeError. */
  quality: number;
  /** What blocks are painted by; see `session.d.ts`. */
  overlay: Overlay;
  /** Paints blocks by the next overlay. */
  nextOverlay(): void;
  /** `#rrggbb`. */
  background: string;
  /** The next of a few backgrounds, from black to white. */
  nextBackground(): void;
  /** Where the camera is. Kept for the next stream; null forgets what was kept. */
  view: View | null;
  readonly duration: number;
  /** When the first picture was drawn, milliseconds since the page began. */
  readonly firstFrameMs: number | null;
  readonly paused: boolean;
  readonly ended: boolean;
  /** Share of the stream that is there, 0 to 1: of a file's bytes, or of the packets of a server's manifest. */
  readonly buffered: number;
  readonly error: Error | null;
  readonly session: Session | null;
  readonly engine: Engine | null;
  play(): Promise<void>;
  pause(): void;
  toggle(): void;
  step(frames: number): void;
  home(): void;
  /** Plays a file in place of what is played, which goes on where that is none: a sentence says so for a while. */
  open(file: Blob | Uint8Array): Promise<void>;
  /** Plays a session that its maker goes on feeding. */
  receive(session: Session): Promise<void>;
  /**
   * A stream of `streams.json` of `dgs serve`; `transport` allows one alone. Once it has begun, a server that
   * goes away is tried again, after pauses of half a second to ten, until something else is played or the element
   * is removed.
   */
  playServed(stream: ServedStream, transport?: "live" | "streams" | "websocket" | "file" | null): Promise<void>;
  /**
   * Sets the network; a server that grants it changes its own link and scheduler for this session. Rejects with a
   * RangeError for what is out of range.
   */
  impair(conditions: Conditions): Promise<void>;
  toggleNetwork(): void;
  toggleFullscreen(): void;
  showHelp(): void;
  addEventListener<K extends keyof DgsPlayerEventMap>(
    type: K,
    listener: (this: DgsPlayer, event: DgsPlayerEventMap[K]) => unknown,
    options?: boolean | AddEventListenerOptions,
  ): void;
  addEventListener(
    type: string,
    listener: EventListenerOrEventListenerObject,
    options?: boolean | AddEventListenerOptions,
  ): void;
  removeEventListener<K extends keyof DgsPlayerEventMap>(
    type: K,
    listener: (this: DgsPlayer, event: DgsPlayerEventMap[K]) => unknown,
    options?: boolean | EventListenerOptions,
  ): void;
  removeEventListener(
    type: string,
    listener: EventListenerOrEventListenerObject,
    options?: boolean | EventListenerOptions,
  ): void;
}

declare global {
  interface HTMLElementTagNameMap {
    "dgs-player": DgsPlayer;
  }
}
