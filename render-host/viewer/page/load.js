// Loads the WebAssembly: compiled once for a page, its players and their workers.

import init from "./dgs_viewer.js";

let loading;
let from = new URL("./dgs_viewer_bg.wasm", import.meta.url);

/** Loads the WebAssembly once for all players of a page; `url` where it does not lie beside this file. */
export function load(url) {
  from = url ?? from;
  loading ??= compile(from).then(
    async (module) => {
      await init({ module_or_path: module });
      return module;
    },
    (error) => {
      // Whoever asks next tries again.
      loading = undefined;
      throw error;
    },
  );
  return loading;
}

async function compile(url) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
  // Compiled while it comes, where its server says what it is.
  const streams = /^application\/wasm\b/.test(answer.headers.get("Content-Type") ?? "");
  return streams ? WebAssembly.compileStreaming(answer) : WebAssembly.compile(await answer.arrayBuffer());
}
