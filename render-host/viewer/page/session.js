// A session is a stream that is shown: clock and camera here, packets and Gaussians with its decoder.

import { checkedConditions, meanBurst } from "./conditions.js";
import { Controls } from "./dgs_viewer.js";
import { Decoding } from "./decoding.js";

/** Levels there are, base included. */
export const LEVELS = 4;
/** Packets that may wait for the decoder before whoever brings them should wait, too. */
export const MAX_WAITING = 1024;
// Questions to the decoder that the picture of what is requested may take.
const MAX_ROUNDS = 8;
// What `advance` says of a clock that waits.
const WAITING = 4;

// What blocks can be painted by, in the decoder's order.
export const OVERLAYS = ["none", "levels", "arrivals", "missing"];

/** What blocks are shown at: stand-ins, base, refinements. */
export const LEVEL_NAMES = ["stand-ins", "base", "level 1", "level 2", "level 3"];

/** `overlay`, if it is one. */
export function checkedOverlay(overlay) {
  if (OVERLAYS.includes(overlay)) return overlay;
  throw new RangeError(`overlay: ${overlay}; ${OVERLAYS.join(", ")} are allowed`);
}

/** `level`, if it can be the highest shown: what is set by `name`. */
export function checkedLevel(name, level) {
  if (/^\d$/.test(level) && level < LEVELS) return Number(level);
  throw new RangeError(`${name}: ${level}; whole numbers from 0 to ${LEVELS - 1} are allowed`);
}

// A network that does nothing.
const PERFECT = { loss: 0, burst: 1, rate: 0, delay: 0, seed: 1 };

export class Session extends Controls {
  /** Whether the stream grows while it is shown: its end is waited for. */
  grows = false;
  #decoding;
  #facts;
  #cap = LEVELS - 1;
  #overlay = OVERLAYS[0];
  // Share of the file that is there; null of a stream that a server sends.
  #loaded;
  #damage;
  // What the decoder said last, besides pictures.
  #state;
  // Whether anything had come of the frame that it was asked for, and where the last of those ends of which any
  // had.
  #hasCome = true;
  #seenUntil = 0;
  // How the camera was placed where there was nothing to look at yet: width by height, the view, packets that
  // were decoded by then, and whether any have shown something since. Null once it is known where things are.
  #unframed = null;
  // Counts what changes pictures besides frame, cap and overlay.
  #changes = 0;
  // What the last request asked for, and what the last picture on the screen answers.
  #requested = "";
  #shown = "";
  #uploads = 0;
  #anew = true;
  // One request is under way at most, and one answer waits to be uploaded.
  #pending = null;
  #answer = null;
  #buffer = null;
  #packets = [];
  #pushing = null;
  #freed = false;
  // The emulated network before the decoder, as text.
  #network = JSON.stringify(PERFECT);
  /**
   * Asks whoever sends for other conditions, if one does that takes requests: resolves with what is granted,
   * `{ link, scheduler }`, or with null where a later request took its place.
   */
  server = null;
  /** Whether the clock waits for whoever makes the stream: it was ahead of what there is. */
  isAhead = false;
  /** Called when an answer has come, and when the decoder fails. */
  answered = () => {};
  failed = () => {};

  /** The `.dgs` file of these bytes, which are given away. `worker: false` decodes on the page's thread. */
  static open(bytes, options) {
    return Session.#make({ how: "open", bytes }, options);
  }

  /** A file of `length` bytes that begins with `first`, which hold its manifest; the rest is `wanted`. */
  static fetch(first, length, options) {
    return Session.#make({ how: "fetch", bytes: first, length }, options);
  }

  /** A stream that a server sends: its DGSM message. */
  static receive(message, options) {
    return Session.#make({ how: "receive", bytes: message.slice() }, options);
  }

  static async #make(given, { worker = true } = {}) {
    const decoding = await Decoding.open(worker);
    try {
      const facts = await decoding.ask("make", given, [given.bytes.buffer]);
      return new Session(decoding, given.how === "receive" ? { ...facts, loaded: null } : facts);
    } catch (error) {
      decoding.close();
      throw error;
    }
  }

  constructor(decoding, facts) {
    super(facts.frames, facts.rate);
    this.#decoding = decoding;
    this.#facts = facts;
    this.#take(facts);
    this.#state = facts.state;
  }

  /** Where it is decoded: `worker`, or `page` and the reason. */
  get decoding() {
    return this.#decoding.where;
  }

  /** Frames, frames per second, most Gaussians of a frame, packets of the stream. */
  info() {
    const { frames, rate, gaussians, packets } = this.#facts;
    return [frames, rate, gaussians, packets];
  }

  /** Which way is up, as the stream says: `y`, `minus-z` and so on. */
  get upOfStream() {
    return this.#facts.up;
  }

  /** What of the file, as far as it is there, could not be used; empty for a whole one. */
  get damage() {
    return this.#damage;
  }

  /** Share of the file that is there; of what a server sends, the share of its packets, as last answered. */
  get loaded() {
    return this.#loaded ?? Math.min(1, this.#state.packets[1] / Math.max(1, this.#facts.packets));
  }

  /** Highest level shown, 0 to 3. */
  get cap() {
    return this.#cap;
  }

  set cap(level) {
    this.#cap = checkedLevel("cap", level);
  }

  /** What blocks are painted by: one of OVERLAYS. */
  get overlay() {
    return this.#overlay;
  }

  set overlay(overlay) {
    this.#overlay = checkedOverlay(overlay);
  }

  /** Whether packets are on their way through the emulated network. */
  get busy() {
    return this.#state.busy;
  }

  /** Blocks of the frame by level, as last answered: proxies, base, refinements 1 to 3. */
  levels() {
    return this.#state.levels;
  }

  /** An estimate of how good the frame is, whatever the cap, from what of it has come: 0 to 1, as last answered. */
  get estimatedQuality() {
    return this.#state.quality;
  }

  /** Packets that came, and those that were decoded, as last answered. */
  packets() {
    return this.#state.packets;
  }

  /** Bytes of WebAssembly in a worker; 0 where it shares the page's. */
  get memory() {
    return this.decoding === "worker" ? this.#state.memory : 0;
  }

  /** Pictures uploaded to the screen that there is. */
  get uploads() {
    return this.#uploads;
  }

  /** Whether the screen has the picture of what is requested. */
  get settled() {
    return this.#shown === this.#target() && this.#packets.length === 0;
  }

  #target() {
    const { cap, share } = this.drawn;
    return `${this.frame} ${this.#cap} ${this.#overlay} ${this.#changes} ${cap} ${share}`;
  }

  /** What is drawn now: share of the pixels of a side, degree of harmonics, highest level, share of Gaussians. */
  get drawn() {
    const [scale, degree, cap, share] = this.drawnNow();
    return { scale, degree, cap, share };
  }

  /** It is `now`, milliseconds; the number of pixels is fixed or not: true while anything moves. See `Controls`. */
  moves(now, pixelsAreFixed) {
    return this.look(now / 1000, this.#facts.degree, this.#cap, pixelsAreFixed);
  }

  /** A picture came at `now` that had been due for `waited`, milliseconds. */
  cameLate(now, waited) {
    this.came(now / 1000, waited / 1000);
  }

  /** Whether anything has come of what is shown, as last answered since the clock was set by `goOn`. */
  get hasCome() {
    return this.#hasCome;
  }

  /** Where the last frame ends of which anything had come, as answered, seconds. */
  get seenUntil() {
    return this.#seenUntil;
  }

  /** The clock goes on from `time`, seconds, where there is something again. */
  goOn(time) {
    [this.time, this.isAhead, this.#hasCome] = [time, false, true];
  }

  /** Lets `dt` seconds pass: see `Controls`. */
  advance(dt) {
    // A stream that grows is not over before anything of its end has come.
    const ends = this.time + dt * this.rate >= this.duration;
    const waits = this.isAhead || (this.grows && !this.#hasCome && ends);
    if (waits && this.playing) return WAITING;
    return super.advance(dt, this.#state.base_timeout, this.#state.missing);
  }

  /** Takes a packet; the promise is kept once the decoder has it. */
  push(packet) {
    if (this.#freed) return Promise.resolve();
    // A copy of a part takes all of its buffer along.
    this.#packets.push(packet.byteLength === packet.buffer.byteLength ? packet : packet.slice());
    this.#pushing ??= this.#flush();
    return this.#pushing;
  }

  /** Packets that wait for the decoder. */
  get waiting() {
    return this.#packets.length;
  }

  // Packets that come while others are on their way to the decoder go together.
  async #flush() {
    try {
      while (this.#packets.length > 0 && !this.#freed) {
        const packets = this.#packets;
        this.#packets = [];
        this.#changes += 1;
        await this.#decoding.ask("push", packets);
        this.answered();
      }
    } catch (error) {
      this.#fail(error);
    } finally {
      this.#pushing = null;
    }
  }

  /** Which bytes to ask for next: first and past; one number for the whole file; none when all is there. */
  wanted() {
    return this.#decoding.ask("wanted");
  }

  /** Takes bytes of the file from offset `at` on; they are given away. */
  async take(at, bytes) {
    this.#changes += 1;
    this.#take(await this.#decoding.ask("take", { at, bytes }, [bytes.buffer]));
  }

  /** Takes the whole file after all; its bytes are given away. */
  async takeWhole(bytes) {
    this.#changes += 1;
    this.#take(await this.#decoding.ask("takeWhole", bytes, [bytes.buffer]));
  }

  #take({ loaded, damage }) {
    [this.#loaded, this.#damage] = [loaded, damage];
  }

  /** A receipt for the server: its number, and when the first frame of the round was shown, microseconds. */
  receipt(sequence, playout) {
    return this.#decoding.ask("receipt", { sequence, playout, view: this.view, up: this.up });
  }

  /** When the first frame is due of the round that the server sends for `time`, seconds. */
  roundStart(time) {
    return this.#decoding.ask("roundStart", time);
  }

  /**
   * Puts an emulated network before the decoder: share lost, mean run, bits per second (0: no limit), seconds of delay,
   * seed.
   */
  impair(conditions = {}) {
    const { loss, burst, rate, delay, seed } = checkedConditions(conditions);
    this.#network = JSON.stringify({ loss, burst, rate, delay, seed });
    this.#changes += 1;
    const network = { loss, burst: meanBurst(loss, burst), rate, delay, seed };
    this.#decoding.ask("impair", network).catch((error) => this.#fail(error));
  }

  /**
   * Asks whoever sends for `conditions`: what `impair` takes, `scheduler` by name and `anew`. What is not granted of
   * the network is emulated here. Resolves with what is granted, `{ link, scheduler }`; null for a request
   * that a later one replaced.
   */
  async setConditions(conditions) {
    const checked = checkedConditions(conditions);
    const granted = this.server ? await this.server(checked) : { link: false, scheduler: false };
    if (!granted || this.#freed) return null;
    const { loss, burst, rate, delay, seed } = granted.link ? PERFECT : checked;
    if (JSON.stringify({ loss, burst, rate, delay, seed }) !== this.#network) {
      this.impair({ loss, burst, rate, delay, seed });
    }
    return granted;
  }

  /** Forgets every packet: the server begins as if nothing had arrived. */
  async restart() {
    this.#changes += 1;
    // The clock hears at once that no base is there.
    this.#state = await this.#decoding.ask("restart");
  }

  /**
   * Moves the camera so that every Gaussian of the frame is in the picture; `up` is `y`, `minus-z` and so on.
   * Where none has come yet, it is moved once some have, and once more when their base has, unless the view
   * is another by then.
   */
  async lookAtAll(aspect, up) {
    const found = await this.#decoding.ask("bounds", this.frame);
    if (this.#freed) return;
    this.#lookAround(found, aspect, up);
    const isOpen = found.length === 0 && this.#awaitsBase;
    this.#unframed = isOpen ? { aspect, view: String(this.view), decoded: 0, hasFound: false } : null;
  }

  #lookAround([x = 0, y = 0, z = 0, radius = 1], aspect, up) {
    this.lookAround([x, y, z], radius, aspect, up);
  }

  // Whether the base of the frame is still to come.
  get #awaitsBase() {
    const { missing } = this.#state;
    return missing.some((first, k) => k % 2 === 0 && first <= this.frame && this.frame < missing[k + 1]);
  }

  async #lookAgain() {
    const placed = this.#unframed;
    if (!placed || placed.isAsking) return;
    const [isLast, decoded] = [!this.#awaitsBase, this.#state.packets[1]];
    if (!isLast && (placed.hasFound || decoded === placed.decoded)) return;
    [placed.isAsking, placed.decoded] = [true, decoded];
    const found = await this.#decoding.ask("bounds", this.frame);
    if (this.#freed || this.#unframed !== placed) return;
    placed.isAsking = false;
    if (found.length > 0) {
      const { view } = this;
      this.#lookAround(found, placed.aspect, this.up);
      // What somebody chose stays; the way back to the first view is to what has come.
      if (String(view) !== placed.view) this.setView(view);
      else placed.view = String(this.view);
      placed.hasFound = true;
      this.answered();
    }
    if (isLast) this.#unframed = null;
    // More may have been answered meanwhile.
    else await this.#lookAgain();
  }

  /** A screen that has nothing of this session must be given all of it. */
  forget() {
    this.#anew = true;
    this.#requested = this.#shown = "";
    this.#uploads = 0;
    // What was made for another screen may lack what only that one has.
    this.#answer = null;
  }

  /**
   * Asks the decoder for what is requested at `now`, milliseconds, unless it is asked already: of frames that
   * are requested while it is at work, the newest is the next. `hasScreen`: is there a screen for a picture?
   */
  request(now, hasScreen) {
    const target = this.#target();
    const asked = `${target} ${hasScreen}`;
    if (this.#pending || this.#freed || (asked === this.#requested && !this.busy)) return;
    this.#requested = asked;
    const anew = this.#anew;
    const [overlay, reduced] = [OVERLAYS.indexOf(this.#overlay), this.drawn];
    const given = { frame: this.frame, cap: this.#cap, overlay, reduced, now: now / 1000 };
    const buffer = this.#buffer;
    this.#buffer = null;
    if (hasScreen) this.#anew = false;
    const asking = { ...given, anew, hasScreen, buffer };
    this.#pending = this.#decoding.ask("show", asking, buffer ? [buffer] : []).then(
      ({ picture, state }) => this.#takeAnswer(given.frame, target, hasScreen, picture, state),
      (error) => {
        this.#pending = null;
        this.#fail(error);
      },
    );
  }

  #takeAnswer(frame, target, hasScreen, picture, state) {
    this.#pending = null;
    if (this.#freed) return;
    this.#state = state;
    this.#hasCome = state.hasCome;
    if (state.hasCome) this.#seenUntil = (frame + 1) / this.#facts.rate;
    this.#lookAgain().catch((error) => this.#fail(error));
    // A screen was forgotten while this was made.
    if (hasScreen && !this.#anew) this.#answer = { target, picture };
    this.answered();
  }

  #fail(error) {
    if (!this.#freed) this.failed(error);
  }

  /** Asks for what is requested and uploads what was answered. */
  update(now, screen) {
    const answer = this.#answer;
    this.#answer = null;
    this.request(now, screen !== null);
    if (!answer || !screen) return;
    const { target, picture } = answer;
    if (picture) {
      const { count, degree, onlyMoved, bytes, buffer } = picture;
      screen.upload(count, degree, onlyMoved, this.#facts.footprint, new Uint8Array(buffer, 0, bytes));
      this.#buffer = buffer;
      this.#uploads += 1;
    }
    this.#shown = target;
  }

  /** Asks, waits and uploads until the screen has what is requested. */
  async settle(screen) {
    // A clip that plays requests another frame each time.
    for (let round = 0; round < MAX_ROUNDS && !this.settled && !this.#freed && !screen.lost; round++) {
      this.update(performance.now(), screen);
      await (this.#pending ?? this.#pushing);
    }
  }

  free() {
    this.#freed = true;
    this.#decoding.close();
    super.free();
  }
}
