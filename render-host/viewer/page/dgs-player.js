// The element <dgs-player> plays a stream: like <video>, with a camera and a network to pull apart.

import { prepare } from "./decoding.js";
import { Engine } from "./engine.js";
import { load } from "./load.js";
import { NetworkPanel } from "./network.js";
import { bindIdle, bindKeys, bindPointers } from "./input.js";
import { climb, fileRung, rungsOf } from "./ladder.js";
import { OVERLAYS, Session } from "./session.js";
import { STYLE } from "./style.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const QUALITIES = ["base", "level 1", "level 2", "all levels"];
const KEYS = [
  ["Space", "play or pause"],
  [", .", "one frame back or on"],
  ["Home End", "to the start or the end"],
  ["drag, arrows", "turn around the scene"],
  ["right drag, two fingers, Shift + arrows", "pan"],
  ["wheel, pinch, + −", "nearer or farther"],
  ["W A S D Q E", "fly"],
  ["0", "first view"],
  ["U", "another way up"],
  ["1 2 3 4", "highest level shown"],
  ["O", "paint blocks by level, by what just came, by coverage"],
  ["N", "network"],
  ["L", "loop"],
  ["F", "full screen"],
  ["?", "these keys"],
];

const TEMPLATE = `
<style>${STYLE}</style>
<canvas class="picture" part="picture" tabindex="0" role="img" aria-label="Moving scene; press ? for keys"></canvas>
<p class="message" role="status" aria-live="polite"></p>
<section class="network" aria-label="Network" hidden></section>
<div class="bar" part="controls" role="group" aria-label="Player">
  <button class="play" aria-label="Play" title="Play (Space)">▶</button>
  <input class="time" type="range" min="0" max="1" step="any" value="0" aria-label="Time">
  <span class="clock" aria-hidden="true">0.0 / 0.0</span>
  <select class="speed" aria-label="Speed" title="Speed"></select>
  <button class="loop" aria-label="Loop" title="Loop (L)" aria-pressed="true">↻</button>
  <select class="quality" aria-label="Highest level shown" title="Highest level shown (1 to 4)"></select>
  <input class="background wide" type="color" value="#000000" aria-label="Background" title="Background">
  <button class="paint" aria-label="Paint blocks" title="Paint blocks: none (O)" aria-pressed="false">◩</button>
  <button class="net" aria-label="Network" title="Network (N)" aria-pressed="false">⇅</button>
  <button class="whole" aria-label="Full screen" title="Full screen (F)"><svg width="14" height="14" viewBox="0 0 14 14" fill="none" stroke="currentColor" stroke-width="2" aria-hidden="true"><path d="M1 5V1h4M9 1h4v4M13 9v4H9M5 13H1V9"/></svg></button>
  <button class="help" aria-label="Keys" title="Keys (?)">?</button>
</div>
<dialog aria-label="Keys"><dl></dl><form method="dialog"><button>Close</button></form></dialog>`;

export class DgsPlayer extends HTMLElement {
  static observedAttributes = ["src", "time", "loop", "background", "quality", "pixel-ratio"];

  #root = this.attachShadow({ mode: "open" });
  #engine = null;
  #panel = null;
  #load = null;
  #loaded = 0;
  #error = null;
  #view = null;
  #hopeless = false;
  #firstFrameMs = null;

  /** Where the WebAssembly lies, when not beside this file: set it before the first player is made. */
  static set wasmUrl(url) {
    load(url);
  }

  constructor() {
    super();
    this.#root.innerHTML = TEMPLATE;
    const options = (select, values, labels, chosen) =>
      this.#part(select).replaceChildren(
        ...values.map((value, k) => new Option(labels[k], value, value === chosen, value === chosen)),
      );
    options(".speed", SPEEDS, SPEEDS.map((speed) => `${speed}×`), 1);
    options(".quality", [0, 1, 2, 3], QUALITIES, 3);
    this.#part("dialog dl").innerHTML = KEYS.map(([key, does]) => `<dt><kbd>${key}</kbd></dt><dd>${does}</dd>`).join("");
    this.#bind();
  }

  connectedCallback() {
    this.#engine = new Engine(this.#part("canvas.picture"));
    this.#panel = new NetworkPanel(this.#part(".network"), this.#engine);
    this.#listen();
    const opened = this.#engine.open();
    opened.catch((error) => {
      this.#fail(error);
      this.#hopeless = true;
    });
    const ratio = Number(this.getAttribute("pixel-ratio"));
    if (ratio > 0) this.#engine.pixelRatio = ratio;
    if (this.hasAttribute("src")) this.#start(this.getAttribute("src"));
  }

  disconnectedCallback() {
    this.#load?.abort();
    this.#engine?.close();
    this.#engine = this.#panel = null;
  }

  attributeChangedCallback(name, before, now) {
    if (before === now || !this.#engine) return;
    if (name === "src" && now !== null) this.#start(now);
    if (name === "src" && now === null) this.#load?.abort();
    if (name === "time") this.currentTime = Number(now);
    if (name === "loop") this.loop = now !== null && now !== "false";
    if (name === "background" && now) this.background = now;
    if (name === "quality" && now) this.quality = Number(now);
    if (name === "pixel-ratio") {
      this.#engine.pixelRatio = Number(now) > 0 ? Number(now) : null;
      this.#engine.request();
    }
  }

  /** Plays a file, a Blob or bytes in place of what is played. */
  async open(file) {
    const signal = this.#loads();
    try {
      // What somebody else holds is not given away.
      const bytes = file instanceof Uint8Array ? file.slice() : new Uint8Array(await file.arrayBuffer());
      await this.#began(await Session.open(bytes, { worker: this.#worker }), () => {}, signal);
    } catch (error) {
      if (!signal.aborted) this.#fail(error);
    }
  }

  // Ends what is loading for something else.
  #loads() {
    this.#load?.abort();
    this.#load = new AbortController();
    if (this.#worker) prepare();
    this.#emit("loadstart");
    return this.#load.signal;
  }

  // Whether to decode in a worker.
  get #worker() {
    return this.getAttribute("worker") !== "off";
  }

  /** Plays a session that its maker goes on feeding: `await Session.receive(manifest)`, then `push(packet)`. */
  async receive(session) {
    const signal = this.#loads();
    try {
      await this.#began(session, () => {}, signal);
    } catch (error) {
      if (!signal.aborted) this.#fail(error);
    }
  }

  /**
   * Plays a stream of a server's `streams.json`: live over WebTransport, live over a WebSocket, its file by ranges,
   * whatever comes first. `transport`, "live", "streams" (live without datagrams), "websocket" or "file", allows one of
   * them alone.
   */
  async playServed(stream, transport = null) {
    await this.#climb(rungsOf(stream, transport), "Connecting …");
  }

  #start(url) {
    return this.#climb([fileRung(url)], "Loading …");
  }

  // Plays what the first of `rungs` brings; when it is cut off, the next takes over where it was.
  async #climb(rungs, sentence) {
    const signal = this.#loads();
    this.#say(sentence);
    const came = () => {
      this.#loaded = this.session?.loaded ?? 0;
      this.#engine?.request();
      this.#emit("progress");
    };
    const began = async (session, name) => {
      if (name !== "file") this.dataset.transport = name;
      await this.#began(session, came, signal);
    };
    const switched = (name) => (this.dataset.transport = name);
    const given = { began, came, signal, switched, player: this, worker: this.#worker };
    try {
      await load();
      for (;;) {
        const { name, result, failure } = await climb(rungs, given);
        if (signal.aborted) return;
        if (name === "file") {
          if (failure) throw failure;
          this.#loaded = 1;
          this.dataset.transport = result;
          return this.#emit("load");
        }
        rungs = rungs.slice(1 + rungs.findIndex((rung) => rung.name === name));
        if (rungs.length === 0) throw failure ?? new Error("The server has ended the session");
        this.setAttribute("time", this.currentTime);
      }
    } catch (error) {
      if (!signal.aborted) this.#fail(error);
    }
  }

  // Shows a session, unless something else is loaded by now.
  async #began(session, came, signal) {
    const time = Number(this.getAttribute("time"));
    if (time > 0) session.time = time;
    try {
      await session.lookAtAll(this.#engine?.aspect ?? 1, this.getAttribute("up") ?? "y");
    } finally {
      if (signal.aborted) session.free();
    }
    if (signal.aborted) return;
    this.#error = null;
    this.#say(session.damage ? `Damaged, shown as far as it goes: ${session.damage}` : "");
    session.looping = this.getAttribute("loop") !== "false";
    session.rate = Number(this.#part(".speed").value);
    session.cap = Number(this.getAttribute("quality") ?? 3);
    this.dataset.decoding = session.decoding;
    if (this.#view) session.setView(this.#view);
    this.#engine.session = session;
    this.background = this.getAttribute("background") ?? "#000000";
    this.#panel.began();
    this.#loaded = session.loaded;
    came();
    this.#emit("loadedmetadata");
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (this.hasAttribute("autoplay") && !still) this.play();
    this.#showState();
  }

  #listen() {
    const engine = this.#engine;
    engine.addEventListener("firstframe", () => {
      if (!this.#part(".message").textContent.startsWith("Damaged")) this.#say("");
      this.#firstFrameMs ??= performance.now();
      this.#emit("firstframe");
    });
    engine.addEventListener("time", () => this.#showTime());
    engine.addEventListener("step", ({ detail }) => {
      if (detail.looped) this.#emit("loop");
      if (detail.ended) this.#emit("ended");
      this.#emit(detail.waiting ? "waiting" : "playing");
      this.#showState();
    });
    engine.addEventListener("devicelost", () => this.#emit("devicelost"));
    engine.addEventListener("devicerestored", () => this.#emit("devicerestored"));
    engine.addEventListener("error", ({ detail }) => this.#fail(detail));
  }

  #bind() {
    const on = (part, event, act) => this.#part(part).addEventListener(event, act);
    on(".play", "click", () => this.toggle());
    on(".time", "input", ({ target }) => (this.currentTime = Number(target.value)));
    on(".speed", "change", ({ target }) => (this.playbackRate = Number(target.value)));
    on(".quality", "change", ({ target }) => (this.quality = Number(target.value)));
    on(".loop", "click", () => (this.loop = !this.loop));
    on(".background", "input", ({ target }) => (this.background = target.value));
    on(".paint", "click", () => this.nextOverlay());
    on(".net", "click", () => this.toggleNetwork());
    on(".whole", "click", () => this.toggleFullscreen());
    on(".help", "click", () => this.showHelp());
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
  #say(text) {
    if (this.#hopeless) return;
    this.#part(".message").textContent = text;
  }

  #fail(error) {
    this.#error = error instanceof Error ? error : new Error(String(error));
    this.#say(this.#error.message);
    this.dispatchEvent(new ErrorEvent("error", { error: this.#error, message: this.#error.message }));
  }

  #showTime() {
    const { session } = this;
    if (!session) return;
    const time = this.#part(".time");
    if (this.#root.activeElement !== time || session.playing) time.value = session.time;
    time.setAttribute("aria-valuetext", `${session.time.toFixed(1)} of ${session.duration.toFixed(1)} seconds`);
    this.#part(".clock").textContent = `${session.time.toFixed(1)} / ${session.duration.toFixed(1)}`;
    this.#emit("timeupdate");
  }

  #showState() {
    const { session } = this;
    if (!session) return;
    const playing = session.playing;
    const play = this.#part(".play");
    play.textContent = playing ? "❚❚" : "▶";
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    this.#part(".time").max = session.duration;
    this.#part(".loop").setAttribute("aria-pressed", session.looping);
    const paint = this.#part(".paint");
    paint.setAttribute("aria-pressed", session.overlay !== OVERLAYS[0]);
    paint.title = `Paint blocks: ${session.overlay} (O)`;
    this.#part(".quality").value = session.cap;
    this.#part(".speed").value = session.rate;
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

  get src() {
    return this.getAttribute("src");
  }

  set src(url) {
    if (url === null) this.removeAttribute("src");
    else this.setAttribute("src", url);
  }

  /** When the first picture was drawn, milliseconds since the page began; null before. */
  get firstFrameMs() {
    return this.#firstFrameMs;
  }

  get duration() {
    return this.session?.duration ?? NaN;
  }

  get currentTime() {
    return this.session?.time ?? 0;
  }

  set currentTime(seconds) {
    if (!this.session || !Number.isFinite(seconds)) return;
    this.session.time = seconds;
    this.#engine.request();
    this.#showTime();
    this.#emit("seeked");
  }

  get paused() {
    return !this.session?.playing;
  }

  get ended() {
    return this.paused && this.currentTime >= this.duration;
  }

  get playbackRate() {
    return this.session?.rate ?? 1;
  }

  set playbackRate(rate) {
    this.#change("ratechange", (session) => (session.rate = rate));
  }

  get loop() {
    return this.session?.looping ?? true;
  }

  set loop(loop) {
    this.#change("loopchange", (session) => (session.looping = loop));
  }

  /** Highest level shown, 0 to 3. */
  get quality() {
    return this.session?.cap ?? 3;
  }

  set quality(level) {
    this.#change("levelchange", (session) => (session.cap = Math.max(0, Math.min(3, Math.round(level) || 0))));
  }

  /** What blocks are painted by: none, levels (that they are shown at), arrivals (of the last second), coverage. */
  get overlay() {
    return this.session?.overlay ?? OVERLAYS[0];
  }

  set overlay(overlay) {
    this.#change("levelchange", (session) => (session.overlay = overlay));
  }

  /** Paints blocks by the next of these. */
  nextOverlay() {
    this.overlay = OVERLAYS[(OVERLAYS.indexOf(this.overlay) + 1) % OVERLAYS.length];
  }

  /** Share of the stream that is there, 0 to 1. */
  get buffered() {
    return this.#loaded;
  }

  get background() {
    return this.#part(".background").value;
  }

  set background(colour) {
    const [, r, g, b] = /^#(..)(..)(..)$/.exec(colour) ?? [];
    if (b === undefined) return;
    this.#part(".background").value = colour;
    this.#change("backgroundchange", (session) => session.setBackground(...[r, g, b].map((v) => parseInt(v, 16) / 255)));
    this.#engine?.redraw();
  }

  /** Azimuth, elevation (radians), distance, target: six numbers. Kept for the next stream. */
  get view() {
    return this.session ? [...this.session.view] : this.#view;
  }

  set view(numbers) {
    this.#view = Float64Array.from(numbers);
    if (this.session?.setView(this.#view)) this.#moved();
  }

  #change(event, change) {
    if (!this.session) return;
    change(this.session);
    this.#engine.request();
    this.#showState();
    this.#emit(event);
  }

  play() {
    this.#change("play", (session) => (session.playing = true));
    return Promise.resolve();
  }

  pause() {
    this.#change("pause", (session) => (session.playing = false));
  }

  toggle() {
    if (this.paused) this.play();
    else this.pause();
  }

  /** Goes `frames` frames on, and stands. */
  step(frames) {
    this.#change("seeked", (session) => session.step(frames));
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
   * also its scheduler, and whether each round begins anew. The promise is kept once it holds.
   */
  async impair(conditions) {
    let set;
    this.#change("levelchange", () => (set = this.#panel.set(conditions)));
    await set;
  }

  toggleNetwork() {
    const shown = this.#panel?.toggle() ?? false;
    this.#part(".net").setAttribute("aria-pressed", shown);
  }

  toggleFullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else this.requestFullscreen?.().catch(() => this.#say("This browser shows no part of a page full screen."));
  }

  showHelp() {
    const dialog = this.#part("dialog");
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }
}

customElements.define("dgs-player", DgsPlayer);
