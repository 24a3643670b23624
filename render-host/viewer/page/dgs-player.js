// The element <dgs-player> plays a stream: like <video>, with a camera and a network to pull apart.

import { Attributes } from "./attributes.js";
import { BACKGROUNDS, Message, bindControls, build, showState, showTime, toggleFullscreen, toggleHelp } from "./bar.js";
import { prepare } from "./decoding.js";
import { Engine } from "./engine.js";
import { load } from "./load.js";
import { NetworkPanel } from "./network.js";
import { bindIdle, bindKeys, bindPointers } from "./input.js";
import { fileRung, follow, rungsOf } from "./ladder.js";
import { LEVELS, OVERLAYS, checkedLevel, checkedOverlay } from "./session.js";
import { openFile } from "./source.js";

export class DgsPlayer extends Attributes {
  static observedAttributes = ["src", "time", "loop", "background", "quality", "pixel-ratio", "up", "adapt"];

  #root = this.attachShadow({ mode: "open", delegatesFocus: true });
  #engine = null;
  #panel;
  #message;
  // Ends what was begun last.
  #load = null;
  // Of files that are looked at, the last.
  #looked = null;
  #damage = "";
  #error = null;
  // What is requested of every stream, whether or not one has begun: as a session calls it.
  #requested = { looping: true, rate: 1, cap: LEVELS - 1, overlay: OVERLAYS[0], keepsUp: true };
  // What is requested of the next stream alone: whether it plays, and from when; null where nobody has said.
  #next = { playing: null, time: null };
  #view = null;
  #hopeless = false;
  #firstFrameMs = null;

  /** Where the WebAssembly lies, when not beside this file: set it before the first player is made. */
  static set wasmUrl(url) {
    load(url);
  }

  constructor() {
    super();
    build(this.#root);
    this.#message = new Message(this.#part(".message"));
    this.#panel = new NetworkPanel(this.#part(".network"), () => this.#engine);
    this.#bind();
  }

  connectedCallback() {
    // It was only moved within the page.
    if (this.#engine) return;
    this.#hopeless = false;
    this.#engine = new Engine(this.#part("canvas.picture"));
    this.#listen();
    this.#engine.open().catch((error) => {
      this.#fail(error);
      this.#hopeless = true;
    });
    this.#engine.pixelRatio = this.pixelRatio;
    if (this.hasAttribute("src")) this.#start(this.getAttribute("src"));
  }

  disconnectedCallback() {
    queueMicrotask(() => {
      if (this.isConnected) return;
      this.#load?.abort();
      this.#panel.close();
      this.#engine?.close();
      this.#engine = null;
    });
  }

  attributeChangedCallback(name, before, now) {
    // A time that is set again is gone to again.
    if (before === now && name !== "time") return;
    if (name === "src" && now === null) this.#load?.abort();
    else if (name === "src" && this.#engine) this.#start(now);
    if (name === "time" && now !== null && this.session) this.currentTime = Number(now);
    if (name === "loop") this.loop = now !== "false";
    if (name === "background" && now) this.background = now;
    if (name === "quality" && now) this.#take(() => (this.quality = now));
    if (name === "adapt") this.#request("levelchange", { keepsUp: this.adaptive });
    if (name === "up") this.#turnUp(now ?? this.session?.upOfStream);
    if (name === "pixel-ratio" && this.#engine) {
      this.#engine.pixelRatio = this.pixelRatio;
      this.#engine.request();
    }
  }

  // What an attribute says; nobody catches what that throws.
  #take(set) {
    try {
      set();
    } catch (error) {
      this.#fail(error);
    }
  }

  #turnUp(up) {
    const { session } = this;
    if (!session || session.up === up) return;
    if (session.setUp(up)) this.#moved();
    else this.#fail(new RangeError(`up is "${up}"; y, minus-z and so on are allowed`));
  }

  /** Plays a file, a Blob or bytes in place of what is played, once they are known to be a stream. */
  async open(file) {
    const [load, looked] = [this.#load, (this.#looked = {})];
    const isLast = () => this.#looked === looked && this.#load === load;
    try {
      const session = await openFile(file, { worker: this.#worker });
      if (isLast()) await this.#play(session);
      else session.free();
    } catch (error) {
      // What is played goes on, and the sentence goes.
      if (isLast()) this.#fail(error, true);
    }
  }

  // Ends what is loading for something else.
  #loads() {
    this.#load?.abort();
    this.#load = new AbortController();
    this.#emit("loadstart");
    return this.#load.signal;
  }

  // What was requested before anything was loaded was requested of what is loaded first.
  #forget() {
    if (this.#load) this.#next = { playing: null, time: null };
  }

  // Whether to decode in a worker.
  get #worker() {
    return this.getAttribute("worker") !== "off";
  }

  /** Plays a session that its maker goes on feeding: `await Session.receive(manifest)`, then `push(packet)`. */
  async receive(session) {
    this.#forget();
    await this.#play(session);
  }

  async #play(session) {
    const signal = this.#loads();
    await this.#began(session, () => {}, signal).catch((error) => signal.aborted || this.#fail(error));
  }

  /**
   * Plays a stream of a server's `streams.json`: live over WebTransport, live over a WebSocket, its file by ranges,
   * whatever comes first. `transport`, "live", "streams" (live without datagrams), "websocket" or "file", allows one of
   * them alone. Where the server goes away, all are tried again until something else is played.
   */
  async playServed(stream, transport = null) {
    const gone = (failure) => this.#say(`${failure?.isRefusal ? failure.message : "The server is gone"}; trying again`);
    await this.#climb(() => rungsOf(stream, transport), "Connecting …", gone);
  }

  #start(url) {
    return this.#climb(() => [fileRung(url)], "Loading …");
  }

  // Plays what the first of `rungs()` brings; when it is cut off, the next takes over where it is by then, and
  // all of them again after the last, if `gone` can say so.
  async #climb(rungs, sentence, gone = null) {
    this.#forget();
    const signal = this.#loads();
    if (this.#worker) prepare();
    this.#say(sentence);
    let shown = null;
    const goesOn = () => shown !== null && shown === this.session;
    const came = () => {
      this.#sayDamage();
      this.#engine?.request();
      this.#emit("progress");
    };
    const began = async (session, name) => {
      if (name !== "file") this.dataset.transport = name;
      if (goesOn()) this.#next = { playing: !this.paused, time: this.currentTime };
      await this.#began(session, came, signal, shown?.view);
      shown = session;
    };
    const switched = (name) => (this.dataset.transport = name);
    const start = () => (goesOn() ? this.currentTime : this.#startTime);
    const given = { began, came, gone, signal, switched, start, player: this, worker: this.#worker };
    try {
      await load();
      const result = await follow(rungs(), given);
      if (signal.aborted) return;
      this.dataset.transport = result;
      this.#emit("load");
    } catch (error) {
      if (!signal.aborted) this.#fail(error);
    }
  }

  // When the next stream begins, seconds.
  get #startTime() {
    return this.#next.time ?? this.time;
  }

  // Shows a session from `view`, if there is one, unless something else is loaded by now.
  async #began(session, came, signal, view = this.#view) {
    try {
      await session.lookAtAll(this.#engine?.aspect ?? 1, this.getAttribute("up") ?? session.upOfStream);
      if (!signal.aborted && !this.#engine) throw new Error("The player is in no page");
    } catch (error) {
      session.free();
      throw error;
    }
    if (signal.aborted) return session.free();
    session.time = this.#startTime;
    Object.assign(session, this.#requested);
    this.dataset.decoding = session.decoding;
    if (view) session.setView(view);
    this.#error = null;
    this.#damage = "";
    if (!this.#hopeless) this.#message.clear();
    this.#engine.session = session;
    this.#paint(session);
    this.#panel.began();
    came();
    this.#sayDamage();
    this.#emit("loadedmetadata");
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (this.#next.playing ?? (this.autoplay && !still)) this.play();
    this.#next = { playing: null, time: null };
    this.#showState();
  }

  // More of it may be found as more of a file comes.
  #sayDamage() {
    const damage = this.session?.damage ?? "";
    if (damage === this.#damage) return;
    this.#damage = damage;
    this.#say(damage ? `Damaged, shown as far as it goes: ${damage}` : "");
  }

  #listen() {
    const engine = this.#engine;
    engine.addEventListener("firstframe", () => {
      if (!this.#damage) this.#say("");
      this.#firstFrameMs ??= performance.now();
      this.#emit("firstframe");
    });
    engine.addEventListener("time", () => this.#showTime());
    engine.addEventListener("reduction", () => this.#showState());
    engine.addEventListener("step", ({ detail }) => {
      if (detail.looped) this.#emit("loop");
      if (detail.turned && !this.paused) this.#emit(detail.waiting ? "waiting" : "playing");
      if (detail.ended) ["pause", "ended"].forEach((name) => this.#emit(name));
      this.#showState();
    });
    for (const name of ["devicelost", "devicerestored"]) engine.addEventListener(name, () => this.#emit(name));
    engine.addEventListener("error", ({ detail }) => this.#fail(detail));
  }

  #bind() {
    bindControls(this.#root, this);
    const canvas = this.#part("canvas.picture");
    bindPointers(canvas, () => this.session, () => this.#moved());
    bindKeys(this, canvas, () => this.#moved());
    bindIdle(this, this.#part(".bar"));
  }

  #moved() {
    this.#engine?.request();
    this.#emit("camerachange");
  }

  #part(selector) {
    return this.#root.querySelector(selector);
  }

  #emit(name) {
    this.dispatchEvent(new Event(name));
  }

  // Where nothing can be drawn, nothing else is said.
  #say(text, passes = false) {
    if (!this.#hopeless) this.#message.say(text, passes);
  }

  #fail(error, passes = false) {
    this.#error = error instanceof Error ? error : new Error(String(error));
    this.#say(this.#error.message, passes);
    this.dispatchEvent(new ErrorEvent("error", { error: this.#error, message: this.#error.message }));
  }

  #showTime() {
    if (!this.session) return;
    showTime(this.#root, this);
    this.#emit("timeupdate");
  }

  #showState() {
    showState(this.#root, this);
    this.#showTime();
  }

  /** The session that is shown, or null: see `session.d.ts`. */
  get session() {
    return this.#engine?.session ?? null;
  }

  get engine() {
    return this.#engine;
  }

  get error() {
    return this.#error;
  }

  /** When the first picture was drawn, milliseconds since the page began; null before. */
  get firstFrameMs() {
    return this.#firstFrameMs;
  }

  get duration() {
    return this.session?.duration ?? NaN;
  }

  get currentTime() {
    return this.session?.time ?? this.#startTime;
  }

  set currentTime(seconds) {
    if (!Number.isFinite(seconds)) return;
    if (!this.session) return void (this.#next.time = seconds);
    this.session.time = seconds;
    this.#engine.request();
    this.#showTime();
    this.#emit("seeked");
  }

  get paused() {
    return !(this.session?.playing ?? this.#next.playing);
  }

  get ended() {
    return this.paused && this.currentTime >= this.duration;
  }

  get playbackRate() {
    return this.session?.rate ?? this.#requested.rate;
  }

  /** Seconds of the clip per second, -4 to 4. */
  set playbackRate(rate) {
    if (Number.isFinite(rate)) this.#request("ratechange", { rate: Math.max(-4, Math.min(4, rate)) });
  }

  get loop() {
    return this.#requested.looping;
  }

  set loop(loop) {
    this.#request("loopchange", { looping: Boolean(loop) });
  }

  /** Highest level shown, 0 to 3; anything else is a RangeError. */
  get quality() {
    return this.#requested.cap;
  }

  set quality(level) {
    this.#request("levelchange", { cap: checkedLevel("quality", level) });
  }

  /** What blocks are painted by: none, levels (that they are shown at), arrivals (of the last second), missing (utility). */
  get overlay() {
    return this.#requested.overlay;
  }

  set overlay(overlay) {
    this.#request("levelchange", { overlay: checkedOverlay(overlay) });
  }

  /** Paints blocks by the next of these. */
  nextOverlay() {
    this.overlay = OVERLAYS[(OVERLAYS.indexOf(this.overlay) + 1) % OVERLAYS.length];
  }

  /** Share of the stream that is there, 0 to 1: of a file's bytes, or of the packets of a server's manifest. */
  get buffered() {
    return this.session?.loaded ?? 0;
  }

  get background() {
    return this.#part(".background").value;
  }

  set background(colour) {
    if (!/^#[0-9a-f]{6}$/i.test(colour)) return;
    this.#part(".background").value = colour;
    this.#change("backgroundchange", (session) => this.#paint(session));
    this.#engine?.redraw();
  }

  /** The next of a few backgrounds, from black to white. */
  nextBackground() {
    this.background = BACKGROUNDS[(BACKGROUNDS.indexOf(this.background) + 1) % BACKGROUNDS.length];
  }

  // Gives a session the background that is chosen.
  #paint(session) {
    session.setBackground(...[1, 3, 5].map((at) => parseInt(this.background.slice(at, at + 2), 16) / 255));
  }

  /** Azimuth, elevation (radians), distance, target: six numbers. Kept for the next stream; null forgets them. */
  get view() {
    return this.session ? [...this.session.view] : this.#view;
  }

  set view(numbers) {
    this.#view = numbers && Float64Array.from(numbers);
    if (numbers && this.session?.setView(this.#view)) this.#moved();
  }

  #change(event, change) {
    if (!this.session) return;
    change(this.session);
    this.#engine.request();
    this.#showState();
    this.#emit(event);
  }

  // Of what is played and of whatever comes next.
  #request(event, requested) {
    Object.assign(this.#requested, requested);
    if (this.session) return this.#change(event, (session) => Object.assign(session, requested));
    this.#showState();
    this.#emit(event);
  }

  async play() {
    this.#run("play", true);
    if (this.session && !this.#engine.waiting) this.#emit("playing");
  }

  pause() {
    this.#run("pause", false);
  }

  #run(event, playing) {
    if (this.session) return this.#change(event, (session) => (session.playing = playing));
    this.#next.playing = playing;
    this.#showState();
  }

  toggle() {
    this.paused ? this.play() : this.pause();
  }

  /** Goes `frames` frames on, and stands. */
  step(frames) {
    const wasPlaying = this.session?.playing;
    this.#change("seeked", (session) => session.step(frames));
    if (wasPlaying) this.#emit("pause");
  }

  /** Back to the first view. */
  home() {
    this.session?.home(this.#engine.aspect);
    this.#moved();
  }

  nextUp() {
    if (!this.session) return;
    this.setAttribute("up", this.session.nextUp());
    this.#moved();
  }

  /**
   * Sets the network: share lost, mean run, bits per second (0: all at once), seconds of delay, seed; of a server's session
   * also its scheduler, and whether each round begins anew. The promise is kept once it holds; without a session at once:
   * it then holds from the beginning of the next. It is rejected with a RangeError for what is not allowed.
   */
  async impair(conditions) {
    const set = this.#panel.set(conditions);
    this.#change("levelchange", () => {});
    await set;
  }

  toggleNetwork() {
    this.#panel.toggle();
  }

  toggleFullscreen() {
    toggleFullscreen(this, () => this.#say("This browser shows no part of a page full screen."));
  }

  showHelp() {
    toggleHelp(this.#root);
  }
}

customElements.define("dgs-player", DgsPlayer);
