// Conditions are what a viewer asks of a server for its own session: a scheduler and an emulated link. SESSION.md has
// every byte.

/** Kinds of the messages that carry them, and what is granted. */
export const [CONDITIONS, GRANTED] = [0x06, 0x84];

/** Schedulers that a server can be asked for; the place is the number, the first is the server's own. */
export const SCHEDULERS = ["", "layered", "dash", "dependency", "deadline-utility", "deadline-utility-paper"];

/** The least and the most of each number, wherever the network is emulated; a rate of 0 is none. */
export const RANGES = { loss: [0, 0.9], burst: [1, 100], rate: [1e3, 1e9], delay: [0, 1], seed: [0, 2 ** 32 - 1] };
const UNITS = { loss: "", burst: " packets", rate: " bit/s, or 0 for no limit,", delay: " seconds", seed: ", whole numbers," };

/** `conditions` with what they leave out; a RangeError for what is not allowed. */
export function checkedConditions(conditions) {
  const given = Object.entries(conditions).filter(([, value]) => value !== undefined);
  const none = { loss: 0, burst: 1, rate: 0, delay: 0, seed: 1, scheduler: "" };
  const checked = { ...none, ...Object.fromEntries(given) };
  for (const [name, [least, most]] of Object.entries(RANGES)) {
    const value = checked[name];
    const isAllowed = Number.isFinite(value) && value >= least && value <= most;
    const isNone = name === "rate" && value === 0;
    if ((isAllowed && (name !== "seed" || Number.isInteger(value))) || isNone) continue;
    throw new RangeError(`${name}: ${value}; ${least} to ${most}${UNITS[name]} are allowed`);
  }
  if (SCHEDULERS.includes(checked.scheduler)) return checked;
  const names = ['"" (the server\'s own)', ...SCHEDULERS.slice(1)].join(", ");
  throw new RangeError(`scheduler: ${checked.scheduler}; ${names} are allowed`);
}

/** The mean number of packets lost in a row: what is asked for, but no fewer than it takes to lose so many. */
export function meanBurst(loss, burst) {
  const lost = Math.round(1e4 * loss);
  return burst > 1 ? Math.max(burst, Math.ceil(lost / (1e4 - lost))) : burst;
}

/** The fields after round and start of conditions that were checked. */
export function conditionsBody({ anew = false, scheduler, rate, delay, loss, burst, seed }) {
  const body = new DataView(new ArrayBuffer(22));
  body.setUint8(0, anew ? 1 : 0);
  body.setUint8(1, SCHEDULERS.indexOf(scheduler));
  body.setBigUint64(2, BigInt(Math.round(rate)), true);
  body.setUint32(10, Math.round(1e6 * delay), true);
  body.setUint16(14, Math.round(1e4 * loss), true);
  body.setUint16(16, Math.round(meanBurst(loss, burst)), true);
  body.setUint32(18, seed, true);
  return new Uint8Array(body.buffer);
}

/** What flags grant. */
export function granted(flags) {
  return { link: (flags & 1) !== 0, scheduler: (flags & 2) !== 0 };
}
