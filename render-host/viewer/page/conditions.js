// Conditions are what a viewer asks of a server for its own session: a scheduler and an emulated link. SESSION.md has
// every byte.

/** Kinds of the messages that carry them, and what is granted. */
export const [CONDITIONS, GRANTED] = [0x06, 0x84];

/** Schedulers that a server can be asked for; the place is the number, the first is the server's own. */
export const SCHEDULERS = ["", "layered", "dash", "dependency", "deadline-utility", "deadline-utility-paper"];

const MAX_LOSS = 0.9;
const RATES = [1e3, 1e9];
const MAX_DELAY_S = 1;

/** The fields after round and start, brought within their bounds. */
export function conditionsBody({ anew = false, scheduler = "", rate = 0, delay = 0, loss = 0, burst = 1, seed = 1 }) {
  const within = (value, least, most) => Math.round(Math.max(least, Math.min(most, value)));
  const body = new DataView(new ArrayBuffer(22));
  body.setUint8(0, anew ? 1 : 0);
  body.setUint8(1, Math.max(0, SCHEDULERS.indexOf(scheduler)));
  body.setBigUint64(2, BigInt(rate > 0 ? within(rate, ...RATES) : 0), true);
  body.setUint32(10, within(1e6 * delay, 0, 1e6 * MAX_DELAY_S), true);
  body.setUint16(14, within(1e4 * loss, 0, 1e4 * MAX_LOSS), true);
  body.setUint16(16, within(burst, 1, 1000), true);
  body.setUint32(18, seed >>> 0, true);
  return new Uint8Array(body.buffer);
}

/** What flags grant. */
export function granted(flags) {
  return { link: (flags & 1) !== 0, scheduler: (flags & 2) !== 0 };
}
