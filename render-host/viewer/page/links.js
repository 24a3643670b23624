// A link carries a session's control stream and datagrams: over WebTransport, or in frames of a WebSocket.
//
// Every link has `control` and `media`, readers of `{ value, done }`; `write(bytes)` to the control stream;
// `send(datagram)`; `close()`. One that can do without datagrams has `useStreams()`, to be called after hello, and says
// by `inStreams` whether that is wanted from the start. SESSION.md has every byte.

// Datagrams that wait for this page; of more the oldest are lost.
const WAITING_PACKETS = 4096;
// First bytes of frames.
const [CONTROL, DATAGRAM] = [0, 1];
// Bytes towards the server that may wait before datagrams are lost.
const MAX_BUFFERED = 4096;
// Bytes of a packet in a stream of its own.
const MAX_PACKET = 1150;
// Kinds of messages on the control stream that stand for datagrams.
const [STREAMS, RECEIPT] = [0x04, 0x05];

/** Whether this browser has WebTransport, and the server of `stream`. */
export function hasWebTransport(stream) {
  return "WebTransport" in globalThis && Boolean(stream.web_address);
}

/**
 * A link over WebTransport to the server of `stream`, known by its pin, or, as browsers take a pin for certificates of two
 * weeks alone, by who signed it; without datagrams from the start if `streams`.
 */
export async function openWebTransport(stream, signal, streams = false) {
  const digits = await (await fetch("certificate.sha256", { signal })).text();
  const value = Uint8Array.from(digits.trim().match(/../g) ?? [], (pair) => parseInt(pair, 16));
  const pinned = { serverCertificateHashes: [{ algorithm: "sha-256", value }] };
  const transport = await readyTransport(stream.web_address, pinned, signal).catch((error) => {
    if (signal.aborted) throw error;
    return readyTransport(stream.web_address, {}, signal);
  });
  const close = () => transport.close();
  const { datagrams } = transport;
  // By default one packet waits.
  datagrams.incomingHighWaterMark = WAITING_PACKETS;
  datagrams.incomingMaxBufferedDatagrams = WAITING_PACKETS;
  const control = await transport.createBidirectionalStream();
  const [writer, receipts] = [control.writable, datagrams.createWritable?.() ?? datagrams.writable].map((to) =>
    to.getWriter(),
  );
  const media = new Queue(WAITING_PACKETS);
  const end = () => media.end();
  transport.closed.then(end, end);
  each(datagrams.readable, (packet) => media.put(packet)).catch(() => {});
  const take = (from) => packetOf(from).then((packet) => packet && media.put(packet), () => {});
  each(transport.incomingUnidirectionalStreams, take).catch(() => {});
  let inStreams = false;
  // One receipt is on its way at a time: of those that find no room, the next says all.
  let saying = false;
  const say = async (datagram) => {
    if (saying) return;
    saying = true;
    await writer.write(message(RECEIPT, datagram)).finally(() => (saying = false));
  };
  return {
    control: control.readable.getReader(),
    media,
    write: (bytes) => writer.write(bytes),
    send: (datagram) => (inStreams ? say(datagram) : receipts.write(datagram)),
    inStreams: streams || !datagrams.maxDatagramSize,
    useStreams: () => {
      inStreams = true;
      return writer.write(message(STREAMS, new Uint8Array(0)));
    },
    close,
  };
}

async function readyTransport(address, options, signal) {
  const transport = new WebTransport(address, options);
  transport.closed.catch(() => {});
  signal.addEventListener("abort", () => transport.close());
  await transport.ready;
  return transport;
}

// Gives everything that comes from `stream` to `take`.
async function each(stream, take) {
  const reader = stream.getReader();
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    take(value);
  }
}

// The packet that a stream holds; nothing of one that holds more.
async function packetOf(stream) {
  const packet = new Uint8Array(MAX_PACKET);
  let length = 0;
  const reader = stream.getReader();
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return packet.slice(0, length);
    if (length + value.length > MAX_PACKET) return reader.cancel();
    packet.set(value, length);
    length += value.length;
  }
}

// A message of the control stream.
function message(kind, body) {
  const bytes = new Uint8Array(5 + body.length);
  bytes[0] = kind;
  new DataView(bytes.buffer).setUint32(1, body.length, true);
  bytes.set(body, 5);
  return bytes;
}

/** A link over a WebSocket to the server of this page. */
export async function openWebSocket(signal) {
  const url = new URL("session", document.baseURI);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  const socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  // A socket that is closed before it is open complains to people.
  const close = () => (socket.readyState === WebSocket.CONNECTING ? (socket.onopen = close) : socket.close());
  signal.addEventListener("abort", close);
  const [control, media] = [new Queue(Infinity), new Queue(WAITING_PACKETS)];
  socket.onmessage = ({ data }) => {
    const frame = new Uint8Array(data);
    // A packet of its own, so that it can be given away.
    if (frame[0] === CONTROL) control.put(frame.subarray(1));
    else if (frame[0] === DATAGRAM) media.put(frame.slice(1));
  };
  const opened = new Promise((resolve, reject) => {
    signal.addEventListener("abort", () => reject(new Error("The WebSocket is not wanted any more")));
    socket.onopen = resolve;
    socket.onclose = ({ reason }) => {
      for (const queue of [control, media]) queue.end();
      reject(new Error(reason || "The WebSocket is closed"));
    };
  });
  await opened;
  const framed = (kind, bytes) => {
    const frame = new Uint8Array(1 + bytes.length);
    frame[0] = kind;
    frame.set(bytes, 1);
    return frame;
  };
  // A socket that closes complains to people of what it is given.
  const isOpen = () => socket.readyState === WebSocket.OPEN;
  return {
    control,
    media,
    write: async (bytes) => {
      if (!isOpen()) throw new Error("The WebSocket is closed");
      socket.send(framed(CONTROL, bytes));
    },
    send: async (datagram) => {
      if (isOpen() && socket.bufferedAmount < MAX_BUFFERED) socket.send(framed(DATAGRAM, datagram));
    },
    close,
  };
}

// What has come and was not read yet; of more than `most` the oldest is lost.
class Queue {
  #most;
  #values = [];
  #reader = null;
  #ended = false;

  constructor(most) {
    this.#most = most;
  }

  put(value) {
    this.#values.push(value);
    if (this.#values.length > this.#most) this.#values.shift();
    this.#serve();
  }

  end() {
    this.#ended = true;
    this.#serve();
  }

  /** As a reader of a stream reads. */
  read() {
    return new Promise((resolve) => {
      this.#reader = resolve;
      this.#serve();
    });
  }

  #serve() {
    if (!this.#reader || (this.#values.length === 0 && !this.#ended)) return;
    const reader = this.#reader;
    this.#reader = null;
    const done = this.#values.length === 0;
    reader({ value: this.#values.shift(), done });
  }
}
