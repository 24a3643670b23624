// The bar shows how a player stands, and lets a person change that; it is built here, with everything around it.

import { KEYS } from "./input.js";
import { showLegend } from "./legend.js";
import { LEVELS, OVERLAYS } from "./session.js";
import { STYLE } from "./style.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
/** How long a sentence that goes away is there, milliseconds. */
export const PASSING_MS = 6000;
/** Backgrounds that a key goes through. */
export const BACKGROUNDS = ["#000000", "#404040", "#bfbfbf", "#ffffff"];
const QUALITIES = ["base", "level 1", "level 2", "all levels"];
const TEMPLATE = `
<style>${STYLE}</style>
<canvas class="picture" part="picture" tabindex="0" role="img" aria-label="Moving scene; press ? for keys"></canvas>
<p class="message" role="status" aria-live="polite"></p>
<div class="notes">
  <p class="reduced" role="status"></p>
  <div class="painted" role="status"></div>
</div>
<section class="network" aria-label="Network" hidden></section>
<div class="bar" part="controls" role="group" aria-label="Player">
  <button class="play" aria-label="Play" title="Play (Space)">▶</button>
  <input class="time" type="range" min="0" max="1" step="any" value="0" aria-label="Time">
  <span class="clock" aria-hidden="true">0.0 / 0.0</span>
  <select class="speed" aria-label="Speed" title="Speed"></select>
  <button class="loop" aria-label="Loop" title="Loop (L)" aria-pressed="true">↻</button>
  <select class="quality" aria-label="Highest level shown" title="Highest level shown (1 to 4)"></select>
  <input class="background wide" type="color" value="#000000" aria-label="Background" title="Background (B)">
  <button class="paint" aria-label="Paint blocks" title="Paint blocks: none (O)" aria-pressed="false">◩</button>
  <button class="adapt" aria-label="Draw less where pictures come late" aria-pressed="true">½</button>
  <button class="net" aria-label="Network" title="Network (N)" aria-pressed="false">⇅</button>
  <button class="whole" aria-label="Full screen" title="Full screen (F)"><svg width="14" height="14" viewBox="0 0 14 14" fill="none" stroke="currentColor" stroke-width="2" aria-hidden="true"><path d="M1 5V1h4M9 1h4v4M13 9v4H9M5 13H1V9"/></svg></button>
  <button class="help" aria-label="Keys" title="Keys (?)">?</button>
</div>
<dialog aria-label="Keys"><dl></dl><form method="dialog"><button>Close</button></form></dialog>`;

/** Puts the parts of a player into its shadow tree. */
export function build(root) {
  root.innerHTML = TEMPLATE;
  const options = (select, values, labels, chosen) =>
    root
      .querySelector(select)
      .replaceChildren(...values.map((value, k) => new Option(labels[k], value, value === chosen, value === chosen)));
  options(".speed", SPEEDS, SPEEDS.map((speed) => `${speed}×`), 1);
  options(".quality", [...QUALITIES.keys()], QUALITIES, LEVELS - 1);
  const rows = KEYS.map(([key, does]) => `<dt><kbd>${key}</kbd></dt><dd>${does}</dd>`);
  root.querySelector("dialog dl").innerHTML = rows.join("");
  // The network panel keeps clear of the bar, however many rows that has.
  const [bar, network] = [root.querySelector(".bar"), root.querySelector(".network")];
  const keepClear = () => network.style.setProperty("--bar", `${bar.offsetHeight}px`);
  new ResizeObserver(keepClear).observe(bar);
}

/** Lets the controls change `player`. */
export function bindControls(root, player) {
  const on = (part, event, act) => root.querySelector(part).addEventListener(event, act);
  on(".play", "click", () => player.toggle());
  on(".time", "input", ({ target }) => (player.currentTime = Number(target.value)));
  on(".speed", "change", ({ target }) => (player.playbackRate = Number(target.value)));
  on(".quality", "change", ({ target }) => (player.quality = Number(target.value)));
  on(".loop", "click", () => (player.loop = !player.loop));
  on(".background", "input", ({ target }) => (player.background = target.value));
  on(".paint", "click", () => player.nextOverlay());
  on(".adapt", "click", () => (player.adaptive = !player.adaptive));
  on(".net", "click", () => player.toggleNetwork());
  on(".whole", "click", () => player.toggleFullscreen());
  on(".help", "click", () => player.showHelp());
  const pressed = ({ target }) => root.querySelector(".net").setAttribute("aria-pressed", !target.hidden);
  on(".network", "toggle", pressed);
}

/** Shows `player` on the whole display, or no longer; `refused()` where that cannot be. */
export function toggleFullscreen(player, refused) {
  if (document.fullscreenElement) document.exitFullscreen();
  else if (player.requestFullscreen) player.requestFullscreen().catch(refused);
  else refused();
}

/** Shows the keys, or hides them. */
export function toggleHelp(root) {
  const dialog = root.querySelector("dialog");
  if (dialog.open) dialog.close();
  else dialog.showModal();
  // The focus is on the button at its end.
  dialog.scrollTop = 0;
}

/** What is said on the picture: a sentence that stays, and over it one that goes away. */
export class Message {
  #part;
  #lasting = "";
  #timer = 0;

  constructor(part) {
    this.#part = part;
  }

  /**
   * Says `text`, empty for nothing, until something else is said; if it `passes`, for a while over what was said.
   * What passes is seen to its end unless there is something else to say.
   */
  say(text, passes = false) {
    if (!passes) this.#lasting = text;
    if (text === "" && this.#timer !== 0) return;
    clearTimeout(this.#timer);
    this.#timer = passes ? setTimeout(() => this.#passed(), PASSING_MS) : 0;
    this.#part.textContent = text;
  }

  /** Nothing is said any more, not even what passes. */
  clear() {
    this.#lasting = "";
    this.#passed();
  }

  #passed() {
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#part.textContent = this.#lasting;
  }
}

/** Shows where the clock of `player` is. */
export function showTime(root, { currentTime, duration, paused }) {
  const time = root.querySelector(".time");
  if (root.activeElement !== time || !paused) time.value = currentTime;
  time.setAttribute("aria-valuetext", `${currentTime.toFixed(1)} of ${duration.toFixed(1)} seconds`);
  root.querySelector(".clock").textContent = `${currentTime.toFixed(1)} / ${duration.toFixed(1)}`;
}

/** Shows everything else of `player`. */
export function showState(root, player) {
  const { duration, loop, overlay, paused, playbackRate, quality, session } = player;
  const part = (name) => root.querySelector(`.${name}`);
  part("play").textContent = paused ? "▶" : "❚❚";
  part("play").setAttribute("aria-label", paused ? "Play" : "Pause");
  part("time").max = Number.isFinite(duration) ? duration : 1;
  part("loop").setAttribute("aria-pressed", loop);
  part("paint").setAttribute("aria-pressed", overlay !== OVERLAYS[0]);
  part("paint").title = `Paint blocks: ${overlay} (O)`;
  showLegend(part("painted"), session ? overlay : OVERLAYS[0]);
  part("adapt").setAttribute("aria-pressed", player.adaptive);
  part("adapt").title = `Draw less where pictures come late: ${player.adaptive ? "on" : "off"} (R)`;
  part("reduced").textContent = session?.reduced ? `Keeping up with ${session.reduced}` : "";
  part("quality").value = quality;
  part("speed").value = playbackRate;
}
