// A live source receives packets from `dgs serve` on a link: SESSION.md has every message.

import { CONDITIONS, GRANTED, checkedConditions, conditionsBody, granted } from "./conditions.js";
import { MAX_WAITING, Session } from "./session.js";

// Kinds of messages on the control stream.
const [HELLO, SEEK, BYE, MANIFEST, REFUSAL, BEGIN] = [0x01, 0x02, 0x03, 0x81, 0x82, 0x83];
const MICROSECONDS = 1e6;
// No manifest within this, milliseconds, and the next transport is tried.
const TIMEOUT_MS = 4000;
// A receipt leaves with every second packet, and this long after the last at the latest, milliseconds.
const RECEIPT_EVERY = 2;
const RECEIPT_INTERVAL_MS = 100;
// Seeks are this far apart at least, milliseconds: a server takes five a second.
const SEEK_INTERVAL_MS = 250;
// A clip shorter than this, seconds, that repeats is not sent again.
const SHORTEST_ROUND_S = 1;
// Without any media for this long after the manifest, it is requested in streams, milliseconds.
const NO_DATAGRAMS_MS = 1000;
// A clock that has shown nothing of a stream that grows for so long is ahead of whoever makes it: it stands,
// and the newest window is asked for as often, milliseconds.
const AHEAD_MS = 1000;
// What of a player begins another round.
const TURNS = ["loop", "seeked", "play", "pause"];

/**
 * Receives `stream` (of `/streams.json`) on the link that `open` opens; `began(session)` once its manifest is there,
 * `switched("streams")` once media is requested in streams because no datagrams pass.
 */
export async function receive(stream, open, { began, came, player, signal, start, switched, worker }) {
  let link = null;
  const patience = new AbortController();
  const end = () => patience.abort();
  const late = setTimeout(end, TIMEOUT_MS);
  signal.addEventListener("abort", end);
  try {
    link = await open(patience.signal);
    const messages = new Messages(link.control);
    const rounds = new Rounds(link, messages, player);
    await link.write(hello(stream.name, start()));
    if (link.inStreams) await link.useStreams();
    const { kind, body } = await messages.next();
    clearTimeout(late);
    if (kind === REFUSAL) throw refused(body);
    if (kind !== MANIFEST) throw new Error(`The server sends a message of kind ${kind} in place of a manifest`);
    const session = await Session.receive(body, { worker });
    // From its first moment on: what was requested earlier is asked of the server, too.
    rounds.serve(session);
    await began(session);
    if (player.session === session) await rounds.receive(session, came, signal, switched);
  } finally {
    clearTimeout(late);
    signal.removeEventListener("abort", end);
    link?.close();
  }
}

// Rounds of playout: where each began, what was received in it, and what the server is told.
class Rounds {
  #link;
  #messages;
  #player;
  #round = 0;
  #began = performance.now();
  #start = 0;
  // Where the clock stood when the round began, seconds.
  #stood = 0;
  #playout = 0;
  #receipts = 0;
  #seek = 0;
  // One receipt is made at a time, where the packets are.
  #saying = false;
  // Conditions that the next round is to begin under, and whom to tell what came of those of a round.
  #wanted = null;
  #asked = null;
  // Whether every round begins with nothing.
  #anew = false;
  // Whether the stream grows: a round of it begins at its newest window.
  #grows = false;
  // When something of what the clock showed was there last, or the newest window was asked for;
  // and where what had been seen ended when the clock was found to be ahead, seconds.
  #cameAt = performance.now();
  #seenUntil = 0;
  // Why the server has ended the session.
  #refusal = null;

  constructor(link, messages, player) {
    this.#link = link;
    this.#messages = messages;
    this.#player = player;
  }

  /** Takes requests for other conditions. */
  serve(session) {
    session.server = async (conditions) => this.#ask(session, checkedConditions(conditions));
  }

  async receive(session, came, signal, switched) {
    const player = this.#player;
    const start = await session.roundStart(player.currentTime);
    // A request may have begun another round meanwhile.
    if (this.#round === 0) [this.#start, this.#stood] = [start, session.time];
    const say = () => this.#receipt(session).catch(() => {});
    const look = () => (this.#follow(session), say());
    const timer = setInterval(look, RECEIPT_INTERVAL_MS);
    const turn = ({ type }) => {
      if (player.session !== session) return;
      // A short clip is there: the server need not begin again several times a second.
      if (type === "loop" && session.duration < SHORTEST_ROUND_S) return;
      // Who stands in a stream that grows stays where they are.
      if (this.#grows && !session.playing) return;
      // Where somebody wants to go, they go, whether or not there is more by now.
      [session.isAhead, this.#cameAt] = [false, performance.now()];
      // A clock that stands has no deadlines: a round of its own brings what those of the one before left out.
      this.#seekSoon(session, type === "pause");
    };
    const link = this.#link;
    const quiet = () => link.useStreams().then(() => switched("streams"), () => {});
    const waiting = link.inStreams === false ? setTimeout(quiet, NO_DATAGRAMS_MS) : 0;
    for (const event of TURNS) player.addEventListener(event, turn);
    // What ends the control stream ends the session, too.
    this.#listen(session).catch(() => {});
    try {
      for (let count = 1; ; count++) {
        const { value, done } = await this.#link.media.read();
        if (done && this.#refusal) throw this.#refusal;
        if (done || signal.aborted || player.session !== session) return;
        clearTimeout(waiting);
        const taken = session.push(value);
        if (session.waiting >= MAX_WAITING) await taken;
        came();
        if (count % RECEIPT_EVERY === 0) say();
      }
    } finally {
      session.server = null;
      this.#wanted?.tell(null);
      this.#asked?.tell(null);
      clearInterval(timer);
      clearTimeout(waiting);
      clearTimeout(this.#seek);
      for (const event of TURNS) player.removeEventListener(event, turn);
      if (player.session === session) await this.#link.write(new Uint8Array([BYE, 0, 0, 0, 0])).catch(() => {});
    }
  }

  // Hears what the server says after the manifest.
  async #listen(session) {
    for (;;) {
      const { kind, body } = await this.#messages.next();
      const fields = new DataView(body.buffer, body.byteOffset, body.byteLength);
      if (kind === REFUSAL) this.#refusal = refused(body);
      if (kind !== BEGIN && kind !== GRANTED) continue;
      const round = fields.getUint32(0, true);
      if (kind === GRANTED && round === this.#asked?.round) {
        const [asked, holds] = [this.#asked, granted(fields.getUint8(4))];
        this.#asked = null;
        // A server that grants nothing sends nothing again either.
        this.#anew = asked.anew && holds.scheduler;
        if (this.#anew) await this.#restart(session);
        asked.tell(holds);
      }
      if (kind === BEGIN && round === this.#round && this.#player.session === session) {
        await this.#begin(session, Number(fields.getBigUint64(4, true)) / MICROSECONDS);
      }
    }
  }

  // A stream that grows: the round begins at its newest window, at `time`, seconds, whatever was asked for.
  async #begin(session, time) {
    // Its end is one: nothing of it is sent again.
    [this.#grows, session.grows, session.looping] = [true, true, false];
    // Who is ahead stands until there is a window that they have not seen.
    if (!session.isAhead || time >= this.#seenUntil) {
      session.goOn(time);
      this.#cameAt = performance.now();
    }
    this.#stood = session.time;
    this.#start = await session.roundStart(session.time);
  }

  // Finds that the clock is ahead of whoever makes a stream that grows: all that comes is over by then, and
  // the server sends nothing.
  #follow(session) {
    if (!this.#grows || this.#player.session !== session) return;
    const now = performance.now();
    // The clock of a page that nobody sees stands.
    const stands = !session.playing || document.hidden;
    if (stands || (session.hasCome && !session.isAhead)) this.#cameAt = now;
    if (now - this.#cameAt < AHEAD_MS) return;
    if (!session.isAhead) this.#seenUntil = session.seenUntil;
    [this.#cameAt, session.isAhead] = [now, true];
    this.#seekSoon(session, true);
  }

  // Begins a round under `conditions`; resolves with what is granted, null where later ones came first.
  #ask(session, conditions) {
    return new Promise((tell) => {
      this.#wanted?.tell(null);
      this.#wanted = { conditions, tell };
      this.#seekSoon(session);
    });
  }

  async #receipt(session) {
    // Until conditions are granted, what is there may be forgotten: the server would never send it again.
    if (this.#player.session !== session || this.#saying || this.#asked) return;
    // When the first frame of the round was, or would have been, shown. A clock that waits for its base has shown
    // nothing: deadlines counted from now would be over before the base is there.
    const runs = session.playing && session.time !== this.#stood;
    if (this.#playout === 0 && runs && session.time >= this.#start) {
      const shown = performance.now() - (1000 * (session.time - this.#start)) / Math.max(0.1, session.rate);
      this.#playout = Math.max(1, Math.round(1000 * (shown - this.#began)));
    }
    const round = this.#round;
    this.#saying = true;
    const receipt = await session.receipt(this.#receipts++, this.#playout).finally(() => (this.#saying = false));
    const datagram = new Uint8Array(4 + receipt.length);
    new DataView(datagram.buffer).setUint32(0, round, true);
    datagram.set(receipt, 4);
    await this.#link.send(datagram);
  }

  // Begins a round; one that `keeps` what is there does so even where rounds begin with nothing.
  #seekSoon(session, keeps = false) {
    clearTimeout(this.#seek);
    const passed = performance.now() - this.#began;
    // A connection that is gone is found by who reads it.
    const now = () => this.#seekNow(session, keeps).catch(() => {});
    this.#seek = setTimeout(now, Math.max(0, SEEK_INTERVAL_MS - passed));
  }

  async #seekNow(session, keeps) {
    if (this.#player.session !== session) return;
    const { time } = session;
    const start = await session.roundStart(time);
    this.#round += 1;
    [this.#began, this.#playout, this.#receipts, this.#start] = [performance.now(), 0, 0, start];
    this.#stood = session.time;
    const body = new DataView(new ArrayBuffer(12));
    body.setUint32(0, this.#round, true);
    body.setBigUint64(4, BigInt(Math.round(time * MICROSECONDS)), true);
    const seek = new Uint8Array(body.buffer);
    const wanted = this.#wanted;
    if (wanted) {
      this.#asked?.tell(null);
      const { conditions, tell } = wanted;
      [this.#wanted, this.#asked] = [null, { round: this.#round, tell, anew: conditions.anew ?? false }];
    } else if (this.#anew && !keeps) await this.#restart(session);
    const message = wanted ? framed(CONDITIONS, seek, conditionsBody(wanted.conditions)) : framed(SEEK, seek);
    await this.#link.write(message);
  }

  // Forgets what is there; the clock waits from here on.
  async #restart(session) {
    await session.restart();
    this.#stood = session.time;
  }
}

function refused(body) {
  const message = `The server refuses: ${new TextDecoder().decode(body.subarray(1))}`;
  return Object.assign(new Error(message), { isRefusal: true });
}

// A message of the control stream.
function framed(kind, ...parts) {
  const length = parts.reduce((sum, part) => sum + part.length, 0);
  const bytes = new Uint8Array(5 + length);
  bytes[0] = kind;
  new DataView(bytes.buffer).setUint32(1, length, true);
  let at = 5;
  for (const part of parts) {
    bytes.set(part, at);
    at += part.length;
  }
  return bytes;
}

// Version 0; then a name, with its length before it.
function hello(name, time) {
  const called = new TextEncoder().encode(name);
  const fields = new DataView(new ArrayBuffer(11));
  fields.setBigUint64(1, BigInt(Math.round(time * MICROSECONDS)), true);
  fields.setUint8(10, called.length);
  return framed(HELLO, new Uint8Array(fields.buffer), called);
}

// Messages of a control stream, one after the other.
class Messages {
  #reader;
  #bytes = new Uint8Array(0);

  constructor(reader) {
    this.#reader = reader;
  }

  /** The next one: its kind and its body. */
  async next() {
    const wanted = () => (this.#bytes.length < 5 ? 5 : 5 + new DataView(this.#bytes.buffer).getUint32(1, true));
    while (this.#bytes.length < wanted()) {
      const { value, done } = await this.#reader.read();
      if (done) throw new Error("The server ends the control stream inside a message");
      const longer = new Uint8Array(this.#bytes.length + value.length);
      longer.set(this.#bytes);
      longer.set(value, this.#bytes.length);
      this.#bytes = longer;
    }
    const message = this.#bytes.slice(0, wanted());
    this.#bytes = this.#bytes.slice(wanted());
    return { kind: message[0], body: message.subarray(5) };
  }
}
