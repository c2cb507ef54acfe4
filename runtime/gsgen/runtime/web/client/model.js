/** Models that an element shows: splat files, and generators that compute new ones every frame. */

import { parsedJson } from "./download.js";
import { readInBackground } from "./file_reader.js";
import { mergedExtent } from "./framing.js";
import { moved } from "./matrices.js";
import { inTurns, remembered } from "./once.js";
import { SourceFile, sourceFile } from "./source_files.js";
import { SplatBuffers } from "./splat_buffers.js";

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
 * @property {(values: Record<string, any>, camera: any, path?: ((seconds: number) => any) | null) => Promise<boolean>} update
 *     Computes a frame; true if the pages are others than before. The path is the camera in some seconds.
 * @property {() => void} [hide] Gives back what only frames need, until the next one.
 * @property {() => void} destroy
 * @property {number} [missingPictures] How many pictures the model needs before it can be shown.
 * @property {any} [manifest] Of generators, with the findings of rules.
 * @property {any[]} [findings]
 * @property {import("./post_process.js").Post[]} [posts] Of scenes.
 * @property {{start: number, addresses: (string | null)[]} | null} [sound] Of scenes: a recording and its captions.
 * @property {number[] | null} [background] Of scenes: red, green, blue and alpha.
 * @property {Partial<import("./orbit_camera.js").Orbit> & {view?: number[]}} [camera] Of scenes: the first one.
 * @property {import("./scene_file.js").SceneAnnotation[]} [annotations] Of scenes.
 * @property {(camera: any, output: string) => Promise<any>} [surfaces] Of scenes: options with which a renderer
 *     draws meshes among the Gaussians.
 * @property {import("./tileset.js").Statistics | null} [statistics] Of tilesets.
 * @property {(seconds: number) => any} [cameraAt] Of scenes: the orbit at a time; null without one.
 */

/** The model of a splat file, whose rows are drawn while they arrive. */
class StillModel {
  /** @param {KernelCache} kernels @param {() => void} onChange */
  constructor(kernels, onChange) {
    this.kernels = kernels;
    this._onChange = onChange;
    /** @type {{buffers: SplatBuffers, transform: readonly number[]}[]} */
    this.sets = [];
    /** @type {import("./framing.js").Extent[]} */
    this._extents = [];
    this.extent = { center: [0, 0, 0], half: [0, 0, 0], reach: 1 };
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

  begin(facts) {
    const { device, plans } = this.kernels;
    this.sets.push({ buffers: new SplatBuffers(device, plans, facts), transform: facts.transform });
    if (facts.up) this.up = facts.up;
  }

  write(part, first, rows, appearance) {
    const { buffers } = this.sets[part];
    buffers.write(first, rows, appearance);
    if (rows) buffers.count = first + rows.length / 10;
  }

  grow(part, extent) {
    // The transform of a file mirrors axes, at most.
    this._extents[part] = { ...extent, center: moved(this.sets[part].transform, extent.center) };
    const known = Object.values(this._extents);
    this.extent = known.length === 1 ? known[0] : mergedExtent(known);
    this._onChange();
  }

  /** Say how many rows of a part there are. */
  end(part, count, extent) {
    this.sets[part].buffers.count = count;
    this.grow(part, extent);
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
 * @property {number} [maxSplats] Most Gaussians of the page's tilesets in GPU memory.
 * @property {(Blob | string)[]} [pictures] Of generators that are computed from pictures.
 * @property {string} [imageCameras] Address of the cameras of these pictures.
 * @property {string} [target] Whose limits and quirks rules of generators check.
 * @property {(model: any) => void} [onBegin] Called when rows of a file begin to arrive.
 * @property {() => void} onChange Called when more rows or tiles have arrived.
 * @property {(error: import("./errors.js").GsgenError) => void} onError
 * @property {(where: string, problem: string) => void} [onWarning] Told what a page does not draw.
 */

/** A file on its way into GPU memory, for all who open it; of other files, their bytes. */
class Reading {
  /**
   * @param {KernelCache | Promise<KernelCache>} kernels
   * @param {SourceFile} file
   * @param {() => void} forget Called when all who opened it have left.
   */
  constructor(kernels, file, name, target, forget) {
    /** @type {Set<{options: Options, begin: () => void}>} */
    this._users = new Set();
    this._forget = forget;
    this._stop = new AbortController();
    /** @type {StillModel | null} */
    this._still = null;
    this._content = this._read(kernels, file, name, target);
    this._content.catch(() => {}); // each user hears of it
  }

  /** @returns {Promise<import("./splat_files.js").FileContent>} */
  async _read(kernels, file, name, target) {
    const { signal } = this._stop;
    const failure = Promise.withResolvers();
    Promise.resolve(kernels).catch(failure.reject);
    // Rows may arrive before the device is there: what they are told to follows in their order.
    const inOrder = inTurns();
    const told = (task) => {
      const turn = inOrder(async () => {
        const known = await kernels;
        if (signal.aborted) return;
        this._still ??= new StillModel(known, () => this._users.forEach(({ options }) => options.onChange()));
        await task(this._still);
      });
      turn.catch(failure.reject);
      return turn;
    };
    const begin = (still, facts) => {
      still.begin(facts);
      if (still.sets.length === 1) this._users.forEach((user) => user.begin());
    };
    let parts = 0;
    const sink = {
      begin(facts) {
        told((still) => begin(still, facts));
        return parts++;
      },
      write: (...words) => told((still) => still.write(...words)),
      grow: (...words) => told((still) => still.grow(...words)),
      end: (...words) => told((still) => still.end(...words)),
    };
    const tell = (loaded, total) => this._users.forEach(({ options }) => options.onProgress?.(loaded, total));
    const reading = readInBackground(file.request(name, target), sink, tell, signal).then(async (content) => {
      file.wasRead = true;
      if (content.kind === "splats") await told((still) => (still.followsCamera = false));
      return content;
    });
    return /** @type {any} */ (Promise.race([reading, failure.promise]));
  }

  /**
   * Wait until all has arrived. Splats are a model that is shared: all who opened it destroy it.
   * @param {Options} options
   * @returns {Promise<{model: Model | null, content: import("./splat_files.js").FileContent}>}
   */
  async open(options) {
    const { signal, onBegin } = options;
    const left = Promise.withResolvers();
    left.promise.catch(() => {});
    /** @type {any} */
    let model = null;
    const leave = () => {
      if (!this._users.delete(user) || this._users.size) return;
      this._forget();
      this._stop.abort();
      this._still?.destroy();
    };
    const begin = () => {
      model = Object.create(this._still, { destroy: { value: leave } });
      if (!signal?.aborted) onBegin?.(model);
    };
    const abort = () => left.reject(signal?.reason);
    const user = { options, begin };
    this._users.add(user);
    signal?.addEventListener("abort", abort);
    try {
      signal?.throwIfAborted();
      if (this._still?.sets.length) begin();
      const content = /** @type {any} */ (await Promise.race([this._content, left.promise]));
      if (content.kind !== "splats") leave();
      return { model, content };
    } catch (error) {
      leave();
      throw error;
    } finally {
      signal?.removeEventListener("abort", abort);
    }
  }
}

/**
 * Open a model; the promise resolves when all of it has arrived.
 * @param {KernelCache | Promise<KernelCache>} kernels
 * @param {SourceFile | string | ArrayBuffer} source The file, its address, `#id` of an element that holds it, or its bytes.
 * @param {string} name Of the file, for messages.
 * @param {Options} [options]
 * @returns {Promise<Model>}
 */
export async function openModel(kernels, source, name, options = { onChange() {}, onError() {} }) {
  const file = source instanceof SourceFile ? source : typeof source === "string" ? sourceFile(source) : new SourceFile(name, source);
  const { target } = options;
  const readings = remembered(file.readings, kernels, () => new Map());
  const reading = remembered(readings, target, () => new Reading(kernels, file, name, target, () => readings.delete(target)));
  const { model, content } = await reading.open(options);
  if (model) return model;
  const { kind, bytes } = content;
  if (kind === "onnx") {
    const { GeneratorModel } = await import("./generator.js");
    return GeneratorModel.open(await kernels, content, name, options);
  }
  if (kind === "scene") {
    const { Stage } = await import("./stage.js");
    return Stage.open(await kernels, parsedJson(bytes), name, options);
  }
  const { TilesetModel } = await import("./tileset.js");
  return TilesetModel.open(await kernels, parsedJson(bytes), name, options);
}
