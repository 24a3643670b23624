// Input moves the camera: pointers, wheel, fingers, keys.

// Share of the distance, radians' worth of pixels and factor that one press of a key moves.
const STEP = 0.04;
const TURN = 24;
const ZOOM = 1.15;
// Shares of the distance that a held key flies in a second, and how many times as fast with Shift.
const FLY = 1.5;
const FASTER = 3;
// The bar goes so long after the last move, while the clip plays, milliseconds.
const IDLE_MS = 3000;

/** Every key, and what it does. */
export const KEYS = [
  ["Space", "play or pause"],
  [", .", "one frame back or on"],
  ["Home End", "to the start or the end"],
  ["drag, arrows", "turn around the scene"],
  ["right drag, two fingers, Shift + arrows", "pan"],
  ["wheel, pinch, + −", "nearer or farther"],
  ["W A S D Q E, held together; Shift: faster", "fly"],
  ["0", "first view"],
  ["U", "another way up"],
  ["1 2 3 4", "highest level shown"],
  ["O", "paint blocks by level, by what just came, by the utility of what is missing"],
  ["N", "network"],
  ["L", "loop"],
  ["B", "another background"],
  ["R", "draw less where pictures come late, or never"],
  ["F", "full screen"],
  ["?", "these keys"],
];

/** Drags turn, right drags and two fingers pan, wheel and pinch zoom. */
export function bindPointers(canvas, session, moved) {
  const down = new Map();
  const middle = () => {
    const all = [...down.values()];
    const sum = (pick) => all.reduce((total, pointer) => total + pick(pointer), 0) / all.length;
    const [x, y] = [sum((p) => p.x), sum((p) => p.y)];
    return { x, y, spread: sum((p) => Math.hypot(p.x - x, p.y - y)) };
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const shown = session();
    if (!down.has(event.pointerId) || !shown) return;
    const before = middle();
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const after = middle();
    const [dx, dy, height] = [after.x - before.x, after.y - before.y, canvas.clientHeight];
    if (down.size > 1) {
      shown.pan(dx, dy, height);
      if (before.spread > 1 && after.spread > 1) shown.zoom(after.spread / before.spread);
    } else if (event.buttons & 2 || event.shiftKey) {
      shown.pan(dx, dy, height);
    } else {
      shown.turn(dx, dy, height);
    }
    moved();
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => down.delete(event.pointerId));
  }
  const wheel = (event) => {
    const shown = session();
    if (!shown) return;
    event.preventDefault();
    shown.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015)));
    moved();
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
}

// Directions of keys: right, up, forward.
const DIRECTIONS = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0] };

/** Flies while keys are held, any of them together. */
class Flying {
  #held = new Set();
  #isFast = false;
  #then = 0;
  #fly;

  /** `fly` moves by shares of the distance: right, up, forward. */
  constructor(fly) {
    this.#fly = fly;
  }

  /** Takes a key that is pressed, or pressed still; false if it is no key to fly by. */
  press(key, isFast) {
    if (!(key in DIRECTIONS)) return false;
    this.#isFast = isFast;
    if (this.#held.has(key)) return true;
    // A touch moves a little at once.
    this.#move([key], STEP);
    this.#held.add(key);
    if (this.#held.size === 1) this.#begin();
    return true;
  }

  /** A key is let go. */
  release(key, isFast) {
    this.#isFast = isFast;
    this.#held.delete(key);
  }

  /** All keys are let go: without the focus no event says so. */
  stop() {
    this.#held.clear();
  }

  #move(keys, share) {
    const sum = (axis) => keys.reduce((total, key) => total + DIRECTIONS[key][axis], 0) * share;
    this.#fly(sum(0), sum(1), sum(2));
  }

  #begin() {
    this.#then = performance.now();
    const step = (now) => {
      if (this.#held.size === 0) return;
      // A page that was hidden for long does not jump.
      const seconds = Math.min(Math.max(0, now - this.#then) / 1000, 0.1);
      this.#then = now;
      this.#move([...this.#held], FLY * (this.#isFast ? FASTER : 1) * seconds);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
}

// Keys that a slider has itself.
const OF_SLIDERS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];

// Whether `key` is of the part that has the focus, and not of the player.
function isOwn({ tagName, type }, key) {
  if (type === "range") return OF_SLIDERS.includes(key);
  // They are pressed by the space bar.
  if (tagName === "BUTTON" || ["checkbox", "color"].includes(type)) return key === " ";
  // A list finds its entries by their letters.
  return ["INPUT", "SELECT"].includes(tagName) && key !== "?";
}

/** Keys of a player that has the focus. */
export function bindKeys(player, canvas, moved) {
  const camera = (act) => () => {
    act(player.session);
    moved();
  };
  const height = () => canvas.clientHeight;
  const plain = {
    " ": () => player.toggle(),
    k: () => player.toggle(),
    ",": () => player.step(-1),
    ".": () => player.step(1),
    Home: () => (player.currentTime = 0),
    End: () => (player.currentTime = player.duration),
    ArrowLeft: camera((s) => s.turn(TURN, 0, height())),
    ArrowRight: camera((s) => s.turn(-TURN, 0, height())),
    ArrowUp: camera((s) => s.turn(0, TURN, height())),
    ArrowDown: camera((s) => s.turn(0, -TURN, height())),
    "+": camera((s) => s.zoom(ZOOM)),
    "=": camera((s) => s.zoom(ZOOM)),
    "-": camera((s) => s.zoom(1 / ZOOM)),
    0: () => player.home(),
    u: () => player.nextUp(),
    1: () => (player.quality = 0),
    2: () => (player.quality = 1),
    3: () => (player.quality = 2),
    4: () => (player.quality = 3),
    o: () => player.nextOverlay(),
    n: () => player.toggleNetwork(),
    l: () => (player.loop = !player.loop),
    b: () => player.nextBackground(),
    r: () => (player.adaptive = !player.adaptive),
    f: () => player.toggleFullscreen(),
    "?": () => player.showHelp(),
  };
  const shifted = {
    ArrowLeft: camera((s) => s.pan(TURN, 0, height())),
    ArrowRight: camera((s) => s.pan(-TURN, 0, height())),
    ArrowUp: camera((s) => s.pan(0, TURN, height())),
    ArrowDown: camera((s) => s.pan(0, -TURN, height())),
  };
  const flying = new Flying((right, up, forward) => {
    player.session?.fly(right, up, forward);
    moved();
  });
  player.addEventListener("keyup", (event) => flying.release(event.key.toLowerCase(), event.shiftKey));
  player.addEventListener("focusout", () => flying.stop());
  window.addEventListener("blur", () => flying.stop());
  // Who chose from a list by a pointer has no more use for its keys; who walks through it by keys has.
  canvas.getRootNode().addEventListener("change", ({ target }) => {
    const isList = target.tagName === "SELECT";
    if (isList && !target.matches(":focus-visible")) canvas.focus({ preventScroll: true });
  });
  player.addEventListener("keydown", (event) => {
    if (event.key === "Shift") flying.release("", true);
    if (event.ctrlKey || event.metaKey || event.altKey || !player.session) return;
    const focus = event.composedPath()[0];
    // One that has just closed may have it still.
    if (focus.closest?.("dialog[open]") && event.key !== "?") return;
    if (isOwn(focus, event.key)) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (flying.press(key, event.shiftKey)) {
      event.preventDefault();
      return;
    }
    const act = (event.shiftKey && shifted[key]) || plain[key];
    if (!act) return;
    event.preventDefault();
    act();
  });
}

/** Nobody who only looks needs the bar; whoever moves, or has the focus on it, does. */
export function bindIdle(player, bar) {
  let timer = 0;
  const sleep = () => {
    if (player.paused || bar.matches(":hover") || bar.querySelector(":focus-visible")) return;
    bar.classList.add("idle");
  };
  const wake = () => {
    bar.classList.remove("idle");
    clearTimeout(timer);
    timer = setTimeout(sleep, IDLE_MS);
  };
  for (const event of ["pointermove", "pointerdown", "keydown", "focusin", "play", "pause"]) {
    player.addEventListener(event, wake);
  }
}
