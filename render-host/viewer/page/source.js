// A source brings the bytes of a stream: from a file, from byte ranges of one, from all of it.

import { firstBytes, manifestBytes } from "./dgs_viewer.js";
import { Session } from "./session.js";

// Tries of one request, and what lies between two, milliseconds.
const TRIES = 4;
const PAUSE_MS = 200;

// How every version of a stream begins: "DGS".
const MAGIC = [0x44, 0x47, 0x53];

/** The session of a file, a Blob or bytes; of what begins as no stream does, no more is read. */
export async function openFile(file, options) {
  const first = await copied(file.slice(0, MAGIC.length));
  if (!MAGIC.every((byte, at) => first[at] === byte)) {
    throw new Error(`${file.name ?? "This"} is no .dgs stream: \`dgs encode\` makes one`);
  }
  return Session.open(await copied(file), options);
}

// What somebody else holds is not given away.
async function copied(file) {
  return file instanceof Uint8Array ? file.slice() : new Uint8Array(await file.arrayBuffer());
}

/**
 * Fetches `url` and calls `began(session)` as soon as its manifest is there, `came()` with every piece after.
 * Base levels come first; a server without byte ranges sends the whole. Resolves when all is there.
 */
export async function fetchStream(url, { began, came, signal, worker }) {
  const first = await ask(url, 0, firstBytes(), signal);
  if (first.length === null || first.bytes.length >= first.length) {
    await began(await Session.open(first.bytes, { worker }));
    return "whole";
  }
  const needed = manifestBytes(first.bytes);
  const enough = needed === 0 ? first : await ask(url, 0, needed, signal);
  if (enough.length === null) {
    await began(await Session.open(enough.bytes, { worker }));
    return "whole";
  }
  const session = await Session.fetch(enough.bytes, enough.length, { worker });
  await began(session);
  for (;;) {
    if (signal.aborted) return "aborted";
    const wanted = await session.wanted();
    if (wanted.length === 0) return "ranges";
    const [from, past] = wanted.length === 2 ? wanted : [0, enough.length];
    const answer = await ask(url, from, past, signal);
    if (signal.aborted) return "aborted";
    const { bytes } = answer;
    const whole = wanted.length === 1 || answer.length === null;
    if (whole) await session.takeWhole(bytes);
    else await session.take(from, bytes);
    came();
    if (whole) return "whole";
  }
}

// Bytes `from` to `past` of `url`, or to its end; `length` of the whole, or null when the whole came.
async function ask(url, from, past, signal) {
  const parts = [];
  for (let at = from; ; ) {
    const answer = await tryToAsk(url, at, past, signal);
    if (answer.length === null) return answer;
    parts.push(answer.bytes);
    at += answer.bytes.length;
    // A server may send less than was asked for, as long as it gets on.
    if (at >= Math.min(past, answer.length)) return { length: answer.length, bytes: joined(parts) };
    if (answer.bytes.length === 0) throw new Error(`${url}: ${at - from} bytes of ${past - from} came`);
  }
}

function joined(parts) {
  if (parts.length === 1) return parts[0];
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  parts.reduce((at, part) => (all.set(part, at), at + part.length), 0);
  return all;
}

async function tryToAsk(url, from, past, signal) {
  for (let tried = 1; ; tried++) {
    try {
      // Some servers fail where ranges are asked for: they are asked for the whole in the end.
      return tried < TRIES ? await part(url, from, past, signal) : await all(url, signal);
    } catch (error) {
      if (signal.aborted || error.final || tried === TRIES) throw error;
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS * 2 ** tried));
    }
  }
}

async function part(url, from, past, signal) {
  const answer = await fetch(url, { headers: { Range: `bytes=${from}-${past - 1}` }, signal });
  if (answer.status !== 206) return taken(url, answer);
  // Another origin may keep how long the file is to itself: then nothing says what else to ask for.
  const length = Number(/\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "")?.[1]);
  if (!Number.isSafeInteger(length)) return all(url, signal);
  return { length, bytes: await body(answer) };
}

async function all(url, signal) {
  return taken(url, await fetch(url, { signal }));
}

// Nobody counts on bytes of an error page.
async function taken(url, answer) {
  if (answer.ok) return { length: null, bytes: await body(answer) };
  throw Object.assign(new Error(`${url}: ${answer.status} ${answer.statusText}`), { final: answer.status < 500 });
}

async function body(answer) {
  return new Uint8Array(await answer.arrayBuffer());
}
