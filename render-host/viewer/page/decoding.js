// Decoding happens in a worker; where there can be none, on the thread of the page, by the same messages.

import { answer } from "./decoder.js";
import { load } from "./load.js";

// A worker that is ready for the next session, or becomes so.
let spare = null;

/** Starts a worker, so that the next session need not wait for one. */
export function prepare() {
  spare ??= inWorker();
  // Whoever takes it hears of it.
  spare.catch(() => {});
}

/** A decoder, and where it runs. */
export class Decoding {
  #port;
  #where;
  #waiting = new Map();
  #next = 0;

  constructor(port, where) {
    this.#port = port;
    this.#where = where;
    port.onmessage = ({ data }) => this.#heard(data);
    // A worker that dies answers nothing any more.
    port.onerror = (event) => this.#fail(new Error(`The decoder has failed: ${event.message ?? "its worker ended"}`));
  }

  /** One in a worker, unless there can be none or `worker` is false. */
  static async open(worker = true) {
    if (!worker) return onPage("as requested");
    const ready = spare ?? inWorker();
    spare = null;
    try {
      return new Decoding(await ready, "worker");
    } catch (error) {
      return onPage(error.message);
    }
  }

  /** `worker`, or `page` and the reason. */
  get where() {
    return this.#where;
  }

  /** What the decoder answers to `name`; what `transfer` names is its own from now on. */
  ask(name, given, transfer = []) {
    const id = this.#next++;
    return new Promise((resolve, reject) => {
      if (!this.#port) return reject(new Error("The decoder is closed"));
      this.#waiting.set(id, { resolve, reject });
      this.#port.postMessage({ id, name, given }, transfer);
    });
  }

  #heard({ id, result, failure }) {
    const { resolve, reject } = this.#waiting.get(id) ?? {};
    this.#waiting.delete(id);
    if (failure === undefined) resolve?.(result);
    else reject?.(new Error(failure));
  }

  #fail(error) {
    for (const { reject } of this.#waiting.values()) reject(error);
    this.#waiting.clear();
  }

  /** Ends it; what it still does is of no use to anybody. */
  close() {
    if (!this.#port) return;
    const port = this.#port;
    this.#port = null;
    this.#fail(new Error("The decoder is closed"));
    if (port.terminate) port.terminate();
    // The other end hears this before it hears nothing any more.
    else port.postMessage({ name: "close" });
  }
}

async function inWorker() {
  const module = await load();
  if (!globalThis.Worker) throw new Error("no workers here");
  const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  return new Promise((resolve, reject) => {
    const failed = (reason) => {
      worker.terminate();
      reject(new Error(reason));
    };
    worker.onmessage = ({ data }) => (data === null ? resolve(worker) : failed(data));
    worker.onerror = (event) => {
      // It is said where the page decodes instead.
      event.preventDefault();
      failed(event.message ?? "no worker may be made here");
    };
    worker.postMessage(module);
  });
}

async function onPage(reason) {
  await load();
  const { port1, port2 } = new MessageChannel();
  answer(port2);
  return new Decoding(port1, `page: ${reason}`);
}
