// Attributes of a player that are its properties, too, as those of <video> are.

export class Attributes extends HTMLElement {
  get src() {
    return this.getAttribute("src");
  }

  set src(url) {
    if (url === null) this.removeAttribute("src");
    else this.setAttribute("src", url);
  }

  /** Whether a stream plays as soon as it begins: the attribute. */
  get autoplay() {
    return this.hasAttribute("autoplay");
  }

  set autoplay(plays) {
    this.toggleAttribute("autoplay", Boolean(plays));
  }

  /** Device pixels per CSS pixel: the attribute `pixel-ratio`; null for the display's own. */
  get pixelRatio() {
    const ratio = Number(this.getAttribute("pixel-ratio"));
    return ratio > 0 ? ratio : null;
  }

  set pixelRatio(ratio) {
    if (ratio > 0) this.setAttribute("pixel-ratio", ratio);
    else this.removeAttribute("pixel-ratio");
  }

  /** Whether less is drawn where pictures come late: but for the attribute `adapt="off"`. */
  get adaptive() {
    return this.getAttribute("adapt") !== "off";
  }

  set adaptive(adapts) {
    if (adapts) this.removeAttribute("adapt");
    else this.setAttribute("adapt", "off");
  }

  /** Whether there is a bar: the attribute. */
  get controls() {
    return this.hasAttribute("controls");
  }

  set controls(shown) {
    this.toggleAttribute("controls", Boolean(shown));
  }

  /** When streams begin, seconds: the attribute. What is played goes there, too. */
  get time() {
    return Number(this.getAttribute("time")) || 0;
  }

  set time(seconds) {
    if (Number.isFinite(seconds)) this.setAttribute("time", seconds);
  }
}
