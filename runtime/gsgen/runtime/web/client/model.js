/** Models that an element shows: splat files, and generators that compute new ones every frame. */

import { inlined, parsedJson } from "./download.js";
import { boxAround } from "./framing.js";
import { readInBackground } from "./file_reader.js";
import { moved, plus } from "./matrices.js";
import { inTurns } from "./once.js";
import { SplatBuffers } from "./splat_buffers.js";

export const FIRST_OF_ONNX = 8; // its first byte, which no other file of a model has: the field ir_version

/** @typedef {import("./host.js").KernelCache} KernelCache */
/**
 * @typedef {object} Model
 * @property {any} buffers Its Gaussians in GPU memory.
 * @property {import("./renderer.js").PlacedSet[]} sets What is drawn of it.
 * @property {{center: number[], half?: number[], reach: number}} extent
 * @property {number[]} up
 * @property {{name: any, low: number, high: number, seconds: number, loop: boolean} | null} time
 * @property {any[]} inputs The inputs that a visitor may set.
 * @property {boolean} followsCamera
 * @property {readonly number[]} [frame] From the axes that a scene file places to those of the sets.
 * @property {(values: Record<string, any>, camera: any) => Promise<boolean>} update Computes a
 *     frame; true if the pages are others than before.
 * @property {() => void} destroy
 * @property {number} [missingPictures] How many pictures the model needs before it can be shown.
 * @property {any} [manifest] Of generators, with the findings of rules.
 * @property {any[]} [findings]
 * @property {import("./post_process.js").Post[]} [posts] Of scenes.
 * @property {number[] | null} [background] Of scenes: red, green, blue and alpha.
 * @property {Partial<import("./orbit_camera.js").Orbit> & {view?: number[]}} [camera] Of scenes: the first one.
 * @property {import("./scene_file.js").SceneAnnotation[]} [annotations] Of scenes.
 * @property {(camera: any, output: string) => Promise<any>} [surfaces] Of scenes: options with which a renderer
 *     draws meshes among the Gaussians.
 * @property {(seconds: number) => any} [cameraAt] Of scenes: the orbit at a time; null without one.
 */

/**
 * Return the centre of the box around all Gaussians but floaters, half its sides and its diagonal.
 * @param {{rows: Float32Array, count: number}} splats
 */
export function extentOf(splats) {
  const { low, high } = boxAround(splats) ?? { low: [0, 0, 0], high: [0, 0, 0] };
  const half = low.map((least, axis) => (high[axis] - least) / 2);
  return { center: plus(low, 1, half), half, reach: Math.hypot(...half) || 1 };
}

/** Return the extent of several moments. @param {ReturnType<typeof extentOf>[]} boxes */
export function mergedExtent(boxes) {
  const low = [0, 1, 2].map((i) => Math.min(...boxes.map(({ center, half }) => center[i] - half[i])));
  const high = [0, 1, 2].map((i) => Math.max(...boxes.map(({ center, half }) => center[i] + half[i])));
  const half = plus(high, -1, low).map((side) => side / 2);
  return { center: plus(low, 1, half), half, reach: Math.hypot(...half) || 1 };
}

/** The model of a splat file, whose rows are drawn while they arrive. */
class StillModel {
  /** @param {import("./host.js").KernelCache} kernels @param {(isFirst: boolean) => void} onChange */
  constructor({ device, plans }, onChange) {
    this._device = device;
    this._plans = plans;
    this._onChange = onChange;
    /** @type {{buffers: SplatBuffers, transform: readonly number[]}[]} */
    this.sets = [];
    /** @type {Float32Array[]} Rows of each part, that framing looks at. */
    this._rows = [];
    this._told = 0; // rows when somebody was last told
    this.up = [0, -1, 0];
    this.time = null;
    this.inputs = [];
    this.findings = [];
    this.followsCamera = true; // until it is whole: each frame looks for new sets
  }

  get buffers() {
    const count = this.sets.reduce((sum, { buffers }) => sum + buffers.count, 0);
    return { count, isLinear: this.sets.some(({ buffers }) => buffers.isLinear) };
  }

  get extent() {
    const extents = this.sets.map(({ buffers, transform }, part) => {
      const own = extentOf({ rows: this._rows[part], count: buffers.count });
      return { ...own, center: moved(transform, own.center) }; // it mirrors axes, at most
    });
    const extent = extents.length === 1 ? extents[0] : mergedExtent(extents);
    if (!this.followsCamera) Object.defineProperty(this, "extent", { value: extent });
    return extent;
  }

  begin(facts) {
    this.sets.push({ buffers: new SplatBuffers(this._device, this._plans, facts), transform: facts.transform });
    this._rows.push(new Float32Array(10 * facts.count));
    if (facts.up) this.up = facts.up;
    return this.sets.length - 1;
  }

  write(part, first, rows, appearance) {
    const { buffers } = this.sets[part];
    buffers.write(first, rows, appearance);
    if (!rows) return;
    this._rows[part].set(rows, 10 * first);
    buffers.count = first + rows.length / 10;
    const { count } = this.buffers;
    if (count < 2 * this._told) return; // more pictures would take longer than the file
    this._onChange(!this._told);
    this._told = count;
  }

  /** Say how many rows of a part there are. */
  end(part, count) {
    this.sets[part].buffers.count = count;
  }

  /** Say that there are no more parts. */
  finish() {
    this.followsCamera = false;
    return this;
  }

  /** Return whether sets were added; those who share a model have their own. */
  async update() {
    return false;
  }

  destroy() {
    for (const { buffers } of this.sets) buffers.destroy();
  }
}

/**
 * @typedef {object} Options How tilesets are streamed, and generators checked.
 * @property {string} [source] Address of the tileset, to which those of its tiles are relative.
 * @property {(loaded: number, total: number) => void} [onProgress]
 * @property {AbortSignal} [signal]
 * @property {number} [maxError] Error in pixels above which tiles are refined.
 * @property {number} [maxSplats] Most Gaussians in GPU memory.
 * @property {(Blob | string)[]} [pictures] Of generators that are computed from pictures.
 * @property {string} [target] Whose limits and quirks rules of generators check.
 * @property {(model: Model) => void} [onFirst] Called when the first rows of a file can be drawn.
 * @property {() => void} onChange Called when more rows or tiles have arrived.
 * @property {(error: import("./errors.js").GsgenError) => void} onError
 * @property {(where: string, problem: string) => void} [onWarning] Told what a page does not draw.
 */

/** Return what reads a source: an address, `#id` of an element that holds a file, or its bytes. */
export function requestOf(source, name) {
  if (typeof source !== "string") return { name, bytes: source };
  if (source.startsWith("#")) return { name, bytes: inlined(source) };
  return { name, address: String(new URL(source, document.baseURI)) };
}

/**
 * Read a file: its splats into GPU memory while they arrive, or else its bytes.
 * @param {KernelCache | Promise<KernelCache>} kernels
 * @param {import("./splat_files.js").Request} request
 * @param {Pick<Options, "onProgress" | "onFirst" | "onChange" | "signal">} options
 * @returns {Promise<StillModel | {kind: string, bytes: Uint8Array}>}
 */
export async function readModel(kernels, request, { onProgress, onFirst = () => {}, onChange, signal }) {
  /** @type {StillModel | null} */
  let still = null;
  const failure = Promise.withResolvers();
  // Rows may arrive before the device is there: what they are told to follows in their order.
  const inOrder = inTurns();
  const told = (task) => {
    const turn = inOrder(async () => {
      const own = (still ??= new StillModel(await kernels, (isFirst) => (isFirst ? onFirst(own) : onChange())));
      return signal?.aborted ? undefined : task(own);
    });
    turn.catch(failure.reject);
    return turn;
  };
  let parts = 0;
  const sink = {
    begin(facts) {
      told((model) => model.begin(facts));
      return parts++;
    },
    write: (...words) => told((model) => model.write(...words)),
    end: (...words) => told((model) => model.end(...words)),
  };
  const reading = readInBackground(request, sink, onProgress, signal).then((result) => {
    return result.kind === "splats" ? told((model) => model.finish()) : result;
  });
  try {
    const result = await Promise.race([reading, failure.promise]);
    signal?.throwIfAborted();
    return result;
  } catch (error) {
    /** @type {StillModel | null} */ (still)?.destroy();
    throw error;
  }
}

/** Return the model of what was read. @returns {Promise<Model>} */
export async function modelOf(kernels, read, name, options) {
  return read instanceof StillModel ? read : opened(await kernels, read, name, options);
}

/**
 * Open a model; the promise resolves when all of it has arrived.
 * @param {KernelCache | Promise<KernelCache>} kernels
 * @param {string | ArrayBuffer} source Address of the file, `#id` of an element that holds it, or its bytes.
 * @param {string} name Of the file, for messages.
 * @param {Options} [options]
 */
export async function openModel(kernels, source, name, options = { onChange() {}, onError() {} }) {
  return modelOf(kernels, await readModel(kernels, requestOf(source, name), options), name, options);
}

/** Open a generator, a scene or a tileset from its bytes. */
async function opened(kernels, { kind, bytes }, name, options) {
  if (kind === "onnx") {
    const { GeneratorModel } = await import("./generator.js");
    return GeneratorModel.open(kernels, bytes, name, options);
  }
  if (kind === "scene") {
    const { Stage } = await import("./stage.js");
    return Stage.open(kernels, parsedJson(bytes), name, options);
  }
  const { TilesetModel } = await import("./tileset.js");
  return new TilesetModel(kernels, parsedJson(bytes), name, options);
}
