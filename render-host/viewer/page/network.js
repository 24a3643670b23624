// The network panel loses packets on purpose and shows what is left: sliders, plots, numbers. Of a server that grants it
// the server's scheduler and link change; of files, and over TCP, a network is emulated before the decoder.

import { RANGES, SCHEDULERS, checkedConditions, meanBurst } from "./conditions.js";
import { coloursOf, legendItems } from "./legend.js";
import { LEVEL_NAMES } from "./session.js";

// Samples of the plot, and what lies between two, milliseconds.
const SAMPLES = 140;
const SAMPLE_MS = 100;
// The rate slider is a logarithm, of bits per second; past the most there is no limit.
const [LEAST_RATE, MOST_RATE] = RANGES.rate.map(Math.log10);
const NO_LIMIT = MOST_RATE + 0.05;
// Where the network is, by whether the server grants a link.
const WHERE = ["emulated in this page", "emulated at the server"];

const PARTS = `
<label>Loss <input class="loss" type="range" min="0" max="${100 * RANGES.loss[1]}" step="1" value="0"><output>0 %</output></label>
<label>Bursts <input class="burst" type="range" min="1" max="${RANGES.burst[1]}" step="1" value="1"><output>1 packet</output></label>
<label>Rate <input class="rate" type="range" min="${LEAST_RATE}" max="${NO_LIMIT}" step="0.05" value="${NO_LIMIT}"><output>no limit</output></label>
<label>Delay, one way <input class="delay" type="range" min="0" max="${1000 * RANGES.delay[1]}" step="5" value="0"><output>0 ms</output></label>
<label>Seed <input class="seed" type="range" min="1" max="50" step="1" value="1"><output>1</output></label>
<label class="of-server">Scheduler <select class="scheduler"></select></label>
<label class="of-server">Anew <span><input class="anew" type="checkbox" checked> each loop begins with nothing</span></label>
<p class="where" role="status"></p>
<canvas class="levels" role="img" aria-label="Share of blocks by level over time"></canvas>
<canvas class="quality" role="img" aria-label="Estimated quality over time"></canvas>
<canvas class="bits" role="img" aria-label="Bits that arrived per second over time"></canvas>
<ul class="legend"></ul>
<p class="numbers" role="status"></p>`;

// What each control says, as conditions have it.
const READ = {
  loss: ({ value }) => value / 100,
  burst: ({ value }) => Number(value),
  rate: ({ value }) => (value > MOST_RATE ? 0 : 10 ** value),
  delay: ({ value }) => value / 1000,
  seed: ({ value }) => Number(value),
  scheduler: ({ value }) => value,
  anew: ({ checked }) => checked,
};

function rateText(rate) {
  if (rate === 0) return "no limit";
  const [unit, name] = rate < 1e6 ? [1e3, "kbit/s"] : [1e6, "Mbit/s"];
  return `${Number((rate / unit).toPrecision(2))} ${name}`;
}

// The link delays packets towards the viewer alone: a round trip takes as much longer.
function delayText(ms) {
  return ms > 0 ? `${ms} ms\nRTT +${ms}` : "0 ms";
}

export class NetworkPanel {
  #root;
  #engine;
  #history = [];
  // Estimated quality of each sample, 0 to 1.
  #qualities = [];
  // Bits per second of each sample, and bytes until the last one and its time.
  #bits = [];
  #until = null;
  #timer = 0;
  #colours = null;
  // What is asked for, and whether that is anything.
  #conditions = checkedConditions({ anew: true });
  #isSet = false;

  /** `engine()` is the engine of the player, or null. */
  constructor(root, engine) {
    this.#root = root;
    this.#engine = engine;
    root.innerHTML = PARTS;
    const options = SCHEDULERS.map((name) => new Option(name || "the server's", name));
    root.querySelector(".scheduler").replaceChildren(...options);
    root.addEventListener("input", ({ target }) => this.#ask(target));
  }

  #control(name) {
    return this.#root.querySelector(`.${name}`);
  }

  #say(name, text) {
    this.#root.querySelector(`.${name} + output`).textContent = text;
  }

  get #session() {
    return this.#engine()?.session ?? null;
  }

  /** Shows or hides; its part says so by an event `toggle`. */
  toggle() {
    this.#root.hidden = !this.#root.hidden;
    clearInterval(this.#timer);
    if (!this.#root.hidden) this.#timer = setInterval(() => this.#sample(), SAMPLE_MS);
    this.#root.dispatchEvent(new Event("toggle"));
  }

  /** Hides. */
  close() {
    if (!this.#root.hidden) this.toggle();
  }

  /** Another stream begins under the conditions that are set. */
  began() {
    [this.#history, this.#qualities, this.#bits, this.#until] = [[], [], [], null];
    this.#control("where").textContent = "";
    if (this.#isSet) this.#apply(this.#conditions);
  }

  /**
   * Sets the sliders, and the network to exactly this: share lost, mean run, bits per second (0: no limit), seconds of
   * delay, seed, scheduler, whether each round begins anew. The promise is kept once it holds.
   */
  set(conditions) {
    const checked = checkedConditions({ anew: true, ...conditions });
    const { loss, burst, rate, delay, seed, scheduler, anew } = checked;
    const slider = (name, value) => (this.#control(name).value = value);
    slider("loss", 100 * loss);
    slider("burst", burst);
    slider("rate", rate > 0 ? Math.log10(rate) : NO_LIMIT);
    slider("delay", 1000 * delay);
    slider("seed", seed);
    slider("scheduler", scheduler);
    this.#control("anew").checked = anew;
    return this.#apply(checked);
  }

  // Takes what one control says: others may show only roughly what was set.
  #ask(control) {
    const { className: name } = control;
    return this.#apply({ ...this.#conditions, [name]: READ[name](control) });
  }

  async #apply(conditions) {
    this.#conditions = conditions;
    const { loss, rate, delay, seed, scheduler } = conditions;
    const burst = meanBurst(loss, conditions.burst);
    this.#say("loss", `${Math.round(100 * loss)} %`);
    this.#say("burst", burst === 1 ? "1 packet" : `${burst} packets`);
    this.#say("rate", rateText(rate));
    this.#say("delay", delayText(Math.round(1000 * delay)));
    this.#say("seed", `${seed}`);
    this.#isSet = loss > 0 || rate > 0 || delay > 0 || scheduler !== "";
    // Without any of them, a clip that repeats keeps what it has.
    const anew = conditions.anew && this.#isSet;
    const asked = this.#session?.setConditions({ ...conditions, anew });
    this.#engine()?.request();
    const granted = await asked;
    if (!granted) return;
    this.#control("where").textContent = this.#isSet ? WHERE[Number(granted.link)] : "";
    this.#engine()?.request();
    this.#sample();
  }

  #sample() {
    const session = this.#session;
    if (!session || this.#root.hidden) return;
    const levels = session.levels();
    const blocks = Math.max(1, levels.reduce((sum, count) => sum + count, 0));
    this.#history.push([...levels].map((count) => count / blocks));
    if (this.#history.length > SAMPLES) this.#history.shift();
    this.#qualities.push(session.estimatedQuality);
    if (this.#qualities.length > SAMPLES) this.#qualities.shift();
    const ofServer = Boolean(session.server);
    this.#root.querySelectorAll(".of-server").forEach((row) => (row.hidden = !ofServer));
    const [came, decoded, bytes] = session.packets();
    const bits = this.#rateOf(bytes, performance.now());
    const share = ((100 * levels[0]) / blocks).toFixed(1);
    this.#root.querySelector(".numbers").textContent =
      `${decoded} of ${came} packets decoded; ${share} % of ${blocks} blocks by stand-ins; ` +
      `${(bits * 1e-6).toPrecision(2)} Mbit/s; quality about ${(100 * session.estimatedQuality).toFixed(1)} %`;
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
    this.#plotQuality();
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
    this.#name(pen, most > 1 ? `Mbit/s, top ${(most * 1e-6).toPrecision(2)}` : "Mbit/s");
  }

  // A line from 0, nothing but stand-ins, to 1, everything there.
  #plotQuality() {
    const { pen, height, step } = this.#pen("canvas.quality");
    pen.strokeStyle = "#9bd88a";
    pen.lineWidth = 2;
    pen.beginPath();
    this.#qualities.forEach((quality, k) => pen.lineTo((k + 0.5) * step, 1 + (height - 2) * (1 - quality)));
    pen.stroke();
    this.#name(pen, "quality, about; top 100 %");
  }

  #name(pen, text) {
    pen.fillStyle = "#f2f2f2";
    pen.font = "11px system-ui, sans-serif";
    pen.fillText(text, 4, pen.canvas.height - 4);
  }

  #plotLevels() {
    if (!this.#colours) {
      this.#colours = coloursOf("levels");
      this.#root.querySelector(".legend").replaceChildren(...legendItems(this.#colours, LEVEL_NAMES));
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
