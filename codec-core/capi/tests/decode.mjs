// Decodes a stream through the WebAssembly module and prints what came of it:
//
//     node decode.mjs MODULE MANIFEST PACKETS RUNS FRAME...
//
// As decode.c, with the module's own memory grown by hand: it has no allocator and imports nothing.
// The digest is computed here, over the bytes of the module's memory, and must be the module's too.
// Times are medians of RUNS runs over all frames, after one to warm up.

import { readFileSync } from "node:fs";

const [modulePath, manifestPath, packetsPath, runs, ...frames] = process.argv.slice(2);
const file = readFileSync(modulePath);
const compiled = new WebAssembly.Module(file);
const imports = WebAssembly.Module.imports(compiled);
if (imports.length > 0) {
  console.log(`imports ${imports.map((i) => i.name)}`);
  process.exit(1);
}
const dgs = new WebAssembly.Instance(compiled, {}).exports;

// Everything we need lies behind what the module brought.
let end = dgs.memory.buffer.byteLength;
function take(bytes) {
  const start = end;
  end = (end + bytes + 15) & ~15;
  const missing = end - dgs.memory.buffer.byteLength;
  if (missing > 0) dgs.memory.grow((missing + 65535) >> 16);
  return start;
}
const u8 = () => new Uint8Array(dgs.memory.buffer);
const u32 = (at) => new DataView(dgs.memory.buffer).getUint32(at, true);

const ERROR = take(48);
function check(status, call) {
  if (status === 0) return;
  const view = new DataView(dgs.memory.buffer);
  const field = u8().slice(u32(ERROR + 32), u32(ERROR + 32) + u32(ERROR + 36));
  const [found, least, most] = [8, 16, 24].map((o) => view.getBigUint64(ERROR + o, true));
  console.log(`${call} refused: status ${status}, ${new TextDecoder().decode(field)} at byte ${u32(ERROR + 4)}: found ${found}, allowed ${least} to ${most}`);
  process.exit(1);
}

const message = readFileSync(manifestPath);
const packets = readFileSync(packetsPath);
const messageAt = take(message.length);
u8().set(message, messageAt);
const packetsAt = take(packets.length);
u8().set(packets, packetsAt);

const word = take(16);
const CAPS = take(48);
dgs.dgs_caps_host(CAPS);
new DataView(dgs.memory.buffer).setUint32(CAPS + 36, 4096, true); // early_bytes
// A first block that holds the unpacked manifest says what the stream needs.
let blockBytes = 1 << 18;
const first = take(blockBytes);
check(dgs.dgs_open(first, blockBytes, CAPS, word, ERROR), "dgs_open");
check(dgs.dgs_required(u32(word), messageAt, message.length, word + 4, ERROR), "dgs_required");
blockBytes = u32(word + 4);
const block = take(blockBytes);
check(dgs.dgs_open(block, blockBytes, CAPS, word, ERROR), "dgs_open");
const player = u32(word);

let [kept, refused] = [0, 0];
for (let at = 0, first = true; at + 2 <= packets.length; first = false) {
  const len = packets[at] | (packets[at + 1] << 8);
  at += 2;
  if (dgs.dgs_push(player, packetsAt + at, len, 0, ERROR) === 0) kept++;
  else refused++;
  at += len;
  if (first) check(dgs.dgs_manifest(player, messageAt, message.length, ERROR), "dgs_manifest");
}
const COUNTERS = take(48);
check(dgs.dgs_count(player, COUNTERS, ERROR), "dgs_count");
const SHOWN = take(32);

const PRIME = 0x100000001b3n;
let [digest, again] = [0xcbf29ce484222325n, 0xcbf29ce484222325n];
function add(at, bytes) {
  const memory = u8();
  for (let i = at; i < at + bytes; i++) digest = BigInt.asUintN(64, (digest ^ BigInt(memory[i])) * PRIME);
}
for (const frame of frames.map(Number)) {
  check(dgs.dgs_show(player, frame, SHOWN, ERROR), "dgs_show");
  const [gaussians, n, rest, restLen] = [0, 4, 8, 12].map((offset) => u32(SHOWN + offset));
  add(gaussians, n * 56);
  add(rest, restLen * 4);
  again = BigInt.asUintN(64, dgs.dgs_digest(again, gaussians, n, rest, restLen));
}
const times = [];
for (let run = 0; run <= Number(runs); run++) {
  const start = process.hrtime.bigint();
  for (const frame of frames.map(Number)) dgs.dgs_show(player, frame, SHOWN, 0);
  if (run > 0) times.push(Number(process.hrtime.bigint() - start) / 1e6 / frames.length);
}
times.sort((a, b) => a - b);
if (digest !== again) {
  console.log(`the module's digest is ${again.toString(16)}, its memory's ${digest.toString(16)}`);
  process.exit(1);
}
console.log(`module_bytes ${file.length}`);
console.log(`block_bytes ${blockBytes}`);
console.log(`kept ${kept}\nrefused ${refused}`);
console.log(`count.media ${u32(COUNTERS)}\ncount.parity ${u32(COUNTERS + 4)}\ncount.recovered ${u32(COUNTERS + 12)}`);
console.log(`frame_ms ${times[times.length >> 1].toFixed(4)}`);
console.log(`digest ${digest.toString(16).padStart(16, "0")}`);
