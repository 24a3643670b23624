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
  checkMagic(await copied(file.slice(0, MAGIC.length)), file.name ?? "This");
  return Session.open(await copied(file), options);
}

// Refuses what begins otherwise than a stream.
function checkMagic(first, name) {
  if (MAGIC.every((byte, at) => first[at] === byte)) return;
  throw new Error(`${name} is no .dgs stream: \`dgs encode\` makes one`);
}

// What somebody else holds is not given away.
async function copied(file) {
  return file instanceof Uint8Array ? file.slice() : new Uint8Array(await file.arrayBuffer());
}

/**
 * Fetches `url` and calls `began(session)` as soon as its manifest is there, `came()` with every piece after.
 * Base levels come first; a server without byte ranges sends the whole. Resolves when all is there; errors name `url`.
 * What fails is tried again, but for the first request where it `isPatient` no more.
 */
export async function fetchStream(url, { began, came, signal, worker, isPatient = true }) {
  const beginWhole = async (bytes) => {
    await began(await naming(url, () => Session.open(bytes, { worker })));
    return "whole";
  };
  const first = await (isPatient ? ask(url, 0, firstBytes(), signal) : part(url, 0, firstBytes(), signal));
  checkMagic(first.bytes, url);
  if (first.length === null || first.bytes.length >= first.length) return beginWhole(first.bytes);
  const needed = await naming(url, () => manifestBytes(first.bytes));
  const enough = needed === 0 ? first : await ask(url, 0, needed, signal, first);
  if (enough.length === null) return beginWhole(enough.bytes);
  const session = await naming(url, () => Session.fetch(enough.bytes, enough.length, { worker }));
  await began(session);
  for (;;) {
    if (signal.aborted) return "aborted";
    const wanted = await session.wanted();
    if (wanted.length === 0) return "ranges";
    const [from, past] = wanted.length === 2 ? wanted : [0, enough.length];
    const answer = await ask(url, from, past, signal, first);
    if (signal.aborted) return "aborted";
    const { bytes } = answer;
    const whole = wanted.length === 1 || answer.length === null;
    await naming(url, () => (whole ? session.takeWhole(bytes) : session.take(from, bytes)));
    came();
    if (whole) return "whole";
  }
}

// What `act` gives; what it fails with begins with `url`.
async function naming(url, act) {
  try {
    return await act();
  } catch (error) {
    throw new Error(`${url}: ${error?.message ?? error}`);
  }
}

// Bytes `from` to `past` of `url`, or to its end; `length` of the whole, or null when the whole came. `file` is an answer
// that this one must belong to.
async function ask(url, from, past, signal, file = null) {
  const parts = [];
  for (let at = from; ; ) {
    const answer = await tryToAsk(url, at, past, signal);
    file ??= answer;
    checkUnchanged(url, answer, file);
    if (answer.length === null) return answer;
    parts.push(answer.bytes);
    at += answer.bytes.length;
    // A server may send less than was asked for, as long as it gets on.
    if (at >= Math.min(past, answer.length)) return { ...answer, bytes: joined(parts) };
    if (answer.bytes.length === 0) throw new Error(`${url}: ${at - from} bytes of ${past - from} came`);
  }
}

// Refuses an answer of another version of the file than `before`. A whole file may have another name than its parts.
function checkUnchanged(url, answer, before) {
  const { length, etag } = answer.length === null ? { length: answer.bytes.length, etag: before.etag } : answer;
  if (length !== (before.length ?? length) || etag !== before.etag) throw changed(url);
}

function changed(url) {
  const message = `${url}: the file has changed on the server since it was opened; open it again`;
  return Object.assign(new Error(message), { final: true });
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
  const answer = await answerOf(url, { headers: { Range: `bytes=${from}-${past - 1}` }, signal });
  // Nothing lies there any more.
  if (answer.status === 416 && from > 0) throw changed(url);
  if (answer.status !== 206) return taken(url, answer);
  // Another origin may keep how long the file is to itself: then nothing says what else to ask for.
  const range = /^bytes (\d+)-\d+\/(\d+)$/i.exec(answer.headers.get("Content-Range") ?? "");
  const [first, length] = [Number(range?.[1]), Number(range?.[2])];
  if (!Number.isSafeInteger(length)) return all(url, signal);
  if (first !== from) {
    const message = `${url}: bytes from ${first} on came; from ${from} on were asked for`;
    throw Object.assign(new Error(message), { final: true });
  }
  return { length, etag: answer.headers.get("ETag"), bytes: await body(url, answer) };
}

async function all(url, signal) {
  return taken(url, await answerOf(url, { signal }));
}

// Nobody counts on bytes of an error page.
async function taken(url, answer) {
  if (answer.ok) return { length: null, etag: null, bytes: await body(url, answer) };
  throw Object.assign(new Error(`${url}: ${answer.status} ${answer.statusText}`), { final: answer.status < 500 });
}

async function answerOf(url, options) {
  try {
    return await fetch(url, options);
  } catch (error) {
    // A browser does not say which.
    const why = "no answer (server gone, or it does not allow pages of this origin: CORS)";
    throw error instanceof TypeError ? new Error(`${url}: ${why}`) : error;
  }
}

async function body(url, answer) {
  try {
    return new Uint8Array(await answer.arrayBuffer());
  } catch (error) {
    throw error instanceof TypeError ? new Error(`${url}: the connection was cut off`) : error;
  }
}
