// A legend has the colours of an overlay beside what they mean.

import { overlayColours } from "./dgs_viewer.js";
import { LEVEL_NAMES, OVERLAYS } from "./session.js";

// What blocks are painted by and what the colours of each overlay mean, in their order, as shown on the picture.
const PAINTED = {
  none: ["", []],
  levels: ["Painted by level", LEVEL_NAMES],
  arrivals: ["Painted by what just came", ["a level came now", "none for a second"]],
  missing: ["Painted by utility of what is missing (estimated)", ["most", "", "", "", "nothing"]],
};

/** `overlay`'s colours, as lists of `rgb()`. */
export function coloursOf(overlay) {
  const all = [...overlayColours(OVERLAYS.indexOf(overlay))].map((v) => Math.round(255 * v));
  return Array.from({ length: all.length / 3 }, (_, k) => `rgb(${all.slice(3 * k, 3 * k + 3)})`);
}

/** Items of a legend: each colour beside its name. */
export function legendItems(colours, names) {
  return colours.map((colour, k) => {
    const [item, sample] = [document.createElement("li"), document.createElement("i")];
    sample.style.background = colour;
    item.append(sample, names[k]);
    return item;
  });
}

/** Shows on `part` what blocks are painted by. */
export function showLegend(part, overlay) {
  if (part.dataset.overlay === overlay) return;
  part.dataset.overlay = overlay;
  const [text, names] = PAINTED[overlay];
  const list = document.createElement("ul");
  list.className = "legend";
  list.append(...legendItems(overlay === OVERLAYS[0] ? [] : coloursOf(overlay), names));
  part.replaceChildren(...(text ? [text, list] : []));
}
