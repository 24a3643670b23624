// A live source receives packets from `dgs serve` over WebTransport: SESSION.md has every message.

import { Session } from "./dgs_viewer.js";

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
// The window for packets that wait for this page.
const WAITING_PACKETS = 4096;

/** Whether this browser can, and the server does. */
export function canReceive(stream) {
  return "WebTransport" in globalThis && Boolean(stream.web_address);
}

/** Receives `stream` (of `/streams.json`) for `player`; `began(session)` once its manifest is there. */
export async function receive(stream, { began, came, player, signal }) {
  const digits = await (await fetch("certificate.sha256", { signal })).text();
  const value = Uint8Array.from(digits.trim().match(/../g) ?? [], (pair) => parseInt(pair, 16));
  const serverCertificateHashes = [{ algorithm: "sha-256", value }];
  const transport = new WebTransport(stream.web_address, { serverCertificateHashes });
  const late = setTimeout(() => transport.close(), PATIENCE_MS);
  signal.addEventListener("abort", () => transport.close());
  try {
    await transport.ready;
    // By default one packet waits.
    transport.datagrams.incomingHighWaterMark = WAITING_PACKETS;
    transport.datagrams.incomingMaxBufferedDatagrams = WAITING_PACKETS;
    const control = await transport.createBidirectionalStream();
    const writer = control.writable.getWriter();
    const rounds = new Rounds(writer, transport, player);
    await writer.write(hello(stream.name, player.currentTime));
    const { kind, body } = await message(control.readable.getReader());
    clearTimeout(late);
    if (kind === REFUSAL) throw new Error(`The server refuses: ${new TextDecoder().decode(body.subarray(1))}`);
    if (kind !== MANIFEST) throw new Error(`The server sends a message of kind ${kind} in place of a manifest`);
    const session = Session.receive(body);
    began(session);
    await rounds.receive(session, came, signal);
  } finally {
    clearTimeout(late);
    transport.close();
  }
}

// Rounds of playout: where each began, what was received in it, and what the server is told.
class Rounds {
  #writer;
  #transport;
  #player;
  #round = 0;
  #began = performance.now();
  #start = 0;
  #playout = 0;
  #receipts = 0;
  #seek = 0;

  constructor(writer, transport, player) {
    this.#writer = writer;
    this.#transport = transport;
    this.#player = player;
  }

  async receive(session, came, signal) {
    const player = this.#player;
    this.#start = session.roundStart(player.currentTime);
    const datagrams = this.#transport.datagrams;
    const receipts = (datagrams.createWritable?.() ?? datagrams.writable).getWriter();
    const say = () => this.#receipt(session, receipts);
    const timer = setInterval(say, RECEIPT_INTERVAL_MS);
    const seek = () => this.#seekSoon(session);
    for (const event of ["loop", "seeked", "play"]) player.addEventListener(event, seek);
    const media = datagrams.readable.getReader();
    try {
      for (let count = 1; ; count++) {
        const { value, done } = await media.read();
        if (done || signal.aborted || player.session !== session) return;
        session.push(value);
        came();
        if (count % RECEIPT_EVERY === 0) say();
      }
    } finally {
      clearInterval(timer);
      clearTimeout(this.#seek);
      for (const event of ["loop", "seeked", "play"]) player.removeEventListener(event, seek);
      if (player.session === session) await this.#writer.write(new Uint8Array([BYE, 0, 0, 0, 0])).catch(() => {});
    }
  }

  #receipt(session, receipts) {
    if (this.#player.session !== session) return;
    // When the first frame of the round was, or would have been, shown.
    if (this.#playout === 0 && session.playing && session.time >= this.#start) {
      const shown = performance.now() - (1000 * (session.time - this.#start)) / Math.max(0.1, session.rate);
      this.#playout = Math.max(1, Math.round(1000 * (shown - this.#began)));
    }
    const receipt = session.receipt(this.#receipts++, this.#playout);
    const datagram = new Uint8Array(4 + receipt.length);
    new DataView(datagram.buffer).setUint32(0, this.#round, true);
    datagram.set(receipt, 4);
    receipts.write(datagram).catch(() => {});
  }

  #seekSoon(session) {
    clearTimeout(this.#seek);
    const passed = performance.now() - this.#began;
    this.#seek = setTimeout(() => this.#seekNow(session), Math.max(0, SEEK_INTERVAL_MS - passed));
  }

  #seekNow(session) {
    if (this.#player.session !== session) return;
    this.#round += 1;
    [this.#began, this.#playout, this.#receipts] = [performance.now(), 0, 0];
    this.#start = session.roundStart(session.time);
    const bytes = new DataView(new ArrayBuffer(17));
    bytes.setUint8(0, SEEK);
    bytes.setUint32(1, 12, true);
    bytes.setUint32(5, this.#round, true);
    bytes.setBigUint64(9, BigInt(Math.round(session.time * MICROSECONDS)), true);
    this.#writer.write(new Uint8Array(bytes.buffer)).catch(() => {});
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
