// Input moves the camera: pointers, wheel, fingers, keys.

// Share of the distance, radians' worth of pixels and factor that one press of a key moves.
const FLY = 0.08;
const TURN = 24;
const ZOOM = 1.15;
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
    w: camera((s) => s.fly(0, 0, FLY)),
    s: camera((s) => s.fly(0, 0, -FLY)),
    a: camera((s) => s.fly(-FLY, 0, 0)),
    d: camera((s) => s.fly(FLY, 0, 0)),
    q: camera((s) => s.fly(0, -FLY, 0)),
    e: camera((s) => s.fly(0, FLY, 0)),
    0: () => player.home(),
    u: () => player.nextUp(),
    1: () => (player.quality = 0),
    2: () => (player.quality = 1),
    3: () => (player.quality = 2),
    4: () => (player.quality = 3),
    o: () => player.nextOverlay(),
    n: () => player.toggleNetwork(),
    l: () => (player.loop = !player.loop),
    f: () => player.toggleFullscreen(),
    "?": () => player.showHelp(),
  };
  const shifted = {
    ArrowLeft: camera((s) => s.pan(TURN, 0, height())),
    ArrowRight: camera((s) => s.pan(-TURN, 0, height())),
    ArrowUp: camera((s) => s.pan(0, TURN, height())),
    ArrowDown: camera((s) => s.pan(0, -TURN, height())),
  };
  player.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !player.session) return;
    // A control that has the focus keeps its own keys; a button is pressed by the space bar.
    const focus = event.composedPath()[0];
    if (focus.closest?.("dialog") && event.key !== "?") return;
    const own = ["INPUT", "SELECT"].includes(focus.tagName) && event.key !== "?";
    if (own || (focus.tagName === "BUTTON" && event.key === " ")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
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
