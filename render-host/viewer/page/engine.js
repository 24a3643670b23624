// The engine draws a session on a canvas when something has changed, and survives the loss of its device.

import { Screen, memoryBytes } from "./dgs_viewer.js";
import { load } from "./load.js";

/** What a browser that cannot draw is told. */
export const NO_WEBGPU =
  "This player needs WebGPU, which this browser does not offer here. Chrome or Edge 113, Safari 26 and Firefox 145 " +
  "have it, on pages served over https or from localhost.";

// Screens that are opened in vain before giving up, and what lies between two tries, milliseconds.
const TRIES = 4;
const PAUSE_MS = 150;
// A device may be lost while nothing is drawn: it is looked at this often, milliseconds.
const WATCH_MS = 250;
// Frames slower than this, seconds, for as many frames in a row, halve the pixels.
const SLOW_S = 1 / 18;
const SLOW_FRAMES = 20;
const SMALLEST_SCALE = 0.5;
// Frames that a device may be given before it has finished the first of them.
const MAX_PENDING = 2;

/**
 * Events: `firstframe`, `frame`, `time` (the clock has moved), `step` (detail: looped, ended, waiting, whether that has
 * turned), `devicelost`, `devicerestored`, `error`.
 */
export class Engine extends EventTarget {
  #canvas;
  #screen = null;
  #opening = null;
  #session = null;
  #request = 0;
  #last = 0;
  #drawn = "";
  #shown = false;
  #framesBefore = 0;
  #waiting = false;
  #watch;
  #resizes;
  #slow = 0;
  #scale = 1;
  // Seconds of frames that came quickly, how many are enough for more pixels, and whether there were more of late.
  #quickS = 0;
  #quickEnoughS = 5;
  #widened = false;
  #closed = false;
  /** Device pixels per CSS pixel; `null` for the display's own, lowered where frames come slowly. */
  pixelRatio = null;
  #finishedBefore = 0;

  constructor(canvas) {
    super();
    this.#canvas = canvas;
    this.#resizes = new ResizeObserver(() => this.request());
    this.#resizes.observe(canvas);
    this.#watch = setInterval(() => this.#look(), WATCH_MS);
  }

  /** The session that is shown; it becomes this engine's, which frees the one before. Null shows the last picture on. */
  set session(session) {
    this.#session?.free();
    this.#session = session;
    if (!session) return;
    session.answered = () => this.request();
    session.failed = (error) => this.dispatchEvent(new CustomEvent("error", { detail: error }));
    this.#shown = false;
    this.#framesBefore = this.frames + (this.#screen?.pending ?? 0);
    this.#drawn = "";
    this.request();
  }

  get session() {
    return this.#session;
  }

  /** Whether the clock waits for a base level. */
  get waiting() {
    return this.#waiting;
  }

  /** Frames that were drawn and that a device has finished. */
  get frames() {
    return this.#finishedBefore + (this.#screen?.finished ?? 0);
  }

  get screen() {
    return this.#screen;
  }

  get adapter() {
    return this.#screen?.adapter ?? "";
  }

  /** Width by height of the canvas on the screen. */
  get aspect() {
    const { clientWidth, clientHeight } = this.#canvas;
    return clientWidth > 0 && clientHeight > 0 ? clientWidth / clientHeight : 1;
  }

  /** Bytes of WebAssembly and on the device. */
  get memory() {
    return { wasm: memoryBytes() + (this.#session?.memory ?? 0), device: this.#screen?.bytes ?? 0 };
  }

  /** Opens a device; rejects with a sentence for people where there is none. */
  async open() {
    if (!navigator.gpu) throw new Error(NO_WEBGPU);
    this.#opening ??= this.#tryToOpen().finally(() => (this.#opening = null));
    await this.#opening;
  }

  async #tryToOpen() {
    let reason;
    for (let tried = 0; tried < TRIES && !this.#closed; tried++) {
      try {
        await load();
        const screen = await Screen.open(this.#canvas);
        if (this.#closed) return screen.free();
        this.#screen = screen;
        this.#session?.forget();
        this.#drawn = "";
        this.request();
        return;
      } catch (error) {
        reason = error;
        await new Promise((resolve) => setTimeout(resolve, PAUSE_MS * 2 ** tried));
      }
    }
    throw new Error(`The graphics device cannot be opened: ${reason?.message ?? reason}`);
  }

  /** Asks for a frame when the display next takes one. */
  request() {
    if (this.#request || this.#closed) return;
    this.#request = requestAnimationFrame((now) => this.#tick(now));
  }

  /**
   * Draws what is requested as soon as it is decoded: once the promise is kept, what is on the canvas can be
   * copied until control returns to the browser.
   */
  async drawNow() {
    if (this.#screen) await this.#session?.settle(this.#screen);
    this.#drawn = "";
    this.#draw();
  }

  #tick(now) {
    this.#request = 0;
    const session = this.#session;
    if (!session) return;
    const passed = this.#last ? (now - this.#last) / 1000 : 0;
    this.#last = now;
    const step = session.advance(passed);
    this.#say(step);
    // Whether or not a frame has come: the clock waits for base levels alone.
    if (session.playing) this.dispatchEvent(new Event("time"));
    const pending = this.#screen?.pending ?? 0;
    if (pending < MAX_PENDING) this.#update(now);
    this.#keepUp(session.playing ? passed : 0);
    if (!this.#shown && this.frames > this.#framesBefore) {
      this.#shown = true;
      this.dispatchEvent(new Event("firstframe"));
    }
    if (session.playing || session.busy || pending > 0 || (!this.#shown && this.#screen)) this.request();
    else this.#last = 0;
  }

  #say(step) {
    const waiting = (step & 4) !== 0;
    const turned = waiting !== this.#waiting;
    this.#waiting = waiting;
    if ((step & 3) !== 0 || turned) {
      const detail = { looped: (step & 1) !== 0, ended: (step & 2) !== 0, turned, waiting };
      this.dispatchEvent(new CustomEvent("step", { detail }));
    }
  }

  // Where frames come slowly, fewer pixels are drawn; once they have come quickly for a while, more again, and
  // after each time that that was too much, twice as long is waited.
  #keepUp(passed) {
    if (passed === 0 || this.pixelRatio !== null) return;
    const slow = passed > SLOW_S;
    this.#slow = slow ? this.#slow + 1 : 0;
    this.#quickS = slow ? 0 : this.#quickS + passed;
    if (this.#slow >= SLOW_FRAMES && this.#scale > SMALLEST_SCALE) {
      this.#scale = Math.max(SMALLEST_SCALE, this.#scale * 0.75);
      if (this.#widened) this.#quickEnoughS *= 2;
      [this.#slow, this.#quickS, this.#widened] = [0, 0, false];
    } else if (this.#quickS > this.#quickEnoughS && this.#scale < 1) {
      this.#scale = Math.min(1, this.#scale / 0.75);
      [this.#quickS, this.#widened] = [0, true];
    }
  }

  #size() {
    const ratio = this.pixelRatio ?? Math.min(devicePixelRatio, 2) * this.#scale;
    const { clientWidth, clientHeight } = this.#canvas;
    const most = this.#screen ? 8192 : 1;
    const side = (css) => Math.max(1, Math.min(most, Math.round(css * ratio)));
    return [side(clientWidth), side(clientHeight)];
  }

  // Asks for the frame that is due, and draws what has come.
  #update(now) {
    try {
      const screen = this.#screen?.lost ? null : this.#screen;
      this.#session.update(now, screen);
      this.#draw();
    } catch (error) {
      if (!this.#screen?.lost) this.dispatchEvent(new CustomEvent("error", { detail: error }));
    }
  }

  #draw() {
    const [session, screen] = [this.#session, this.#screen];
    if (!session || !screen || screen.lost || session.uploads === 0) return;
    const [width, height] = this.#size();
    const state = `${session.uploads} ${session.view} ${session.up} ${width} ${height}`;
    if (state === this.#drawn && !screen.stale) return;
    if (this.#canvas.width !== width) this.#canvas.width = width;
    if (this.#canvas.height !== height) this.#canvas.height = height;
    screen.draw(session, width, height);
    this.#drawn = state;
    this.dispatchEvent(new Event("frame"));
  }

  /** Forgets what is drawn: something that no number shows has changed, as the background. */
  redraw() {
    this.#drawn = "";
    this.request();
  }

  #look() {
    const screen = this.#screen;
    if (!screen) return;
    if (!screen.lost) {
      if (screen.stale) this.request();
      return;
    }
    this.#finishedBefore = this.#framesBefore = this.frames;
    this.#screen = null;
    this.dispatchEvent(new Event("devicelost"));
    screen.free();
    this.open().then(
      () => this.dispatchEvent(new Event("devicerestored")),
      (error) => this.dispatchEvent(new CustomEvent("error", { detail: error })),
    );
  }

  /** Frees the device and the stream. */
  close() {
    this.#closed = true;
    clearInterval(this.#watch);
    cancelAnimationFrame(this.#request);
    this.#resizes.disconnect();
    this.#session?.free();
    this.#screen?.free();
    this.#session = this.#screen = null;
  }
}
