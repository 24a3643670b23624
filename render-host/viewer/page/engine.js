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
// Longest time between two pictures of a display that is no sign of being late, milliseconds.
const LONGEST_PERIOD_MS = 34;
// Frames that a device may be given before it has finished the first of them.
const MAX_PENDING = 2;

/**
 * Events: `firstframe`, `frame`, `time` (the clock has moved), `step` (detail: looped, ended, waiting, whether that has
 * turned), `reduction` (something else is left out of pictures), `devicelost`, `devicerestored`, `error`.
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
  // Since when there is something to draw that is not drawn, milliseconds; null where there is nothing.
  #dueSince = null;
  // When a picture was drawn last, and the shortest time between two turns, milliseconds: that of the display.
  #drawnAt = 0;
  #period = LONGEST_PERIOD_MS;
  // What is left out of pictures, as last said.
  #reduced = "";
  #closed = false;
  /** Device pixels per CSS pixel; `null` for the display's own, of which fewer are drawn where pictures come late. */
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
    this.#dueSince = null;
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
    this.#session?.rest();
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
    const moves = session.moves(now, this.pixelRatio !== null);
    this.#noteDue(now, 1000 * passed);
    if (pending < MAX_PENDING) this.#update(now);
    this.#sayReduction();
    if (!this.#shown && this.frames > this.#framesBefore) {
      this.#shown = true;
      this.dispatchEvent(new Event("firstframe"));
    }
    if (moves || session.busy || pending > 0 || (!this.#shown && this.#screen)) this.request();
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

  // Notes since when something is to be drawn that is not: how late a picture comes says what to leave out of the next.
  // What is found after a turn that came late was to be drawn when it should have come.
  #noteDue(now, passed) {
    if (passed > 0) this.#period = Math.min(this.#period, passed);
    const isDue = this.#shown && (!this.#session.settled || this.#state().text !== this.#drawn);
    this.#dueSince = isDue ? (this.#dueSince ?? Math.min(now, now - passed + this.#period)) : null;
  }

  #sayReduction() {
    const { reduced } = this.#session;
    if (reduced === this.#reduced) return;
    this.#reduced = reduced;
    this.dispatchEvent(new Event("reduction"));
  }

  #size() {
    const ratio = this.pixelRatio ?? Math.min(devicePixelRatio, 2) * this.#session.drawn.scale;
    const { clientWidth, clientHeight } = this.#canvas;
    const most = this.#screen ? 8192 : 1;
    const side = (css) => Math.max(1, Math.min(most, Math.round(css * ratio)));
    return [side(clientWidth), side(clientHeight)];
  }

  // What a picture depends on, as text, and its size.
  #state() {
    const [{ uploads, view, up, drawn }, [width, height]] = [this.#session, this.#size()];
    return { width, height, text: `${uploads} ${view} ${up} ${width} ${height} ${drawn.degree}` };
  }

  // Asks for the frame that is due, and draws what has come.
  #update(now) {
    try {
      const screen = this.#screen?.lost ? null : this.#screen;
      this.#session.update(now, screen);
      this.#draw(now);
    } catch (error) {
      if (!this.#screen?.lost) this.dispatchEvent(new CustomEvent("error", { detail: error }));
    }
  }

  #draw(now = null) {
    const [session, screen] = [this.#session, this.#screen];
    if (!session || !screen || screen.lost || session.uploads === 0) return;
    const { width, height, text } = this.#state();
    if (text === this.#drawn && !screen.stale) return;
    if (this.#canvas.width !== width) this.#canvas.width = width;
    if (this.#canvas.height !== height) this.#canvas.height = height;
    screen.draw(session, width, height);
    this.#drawn = text;
    if (now !== null && this.#dueSince !== null) session.cameLate(now, now - Math.max(this.#dueSince, this.#drawnAt));
    this.#dueSince = now !== null && !session.settled ? now : null;
    this.#drawnAt = now ?? performance.now();
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
    [this.#screen, this.#dueSince] = [null, null];
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
