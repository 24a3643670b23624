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
