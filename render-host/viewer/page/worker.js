// A worker decodes for one session: the first message is the compiled WebAssembly, all others `answer` takes.

import init from "./dgs_viewer.js";
import { answer } from "./decoder.js";

async function begin({ data: module }) {
  try {
    await init({ module_or_path: module });
    answer(globalThis);
    postMessage(null);
  } catch (error) {
    postMessage(String(error));
  }
}
addEventListener("message", begin, { once: true });
