// A live source receives packets from `dgs serve` on a link: SESSION.md has every message.

import { MOST_WAITING, Session } from "./session.js";

// Kinds of messages on the control stream.
const [HELLO, SEEK, BYE, MANIFEST, REFUSAL] = [0x01, 0x02, 0x03, 0x81, 0x82];
const MICROSECONDS = 1e6;
// No manifest within this, milliseconds, and the next transport is tried.
const PATIENCE_MS = 4000;
// A receipt leaves with every second packet, and this long after the last at the latest, milliseconds.
const RECEIPT_EVERY = 2;
const RECEIPT_INTERVAL_MS = 100;
// Seeks are this far apart at least, milliseconds: a server takes five a second.
const SEEK_INTERVAL_MS = 250;
// Without any media for this long after the manifest, it is wished for in streams, milliseconds.
const NO_DATAGRAMS_MS = 1000;

/**
 * Receives `stream` (of `/streams.json`) on the link that `open` opens; `began(session)` once its manifest is there,
 * `switched("streams")` once media is wished for in streams because no datagrams pass.
 */
export async function receive(stream, open, { began, came, player, signal, switched, worker }) {
  let link = null;
  const patience = new AbortController();
  const end = () => patience.abort();
  const late = setTimeout(end, PATIENCE_MS);
  signal.addEventListener("abort", end);
  try {
    link = await open(patience.signal);
    const rounds = new Rounds(link, player);
    await link.write(hello(stream.name, player.currentTime));
    if (link.inStreams) await link.useStreams();
    const { kind, body } = await message(link.control);
    clearTimeout(late);
    if (kind === REFUSAL) throw new Error(`The server refuses: ${new TextDecoder().decode(body.subarray(1))}`);
    if (kind !== MANIFEST) throw new Error(`The server sends a message of kind ${kind} in place of a manifest`);
    const session = await Session.receive(body, { worker });
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
  #player;
  #round = 0;
  #began = performance.now();
  #start = 0;
  #playout = 0;
  #receipts = 0;
  #seek = 0;
  // One receipt is made at a time, where the packets are.
  #saying = false;

  constructor(link, player) {
    this.#link = link;
    this.#player = player;
  }

  async receive(session, came, signal, switched) {
    const player = this.#player;
    this.#start = await session.roundStart(player.currentTime);
    const say = () => this.#receipt(session).catch(() => {});
    const timer = setInterval(say, RECEIPT_INTERVAL_MS);
    const seek = () => this.#seekSoon(session);
    const link = this.#link;
    const quiet = () => link.useStreams().then(() => switched("streams"), () => {});
    const waiting = link.inStreams === false ? setTimeout(quiet, NO_DATAGRAMS_MS) : 0;
    for (const event of ["loop", "seeked", "play"]) player.addEventListener(event, seek);
    try {
      for (let count = 1; ; count++) {
        const { value, done } = await this.#link.media.read();
        if (done || signal.aborted || player.session !== session) return;
        clearTimeout(waiting);
        const taken = session.push(value);
        if (session.waiting >= MOST_WAITING) await taken;
        came();
        if (count % RECEIPT_EVERY === 0) say();
      }
    } finally {
      clearInterval(timer);
      clearTimeout(waiting);
      clearTimeout(this.#seek);
      for (const event of ["loop", "seeked", "play"]) player.removeEventListener(event, seek);
      if (player.session === session) await this.#link.write(new Uint8Array([BYE, 0, 0, 0, 0])).catch(() => {});
    }
  }

  async #receipt(session) {
    if (this.#player.session !== session || this.#saying) return;
    // When the first frame of the round was, or would have been, shown.
    if (this.#playout === 0 && session.playing && session.time >= this.#start) {
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

  #seekSoon(session) {
    clearTimeout(this.#seek);
    const passed = performance.now() - this.#began;
    // A connection that is gone is found by who reads it.
    const now = () => this.#seekNow(session).catch(() => {});
    this.#seek = setTimeout(now, Math.max(0, SEEK_INTERVAL_MS - passed));
  }

  async #seekNow(session) {
    if (this.#player.session !== session) return;
    const { time } = session;
    const start = await session.roundStart(time);
    this.#round += 1;
    [this.#began, this.#playout, this.#receipts, this.#start] = [performance.now(), 0, 0, start];
    const bytes = new DataView(new ArrayBuffer(17));
    bytes.setUint8(0, SEEK);
    bytes.setUint32(1, 12, true);
    bytes.setUint32(5, this.#round, true);
    bytes.setBigUint64(9, BigInt(Math.round(time * MICROSECONDS)), true);
    await this.#link.write(new Uint8Array(bytes.buffer));
  }
}

function hello(name, time) {
  const called = new TextEncoder().encode(name);
  const bytes = new DataView(new ArrayBuffer(16 + called.length));
  bytes.setUint8(0, HELLO);
  bytes.setUint32(1, 11 + called.length, true);
  // Version 0; then a name, with its length before it.
  bytes.setBigUint64(6, BigInt(Math.round(time * MICROSECONDS)), true);
  bytes.setUint8(15, called.length);
  const all = new Uint8Array(bytes.buffer);
  all.set(called, 16);
  return all;
}

// One message of the control stream: its kind and its body.
async function message(reader) {
  let bytes = new Uint8Array(0);
  const wanted = () => (bytes.length < 5 ? 5 : 5 + new DataView(bytes.buffer).getUint32(1, true));
  while (bytes.length < wanted()) {
    const { value, done } = await reader.read();
    if (done) throw new Error("The server ends the control stream inside a message");
    const longer = new Uint8Array(bytes.length + value.length);
    longer.set(bytes);
    longer.set(value, bytes.length);
    bytes = longer;
  }
  return { kind: bytes[0], body: bytes.subarray(5) };
}
