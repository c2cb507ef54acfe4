/** Models in browsers without WebGPU: three.js sorts and draws them by WebGL 2, for all elements of a page. */

import { GsgenError, failing } from "./errors.js";
import { generatorFrames } from "./frames.js";
import { surveyedExtent } from "./generator_inputs.js";
import { IDENTITY } from "./matrices.js";
import { memoryDevice, numbersOf } from "./memory_device.js";
import { arraysOf, mergeSets } from "./merged_sets.js";
import { openModel } from "./model.js";
import { inTurns, once } from "./once.js";
import { sharedPlans } from "./shared.js";
import { PlacedModel, encodedCanvas } from "./shown_model.js";
import { SplatBuffers, paddedRows } from "./splat_buffers.js";
import { ThreeGaussians, loadThree } from "./three_adapter.js";
import { placeEye } from "./three_modules.js";

/** The renderer of three.js, whose canvas no page shows: a page has few contexts of WebGL. */
const sharedThree = once(
  async () => {
    const modules = await loadThree();
    const canvas = new OffscreenCanvas(1, 1);
    const context = canvas.getContext("webgl2", { alpha: true, antialias: false, preserveDrawingBuffer: true });
    if (!context) throw new GsgenError("this browser has no WebGL 2");
    const lost = new Promise((resolve) => {
      canvas.addEventListener("webglcontextlost", () => resolve({ message: "WebGL lost its context", reason: "" }));
    });
    const renderer = new modules.three.WebGPURenderer({ canvas, context, forceWebGL: true, alpha: true });
    await renderer.init();
    const maxTextureDimension2D = context.getParameter(context.MAX_TEXTURE_SIZE);
    const [device, plans] = [memoryDevice({ maxTextureDimension2D }), await sharedPlans()];
    const openGenerator = (content, name) => FramesModel.open({ device, plans }, content, name);
    const kernels = /** @type {any} */ ({ device, plans, openGenerator });
    return { ...modules, canvas, renderer, lost, device, kernels, inTurn: inTurns() };
  },
  ({ lost }) => lost,
);

/**
 * Show a file; see `show` of backend.js.
 * @param {GsgenError} missing Why WebGPU does not.
 * @param {import("./source_files.js").SourceFile} file
 * @param {import("./backend.js").ShowOptions} options
 */
export async function showByThree(missing, file, name, options) {
  let shared;
  try {
    shared = await sharedThree();
  } catch (error) {
    throw new GsgenError(`${missing.message}, and ${error.message}`, { hint: `${missing.hint} ${error.hint ?? ""}`.trim() });
  }
  shared.lost.then(options.onLost);
  const model = await openModel(shared.kernels, file, name, { ...options, onBegin: undefined });
  return new ModelOfThree(shared, model, file);
}

/** A generator that runs by WebAssembly. */
class FramesModel {
  /** @param {import("./splat_files.js").FileContent} content */
  static async open(kernels, content, name) {
    const frames = await generatorFrames(content, name, "wasm");
    if (frames.inputs.some(({ role }) => role === "image")) {
      frames.destroy();
      failing(name, "Take a browser with WebGPU.")("is computed from pictures, which needs WebGPU");
    }
    const model = new FramesModel(kernels, frames);
    const { buffers } = model;
    model.extent = await surveyedExtent(model, () => ({ rows: numbersOf(buffers.pages[0].rows), count: buffers.count }));
    return model;
  }

  /** @param {any} kernels @param {import("./frames.js").Frames} frames */
  constructor({ device, plans }, frames) {
    const { capacity: count, channels, run, destroy, ...described } = frames;
    Object.assign(this, described);
    this._frames = frames;
    this._channels = channels;
    this.buffers = new SplatBuffers(device, plans, { ...frames, count });
    this.sets = [{ buffers: this.buffers, transform: frames.transform }];
    this.extent = { center: [0, 0, 0], half: [1, 1, 1], reach: 1 };
    /** @type {Float32Array | null} */
    this._appearance = null;
  }

  /** Compute the Gaussians of a frame. */
  async update(values, camera) {
    const { buffers } = this;
    const { rows, appearance, live } = await this._frames.run(values, camera);
    buffers.write(0, rows, appearance === this._appearance ? null : paddedRows(appearance, this._channels, buffers.stride));
    this._appearance = appearance;
    buffers.count = live;
    return false;
  }

  destroy() {
    this._frames.destroy();
  }
}

/** A model that three.js draws; elements use it as they use a `ShownModel`. */
class ModelOfThree extends PlacedModel {
  /** @param {import("./model.js").Model} model */
  constructor(shared, model, file) {
    super(model, file);
    const { three, device } = shared;
    this.renderedBy = "webgl2";
    this._inTurn = shared.inTurn; // of all models: they share a canvas
    this.kernels = { device };
    this._shared = shared;
    this._scene = new three.Scene();
    this._eye = new three.PerspectiveCamera();
    /** @type {ThreeGaussians | null} */
    this._gaussians = null;
    this._shape = ""; // of the sets that three's object was made for
    /** @type {{rows: Float32Array, appearance: Float32Array} | null} Of several sets. */
    this._merged = null;
    this._seen = ""; // the camera for which colours and widths were computed
    /** @type {ImageBitmap | null} */
    this._picture = null;
  }

  /** @param {import("./shown_model.js").Look} look */
  async draw(width, height, look) {
    await this._inTurn(async () => {
      const camera = await this._render(width, height, look);
      if (!camera) return;
      this._picture?.close();
      this._picture = this._shared.canvas.transferToImageBitmap();
      this.camera = camera;
    });
  }

  /** Render into the shared canvas; return the camera. */
  async _render(width, height, { mode, background, inputs }) {
    if (mode !== "color") failing("mode")(`is ${mode}, expected color in a browser without WebGPU`);
    const { model, _shared: { three, renderer } } = this;
    if (this.isDestroyed) return null;
    const camera = this._framed(width, height);
    if (this.isStale || model.followsCamera) {
      await this._update(camera, inputs);
      if (this.isDestroyed) return null;
      this._seen = "";
    }
    this._fill(camera);
    const [red, green, blue, alpha] = background;
    const { isLinear } = model.buffers;
    const space = isLinear ? three.SRGBColorSpace : three.LinearSRGBColorSpace;
    renderer.outputColorSpace = space;
    renderer.setClearColor(new three.Color().setRGB(red, green, blue, space), alpha);
    renderer.setSize(width, height, false);
    placeEye(this._eye, camera);
    this._gaussians?.sort();
    renderer.render(this._scene, this._eye);
    return camera;
  }

  /** Give three.js the Gaussians that a camera sees. A single set stays in its own axes, with its harmonics. */
  _fill(camera) {
    const { sets } = this.model;
    const seen = JSON.stringify(camera);
    if (seen === this._seen || !sets.length) return;
    const [{ buffers, transform, opacityScale = 1, clip, degree = buffers.degree, antialias = buffers.antialias }] = sets;
    const isSingle = sets.length === 1 && opacityScale === 1 && !clip;
    const capacity = sets.reduce((sum, set) => sum + set.buffers.capacity, 0);
    const shape = JSON.stringify([isSingle, capacity, isSingle && [degree, antialias, transform]]);
    const isNew = shape !== this._shape;
    if (isNew) {
      const channels = isSingle && degree !== null ? 3 * (degree + 1) ** 2 : 3;
      const own = { channels, space: degree === null ? "rgb" : "sh", transform, antialias, stride: buffers.stride };
      const merged = { channels: 3, space: "rgb", transform: IDENTITY, antialias: "mip" };
      this._gaussians?.destroy();
      this._gaussians = new ThreeGaussians(this._shared, /** @type {any} */ ({ capacity, ...(isSingle ? own : merged) }));
      this._scene.add(this._gaussians.object);
      this._merged = isSingle ? null : { rows: new Float32Array(10 * capacity), appearance: new Float32Array(3 * capacity) };
      this._shape = shape;
    }
    const gaussians = /** @type {ThreeGaussians} */ (this._gaussians);
    const { _merged: merged } = this;
    if (merged) {
      const live = mergeSets(sets, camera, merged);
      gaussians.fill({ rows: merged.rows, appearance: merged.appearance.subarray(), live });
    } else if (isNew || !this._seen || gaussians.needsCamera) {
      gaussians.fill({ ...arraysOf(sets[0]), live: buffers.count }, camera);
    }
    this._seen = seen;
  }

  async usePosts(posts, _, onError) {
    if (posts.length) onError(new GsgenError("post-process models need WebGPU: the picture is plain"));
    return false;
  }

  isFinal() {
    return true;
  }

  /** Return what shows pictures on a canvas. @param {HTMLCanvasElement} canvas */
  presenterOf(canvas) {
    const context = /** @type {ImageBitmapRenderingContext} */ (canvas.getContext("bitmaprenderer"));
    return { device: this.kernels.device, context, destroy: () => context.transferFromImageBitmap(null) };
  }

  /** Show the last picture. */
  show({ context }) {
    if (!this._picture) return;
    context.transferFromImageBitmap(this._picture);
    this._picture = null;
  }

  /** @param {import("./shown_model.js").Look} look @returns {Promise<Blob>} */
  async picture(width, height, look, encoding = {}) {
    return this._inTurn(async () => {
      const camera = await this._render(width, height, look).finally(() => this.see());
      if (!camera) throw new GsgenError("the model was removed before its picture was drawn");
      return encodedCanvas(this._shared.canvas, encoding);
    });
  }

  /** Surfaces are found by WebGPU alone. */
  async pick() {
    return null;
  }

  destroy() {
    this._picture?.close();
    this._gaussians?.destroy();
    super.destroy();
  }
}
