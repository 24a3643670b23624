// A source brings the bytes of a stream: from a file, from byte ranges of one, from all of it.

import { firstBytes, manifestBytes } from "./dgs_viewer.js";
import { Session } from "./session.js";

// Tries of one request, and what lies between two, milliseconds.
const TRIES = 4;
const PAUSE_MS = 200;

/**
 * Fetches `url` and calls `began(session)` as soon as its manifest is there, `came()` with every piece after.
 * Base levels come first; a server without byte ranges sends the whole. Resolves when all is there.
 */
export async function fetchStream(url, { began, came, signal, worker }) {
  const first = await ask(url, 0, firstBytes(), signal);
  const front = await first.bytes;
  if (first.length === null || front.length >= first.length) {
    await began(await Session.open(front, { worker }));
    return "whole";
  }
  const needed = manifestBytes(front);
  const enough = needed === 0 ? front : await (await ask(url, 0, needed, signal)).bytes;
  const session = await Session.fetch(enough, first.length, { worker });
  await began(session);
  for (;;) {
    if (signal.aborted) return "aborted";
    const wanted = await session.wanted();
    if (wanted.length === 0) return "ranges";
    const [from, past] = wanted.length === 2 ? wanted : [0, first.length];
    const answer = await ask(url, from, past, signal);
    const bytes = await answer.bytes;
    if (signal.aborted) return "aborted";
    const whole = wanted.length === 1 || answer.length === null;
    if (whole) await session.takeWhole(bytes);
    else if (bytes.length < past - from) throw new Error(`${url}: ${bytes.length} bytes of ${past - from} came`);
    else await session.take(from, bytes);
    came();
    if (whole) return "whole";
  }
}

// Bytes `from` to `past` of `url`; `length` of the whole, or null when the whole came.
async function ask(url, from, past, signal) {
  for (let tried = 1; ; tried++) {
    try {
      const headers = { Range: `bytes=${from}-${past - 1}` };
      const answer = await fetch(url, { headers, signal });
      if (answer.status === 206) {
        const length = Number(/\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "")?.[1]);
        if (!Number.isSafeInteger(length)) throw new Error(`${url}: a part of unknown length came`);
        return { length, bytes: body(answer) };
      }
      // Nobody counts on bytes of an error page.
      if (!answer.ok) throw Object.assign(new Error(`${url}: ${answer.status} ${answer.statusText}`), { final: answer.status < 500 });
      return { length: null, bytes: body(answer) };
    } catch (error) {
      if (signal.aborted || error.final || tried === TRIES) throw error;
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS * 2 ** tried));
    }
  }
}

async function body(answer) {
  return new Uint8Array(await answer.arrayBuffer());
}
