// The page plays what is dropped, chosen, named by ?src=, or served beside it, and keeps the view in its address.

import { PASSING_MS } from "./bar.js";
import "./dgs-player.js";

const player = document.querySelector("dgs-player");
const welcome = document.getElementById("welcome");
const parameters = new URLSearchParams(location.search);
// What the address says last is written this long after the last move, milliseconds.
const SETTLED_MS = 300;

function readAddress() {
  const link = new URLSearchParams(location.hash.slice(1));
  const numbers = (link.get("view") ?? "").split(",").map(Number);
  if (link.get("up")) player.setAttribute("up", link.get("up"));
  if (numbers.length === 6 && numbers.every(Number.isFinite)) player.view = numbers;
  if (link.has("t")) player.setAttribute("time", link.get("t"));
  return link.has("t");
}

function writeAddress() {
  const link = new URLSearchParams();
  link.set("t", player.currentTime.toFixed(3));
  link.set("view", player.view.map((number) => Number(number.toPrecision(6))).join(","));
  if (player.hasAttribute("up")) link.set("up", player.getAttribute("up"));
  history.replaceState(null, "", `#${decodeURIComponent(link.toString())}`);
}

let settling = 0;
for (const event of ["camerachange", "pause", "seeked"]) {
  player.addEventListener(event, () => {
    clearTimeout(settling);
    settling = setTimeout(() => player.session && writeAddress(), SETTLED_MS);
  });
}
addEventListener("hashchange", readAddress);

async function play(file) {
  const { hidden } = welcome;
  welcome.hidden = true;
  await player.open(file);
  // Whoever brought something else is asked again, once they have read so.
  if (!hidden && !player.session) setTimeout(() => (welcome.hidden = player.session !== null), PASSING_MS);
}

// On this page keys are the player's wherever nothing else has the focus.
for (const name of ["keydown", "keyup"]) {
  addEventListener(name, (event) => {
    if (event.target !== document.body) return;
    if (!player.dispatchEvent(new KeyboardEvent(name, event))) event.preventDefault();
  });
}

document.getElementById("pick").addEventListener("change", ({ target }) => target.files[0] && play(target.files[0]));
addEventListener("dragover", (event) => {
  event.preventDefault();
  document.body.classList.add("over");
});
addEventListener("dragleave", (event) => event.relatedTarget || document.body.classList.remove("over"));
addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  const [file] = event.dataTransfer.files;
  if (file) play(file);
});

for (const name of ["up", "quality", "background", "pixel-ratio", "worker", "adapt"]) {
  if (parameters.has(name)) player.setAttribute(name, parameters.get(name));
}
// A link to an instant shows that instant.
if (readAddress() || parameters.has("paused")) player.removeAttribute("autoplay");
if (parameters.has("src")) {
  welcome.hidden = true;
  player.src = parameters.get("src");
} else {
  playServed();
}

// What the server of this page offers, if it is one that does: it says so in the page.
async function playServed() {
  const address = document.querySelector("meta[name=dgs-streams]")?.content;
  const answer = address ? await fetch(address).catch(() => null) : null;
  if (!answer?.ok || !/json/.test(answer.headers.get("Content-Type") ?? "")) return;
  const served = (await answer.json()).filter((stream) => stream.file || stream.web_address);
  if (served.length === 0 || player.src) return;
  welcome.hidden = true;
  const requested = parameters.get("stream");
  const shown = served.find((stream) => stream.name === requested) ?? served[0];
  player.playServed(shown, parameters.get("transport"));
  if (served.length < 2) return;
  const list = document.getElementById("streams");
  list.hidden = false;
  list.replaceChildren(
    ...served.map((stream) => {
      const link = document.createElement("a");
      [link.href, link.textContent] = [`?stream=${encodeURIComponent(stream.name)}`, stream.name];
      if (stream === shown) link.setAttribute("aria-current", "page");
      return link;
    }),
  );
}
if (!navigator.gpu) welcome.hidden = true;
