/** Draws sets of Gaussians from a camera into an image in GPU memory. */

import { failing } from "./errors.js";
import { PlanHost } from "./host.js";
import { readBuffer, readingBuffer } from "./gpu_buffers.js";
import { frameUniform, pageUniforms } from "./uniforms.js";

const READERS = 2; // copies of the counts that may be in flight
const FIRST_PAIRS_PER_ROW = 4; // of a splat and a tile, so that most first pictures are whole
const MOST_FIRST_PAIRS = 1 << 22; // 64 MB

/**
 * A set of Gaussians in a scene: pages, capacity, count, and what is absent here in `buffers`.
 * @typedef {Partial<import("./uniforms.js").SplatSet> &
 *     {buffers: any, transform: readonly number[]}} PlacedSet
 */

/** Return the cells of each set as the pages of a uniform. */
function cellSets(placed) {
  let first = 0;
  return placed.filter(({ firstRow }) => firstRow === 0).map(({ set, base, setCells }) => {
    first += setCells;
    const counts = { capacity: setCells, count: setCells };
    return { set, base: first - setCells, ...counts, firstRow: 0, firstGaussian: base };
  });
}

/** Draws one scene; several renderers may share the kernels of a device. */
export class Renderer {
  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {{onStale?: () => void}} [callbacks] `onStale`: the last frame has to be drawn again.
   */
  constructor(kernels, { onStale = () => {} } = {}) {
    this.device = kernels.device;
    this.plans = kernels.plans;
    this.host = new PlanHost(kernels);
    this._onStale = onStale;
    /** @type {PlacedSet[]} */
    this._sets = [];
    this._pairs = this.plans.pairs.first;
    this._deep = false;
    this._key = "";
    this._version = 0;
    /** @type {{buffer: GPUBuffer, busy: boolean, done: Promise<void>}[]} */
    this._readers = [];
    /** @type {Record<string, number>} Counts of the last frame that was read. */
    this.counts = {};
  }

  setScene(sets) {
    this._sets = sets;
    const rows = sets.reduce((sum, { buffers }) => sum + buffers.pages.reduce((all, { capacity }) => all + capacity, 0), 0);
    this._pairs = Math.max(this._pairs, Math.min(FIRST_PAIRS_PER_ROW * rows, MOST_FIRST_PAIRS, this.plans.pairs.most));
    this._deep = false;
    this._version += 1;
  }

  /**
   * Draw a frame; the promise resolves when it is submitted, not when it is drawn.
   * @param {import("./camera.js").Camera} camera
   * @param {{outputs?: string[], background?: readonly number[], layers?: number,
   *     encodeLayers?: (encoder: GPUCommandEncoder, host: PlanHost) => void}} [options]
   *     Image layers among the Gaussians, and what writes them.
   */
  async draw(camera, { outputs = ["color"], background = [0, 0, 0], layers = 0, encodeLayers } = {}) {
    await this.configure(camera, outputs, layers);
    const { device, host, plans } = this;
    const placed = this._placed();
    const write = (name, bytes) => device.queue.writeBuffer(host.input(name), 0, bytes);
    write("frame", frameUniform(plans, camera, background));
    write("bare frame", frameUniform(plans, camera, [0, 0, 0]));
    if (placed.length) write("pages", pageUniforms(plans, placed, camera));
    if ("sets" in host.plan.inputs) write("sets", pageUniforms(plans, cellSets(placed), camera));
    const encoder = device.createCommandEncoder({ label: "frame" });
    for (const { buffers } of this._sets) buffers.encode?.(encoder);
    placed.forEach(({ liveCounts, page }, slot) => {
      if (!liveCounts) return;
      const { size, fields } = plans.uniforms.page;
      const offset = slot * size + fields.count[2];
      encoder.copyBufferToBuffer(liveCounts, 4 * page, host.input("pages"), offset, 4);
    });
    encodeLayers?.(encoder, host);
    host.encode(encoder);
    const reader = this._freeReader();
    const counts = host.input("counts");
    if (reader) encoder.copyBufferToBuffer(counts, 0, reader.buffer, 0, plans.counts.BYTES);
    device.queue.submit([encoder.finish()]);
    if (reader) this._read(reader);
  }

  /** Draw until nothing that a frame found too small remains. @returns {Promise<void>} */
  async drawWhole(camera, options = {}) {
    for (let attempt = 0; attempt < 8; attempt++) {
      const before = [this._pairs, this._deep].join();
      await Promise.all(this._readers.map((reader) => reader.done));
      await this.draw(camera, options);
      await Promise.all(this._readers.map((reader) => reader.done));
      if (before === [this._pairs, this._deep].join()) return;
    }
  }

  /** Compile the kernels and make the buffers of a frame, unless the last one has the same. */
  async configure(camera, outputs, layers = 0) {
    const { width, height, kind, distortion } = camera;
    const lens = kind === "fisheye" ? "a fisheye" : distortion && "lens distortion";
    if (lens) failing("camera")(`${lens} is not drawn in pages`, "Draw it with `gsgen render`.");
    const [panorama, deep, pairs] = [kind === "panorama", this._deep, this._pairs];
    const weighted = this._sets.some(({ buffers }) => buffers.weighted);
    const shape = { outputs, panorama, deep, weighted, layers, width, height, pairs };
    const pages = this._sets.flatMap((set) => set.buffers.pages);
    const key = JSON.stringify([shape, this._version, pages.length]);
    if (key === this._key) return;
    this._key = "";
    await this.host.configure({ ...shape, pages });
    this._key = key;
  }

  _placed() {
    let base = 0;
    return this._sets.flatMap(({ buffers, ...own }) => {
      const { degree, antialias, weighted, liveCounts } = buffers;
      const set = { degree, antialias, weighted, ...own };
      return buffers.pages.map(({ capacity, firstRow, setCells }, page) => {
        const count = Math.min(Math.max(buffers.count - firstRow, 0), capacity);
        const placed = { set, base, capacity, count, liveCounts, page, firstRow, setCells };
        base += capacity;
        return placed;
      });
    });
  }

  _freeReader() {
    const free = this._readers.find((reader) => !reader.busy);
    if (free || this._readers.length === READERS) return free;
    const buffer = readingBuffer(this.device, "read counts", this.plans.counts.BYTES);
    const reader = { buffer, busy: false, done: Promise.resolve() };
    this._readers.push(reader);
    return reader;
  }

  /** Read the counts of a frame some time later, and grow what was too small for it. */
  _read(reader) {
    const pairs = this._pairs;
    reader.busy = true;
    reader.done = reader.buffer
      .mapAsync(GPUMapMode.READ)
      .then(() => {
        const words = new Uint32Array(reader.buffer.getMappedRange().slice(0));
        reader.buffer.unmap();
        this._judge(words, pairs);
      })
      .catch((error) => {
        // A lost device, or a renderer that was destroyed, reads nothing.
        if (!(error instanceof DOMException)) throw error;
      })
      .finally(() => {
        reader.busy = false;
      });
  }

  _judge(words, pairs) {
    const { plans } = this;
    const count = (name) => words[plans.counts[name]];
    this.counts = { visible: count("VISIBLE"), pairs: count("WANTED_PAIRS") };
    const { room, most } = plans.pairs;
    if (count("WANTED_PAIRS") > pairs && pairs < most) {
      this._pairs = Math.max(this._pairs, Math.min(Math.floor(count("WANTED_PAIRS") * room), most));
      this._onStale();
    }
    if (count("UNSORTED") && !this._deep) {
      this._deep = true;
      this._onStale();
    }
  }

  /** Read an image back: four numbers per pixel, row by row. @returns {Promise<Float32Array>} */
  readImage(output) {
    const { width, height } = this.host.sizes;
    return readBuffer(this.device, this.host.image(output), Float32Array, 4 * width * height);
  }

  /** Read four numbers of a pixel back. @returns {Promise<Float32Array>} */
  readPixel(output, x, y) {
    const offset = 16 * (y * this.host.sizes.width + x);
    return readBuffer(this.device, this.host.image(output), Float32Array, 4, offset);
  }

  /** Release all buffers but those of the sets. */
  destroy() {
    this.host.destroy();
    for (const { buffer } of this._readers) buffer.destroy();
    this._readers = [];
    this._key = "";
  }
}
