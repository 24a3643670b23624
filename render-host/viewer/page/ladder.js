// A ladder tries transports one after the other, each with a head start, and takes the first that has a manifest.

import { hasWebTransport, openWebSocket, openWebTransport } from "./links.js";
import { receive } from "./live.js";
import { fetchStream } from "./source.js";

// How long a transport is alone before the next is tried beside it, milliseconds.
const HEAD_START_MS = 300;
// As much before a file, which needs fewer round trips than a session and is the poorer: nobody weighs its packets.
const BEFORE_FILE_MS = 2000;
// What lies between two climbs to a server that is gone, milliseconds: at first, and at most.
const [FIRST_PAUSE_MS, LONGEST_PAUSE_MS] = [500, 10_000];
// Where pages of a server remember which transport was the first, and for how long, milliseconds: a network that has
// let nothing through may do so tomorrow.
const REMEMBERED = "dgs-transport";
const REMEMBERED_MS = 24 * 3600 * 1000;

/** What can be allowed alone. */
const TRANSPORTS = ["live", "streams", "websocket", "file"];

/** The rung that plays the file at `url`. */
export function fileRung(url) {
  const address = addressOf(url);
  return { name: "file", run: (given) => fetchStream(address, given) };
}

function addressOf(url) {
  try {
    return new URL(url, document.baseURI).href;
  } catch {
    throw new TypeError(`${url} is no address`);
  }
}

/** The rungs of a stream of `streams.json`, best first; `only` allows one alone. */
export function rungsOf(stream, only) {
  if (only && !TRANSPORTS.includes(only)) {
    throw new RangeError(`transport: ${only}; ${TRANSPORTS.join(", ")} are allowed`);
  }
  const rungs = [];
  const live = (name, open) => rungs.push({ name, run: (given) => receive(stream, open, given) });
  if (hasWebTransport(stream)) {
    // Streams are the same session: live changes to them where no datagrams pass, and they come first once they did.
    if ([only, remembered()].includes("streams")) {
      live("streams", (signal) => openWebTransport(stream, signal, true));
    }
    live("live", (signal) => openWebTransport(stream, signal));
  }
  if (stream.web_address) live("websocket", openWebSocket);
  if (stream.file) rungs.push(fileRung(stream.file));
  const allowed = rungs.filter(({ name }) => !only || name === only);
  if (allowed.length > 0) return allowed;
  const names = rungs.map(({ name }) => name).join(", ") || "none";
  throw new Error(`transport: ${only || "any"}; this browser has ${names} with this server`);
}

/**
 * Plays what the rungs bring until a file is whole, and gives what its run gave, or until `signal` is aborted.
 * What is cut off goes on by the rungs below; once none is left, by all of them again, after a pause that doubles
 * each time, and `gone(failure)` hears of it. Without `gone`, and where nothing has begun yet, that is an error.
 * A file that waited for a server to come back would win over all that does not: then it is asked for once.
 */
export async function follow(rungs, { began, gone, signal, ...given }) {
  let [left, pause, hasBegun] = [rungs, FIRST_PAUSE_MS, false];
  const note = async (session, name) => {
    await began(session, name);
    [pause, hasBegun] = [FIRST_PAUSE_MS, true];
  };
  while (!signal.aborted) {
    const tried = climb(left, { ...given, began: note, signal, isFirst: !hasBegun });
    const { name, result, failure } = await tried.catch((failure) => ({ failure }));
    if (signal.aborted) return;
    if (name === "file" && !failure) return result;
    left = name ? left.slice(1 + left.findIndex((rung) => rung.name === name)) : [];
    if (left.length > 0) continue;
    if (!gone || !hasBegun) throw failure ?? new Error("The server has ended the session");
    gone(failure);
    await new Promise((resolve) => setTimeout(resolve, pause));
    [left, pause] = [rungs, Math.min(2 * pause, LONGEST_PAUSE_MS)];
  }
}

/**
 * Runs the rungs, that one first which was the first before; `began(session, name)` for the first that has a manifest,
 * which ends the others; `switched("streams")` once it asks for media in streams. Resolves with the winner's name and what
 * its run gave once that has ended, or `failure`. Only what wins where a visit `isFirst` to climb is remembered: later
 * the server may have been away for some of them.
 */
async function climb(rungs, { began, signal, switched, isFirst, ...given }) {
  const known = remembered();
  const order = [...rungs].sort((a, b) => (b.name === known) - (a.name === known));
  let winner = null;
  const tries = order.map((rung) => ({ rung, control: new AbortController(), begun: false }));
  const end = () => tries.forEach(({ control }) => control.abort());
  signal.addEventListener("abort", end);
  const outcome = new Promise((resolve, reject) => {
    let left = tries.length;
    let timer = 0;
    const next = () => {
      clearTimeout(timer);
      const chosen = tries.find(({ begun }) => !begun);
      if (!chosen || winner || signal.aborted) return;
      chosen.begun = true;
      const after = tries.find(({ begun }) => !begun)?.rung.name;
      timer = setTimeout(next, after === "file" ? BEFORE_FILE_MS : HEAD_START_MS);
      const { rung, control } = chosen;
      const own = async (session) => {
        if (winner) return session.free();
        winner = chosen;
        tries.filter((other) => other !== chosen).forEach((other) => other.control.abort());
        if (isFirst && rungs.length > 1) remember(rung.name);
        await began(session, rung.name);
      };
      const ended = (outcome) => {
        if (winner === chosen) return resolve({ name: rung.name, ...outcome });
        left -= 1;
        if (left === 0) reject(outcome.failure ?? new Error("No transport brings this stream"));
        else next();
      };
      const changed = (name) => {
        if (rungs.length > 1) remember(name);
        switched(name);
      };
      rung.run({ ...given, began: own, signal: control.signal, switched: changed, isPatient: isFirst }).then(
        (result) => ended({ result }),
        (failure) => ended({ failure }),
      );
    };
    next();
  });
  return outcome.finally(() => signal.removeEventListener("abort", end));
}

// A page inside another may have no storage.
function remembered() {
  try {
    const { name, at } = JSON.parse(localStorage.getItem(REMEMBERED));
    return Math.abs(Date.now() - at) < REMEMBERED_MS ? name : null;
  } catch {
    return null;
  }
}

function remember(name) {
  // What is known was tried first: that it is the first says nothing new, and its day goes on.
  if (remembered() === name) return;
  try {
    localStorage.setItem(REMEMBERED, JSON.stringify({ name, at: Date.now() }));
  } catch {
    // Then it is found out again.
  }
}
