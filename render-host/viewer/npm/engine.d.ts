import type { Screen } from "./dgs_viewer.js";
import type { Session } from "./session.js";

/** What a browser that cannot draw is told. */
export const NO_WEBGPU: string;

/** Draws a session on a canvas, survives the loss of its device; its event `reduction` says that `session.reduced` is new. */
export class Engine extends EventTarget {
  constructor(canvas: HTMLCanvasElement);
  session: Session | null;
  readonly screen: Screen | null;
  readonly adapter: string;
  readonly aspect: number;
  /** Whether the clock waits for a base level. */
  readonly waiting: boolean;
  /** Bytes of WebAssembly and on the device. */
  readonly memory: { wasm: number; device: number };
  /** Device pixels per CSS pixel; `null` for the display's own. */
  pixelRatio: number | null;
  /** Frames drawn. */
  readonly frames: number;
  open(): Promise<void>;
  request(): void;
  /** Draws what is requested as soon as it is decoded. */
  drawNow(): Promise<void>;
  redraw(): void;
  close(): void;
}
