// The network panel loses packets on purpose and shows what is left: sliders, plots, numbers.

import { levelColours } from "./dgs_viewer.js";

const NAMES = ["stand-ins", "base", "level 1", "level 2", "level 3"];
// Samples of the plot, and what lies between two, milliseconds.
const SAMPLES = 140;
const SAMPLE_MS = 100;
// The rate slider is a logarithm, of Mbit/s; at its end there is no limit.
const NO_LIMIT = 2;

const PARTS = `
<label>Loss <input class="loss" type="range" min="0" max="60" step="1" value="0"><output>0 %</output></label>
<label>Bursts <input class="burst" type="range" min="1" max="20" step="1" value="1"><output>1 packet</output></label>
<label>Rate <input class="rate" type="range" min="-1" max="${NO_LIMIT}" step="0.05" value="${NO_LIMIT}"><output>no limit</output></label>
<label>Seed <input class="seed" type="range" min="1" max="50" step="1" value="1"><output>1</output></label>
<canvas class="levels" role="img" aria-label="Share of blocks by level over time"></canvas>
<canvas class="bits" role="img" aria-label="Bits that arrived per second over time"></canvas>
<ul class="legend"></ul>
<p class="numbers" role="status"></p>`;

export class NetworkPanel {
  #root;
  #engine;
  #history = [];
  // Bits per second of each sample, and bytes until the last one and its time.
  #bits = [];
  #until = null;
  #timer = 0;
  #colours = null;

  constructor(root, engine) {
    this.#root = root;
    this.#engine = engine;
    root.innerHTML = PARTS;
    root.addEventListener("input", () => this.#impair());
  }

  #value(name) {
    return Number(this.#root.querySelector(`.${name}`).value);
  }

  #say(name, text) {
    this.#root.querySelector(`.${name} + output`).textContent = text;
  }

  /** Shows or hides; true when it is shown. */
  toggle() {
    this.#root.hidden = !this.#root.hidden;
    clearInterval(this.#timer);
    if (!this.#root.hidden) this.#timer = setInterval(() => this.#sample(), SAMPLE_MS);
    return !this.#root.hidden;
  }

  /** Another stream begins under the conditions that are set. */
  began() {
    [this.#history, this.#bits, this.#until] = [[], [], null];
    if (this.#value("loss") > 0 || this.#value("rate") < NO_LIMIT) this.#impair();
  }

  /** Sets the sliders, and the network to exactly this: share lost, mean run, bits per second (0: no limit), seed. */
  set({ loss = 0, burst = 1, rate = 0, seed = 1 }) {
    const slider = (name, value) => (this.#root.querySelector(`.${name}`).value = value);
    slider("loss", 100 * loss);
    slider("burst", burst);
    slider("rate", rate > 0 ? Math.log10(rate * 1e-6) : NO_LIMIT);
    slider("seed", seed);
    this.#apply(loss, burst, rate, seed);
  }

  #impair() {
    const [loss, burst, rate, seed] = ["loss", "burst", "rate", "seed"].map((name) => this.#value(name));
    this.#apply(loss / 100, burst, rate >= NO_LIMIT ? 0 : 10 ** rate * 1e6, seed);
  }

  #apply(loss, burst, bits, seed) {
    this.#say("loss", `${Math.round(100 * loss)} %`);
    this.#say("burst", burst === 1 ? "1 packet" : `${burst} packets`);
    this.#say("rate", bits === 0 ? "no limit" : `${(bits * 1e-6).toPrecision(2)} Mbit/s`);
    this.#say("seed", `${seed}`);
    this.#engine.session?.impair(loss, burst, bits, seed);
    this.#engine.request();
    this.#sample();
  }

  #sample() {
    const session = this.#engine.session;
    if (!session || this.#root.hidden) return;
    const levels = session.levels();
    const blocks = Math.max(1, levels.reduce((sum, count) => sum + count, 0));
    this.#history.push([...levels].map((count) => count / blocks));
    if (this.#history.length > SAMPLES) this.#history.shift();
    const [came, decoded, bytes] = session.packets();
    const bits = this.#rateOf(bytes, performance.now());
    // The mean number of levels, of as many as there are.
    const quality = levels.reduce((sum, count, level) => sum + level * count, 0) / (blocks * (levels.length - 1));
    const share = ((100 * levels[0]) / blocks).toFixed(1);
    this.#root.querySelector(".numbers").textContent =
      `${decoded} of ${came} packets decoded; ${share} % of ${blocks} blocks by stand-ins; ` +
      `${(bits * 1e-6).toPrecision(2)} Mbit/s; ${Math.round(100 * quality)} % of all levels`;
    this.#plot();
  }

  // Bits per second since the last sample; less than before where packets came anew.
  #rateOf(bytes, now) {
    const [before, then] = this.#until ?? [bytes, now];
    this.#until = [bytes, now];
    const bits = now > then ? (8000 * Math.max(0, bytes - before)) / (now - then) : 0;
    this.#bits.push(bits);
    if (this.#bits.length > SAMPLES) this.#bits.shift();
    return bits;
  }

  #plot() {
    this.#plotLevels();
    this.#plotBits();
  }

  // A canvas of its size on the page, empty.
  #pen(selector) {
    const canvas = this.#root.querySelector(selector);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, width, height);
    return { pen, width, height, step: width / SAMPLES };
  }

  #plotBits() {
    const { pen, height, step } = this.#pen("canvas.bits");
    const most = Math.max(1, ...this.#bits);
    pen.fillStyle = "#8ab4d8";
    this.#bits.forEach((bits, k) => {
      const top = (height * bits) / most;
      pen.fillRect(k * step, height - top, Math.ceil(step), top);
    });
  }

  #plotLevels() {
    if (!this.#colours) {
      const all = [...levelColours()].map((v) => Math.round(255 * v));
      this.#colours = NAMES.map((_, k) => `rgb(${all.slice(3 * k, 3 * k + 3)})`);
      this.#root.querySelector(".legend").innerHTML = NAMES.map(
        (name, k) => `<li><i style="background:${this.#colours[k]}"></i>${name}</li>`,
      ).join("");
    }
    const { pen, height, step } = this.#pen("canvas.levels");
    this.#history.forEach((shares, k) => {
      let y = height;
      shares.forEach((share, level) => {
        pen.fillStyle = this.#colours[level];
        pen.fillRect(k * step, y - share * height, Math.ceil(step), share * height + 1);
        y -= share * height;
      });
    });
  }
}
