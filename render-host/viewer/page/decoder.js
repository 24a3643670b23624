// A decoder answers requests for frames: it holds the stream, on whatever thread it runs.

import { Decoder, memoryBytes } from "./dgs_viewer.js";

/**
 * Answers every `{ id, name, given }` that comes through `port` with `{ id, result }`, or with `{ id, failure }`,
 * in the order in which they come.
 */
export function answer(port) {
  const actions = new Actions();
  port.onmessage = ({ data: { id, name, given } }) => {
    try {
      const result = actions[name](given);
      port.postMessage({ id, result }, result?.picture ? [result.picture.buffer] : []);
    } catch (error) {
      port.postMessage({ id, failure: error?.message ?? String(error) });
    }
  };
}

class Actions {
  #decoder;
  // A buffer that came back from the page.
  #buffer = null;

  /** Opens a stream by one of the three constructors, and says what it is. */
  make({ how, bytes, length }) {
    this.#decoder = Decoder[how](bytes, length);
    const [frames, rate, gaussians, packets] = this.#decoder.info();
    const { damage, degree, footprint, up, loaded } = this.#decoder;
    return { frames, rate, gaussians, packets, damage, degree, footprint, up, loaded, state: this.#state(false) };
  }

  #state(busy) {
    const { base_timeout, hasCome } = this.#decoder;
    const [missing, levels, packets] = [this.#decoder.missing(), this.#decoder.levels(), this.#decoder.packets()];
    const quality = this.#decoder.quality();
    return { busy, base_timeout, hasCome, missing, levels, packets, quality, memory: memoryBytes() };
  }

  push(packets) {
    for (const packet of packets) this.#decoder.push(packet);
  }

  take({ at, bytes }) {
    this.#decoder.take(at, bytes);
    return this.#taken();
  }

  takeWhole(bytes) {
    this.#decoder.takeWhole(bytes);
    return this.#taken();
  }

  #taken() {
    const { damage, loaded } = this.#decoder;
    return { damage, loaded };
  }

  wanted() {
    return [...this.#decoder.wanted()];
  }

  impair({ loss, burst, rate, delay, seed }) {
    this.#decoder.impair(loss, burst, rate, delay, seed);
  }

  restart() {
    this.#decoder.restart();
    return this.#state(false);
  }

  receipt({ sequence, playout, view, up }) {
    this.#decoder.look(view, up);
    return this.#decoder.receipt(sequence, playout);
  }

  roundStart(time) {
    return this.#decoder.roundStart(time);
  }

  bounds(frame) {
    this.#decoder.goTo(frame);
    return [...this.#decoder.bounds()];
  }

  /** The Gaussians of a frame, where they are others than before; `buffer` is one to put them in. */
  show({ frame, cap, overlay, reduced, now, anew, hasScreen, buffer }) {
    this.#buffer = buffer ?? this.#buffer;
    this.#decoder.goTo(frame);
    this.#decoder.choose(cap, overlay);
    this.#decoder.reduce(reduced.cap, reduced.share);
    const onWay = this.#decoder.deliver(now);
    const packed = hasScreen ? this.#decoder.pack(anew) : undefined;
    // What has just come is painted as new by packing it.
    return { picture: packed && this.#copied(packed), state: this.#state(onWay || this.#decoder.fading) };
  }

  #copied(packed) {
    const { count, degree, onlyMoved, bytes } = packed;
    packed.free();
    const buffer = this.#buffer?.byteLength >= bytes ? this.#buffer : new ArrayBuffer(bytes);
    this.#buffer = null;
    this.#decoder.copyPacked(new Float32Array(buffer, 0, bytes / 4));
    return { count, degree, onlyMoved, bytes, buffer };
  }

  close() {
    this.#decoder?.free();
    this.#decoder = undefined;
  }
}
