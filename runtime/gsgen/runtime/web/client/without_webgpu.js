/** Models in browsers without WebGPU: three.js sorts and draws them by WebGL 2, for all elements of a page. */

import { GsgenError, failing } from "./errors.js";
import { extentInBackground } from "./file_reader.js";
import { mergedExtent } from "./framing.js";
import { generatorFrames } from "./frames.js";
import { SURVEY_CAMERA, surveyedValues } from "./generator_inputs.js";
import { IDENTITY, linearPart, times } from "./matrices.js";
import { memoryDevice, numbersOf } from "./memory_device.js";
import { arraysOf, mergeSets } from "./merged_sets.js";
import { openModel } from "./model.js";
import { inTurns, once } from "./once.js";
import { OrbitCamera } from "./orbit_camera.js";
import { Playback } from "./playback.js";
import { sharedPlans } from "./shared.js";
import { encodedCanvas } from "./shown_model.js";
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
    await model._survey();
    return model;
  }

  /** @param {any} kernels @param {import("./frames.js").Frames} frames */
  constructor({ device, plans }, frames) {
    const { capacity: count, channels, run, destroy, ...described } = frames;
    Object.assign(this, described);
    this._frames = frames;
    this._device = device;
    this._channels = channels;
    this.buffers = new SplatBuffers(device, plans, { ...frames, count });
    this.sets = [{ buffers: this.buffers, transform: frames.transform }];
    this.extent = { center: [0, 0, 0], half: [1, 1, 1], reach: 1 };
    /** @type {Float32Array | null} */
    this._appearance = null;
  }

  /** Compute the Gaussians of a frame. */
  async update(values, camera) {
    const { buffers, _device: { queue } } = this;
    const { rows, appearance, live } = await this._frames.run(values, camera);
    const write = (buffer, { buffer: bytes, byteOffset, byteLength }) => queue.writeBuffer(buffer, 0, bytes, byteOffset, byteLength);
    const [page] = buffers.pages;
    write(page.rows, rows);
    if (appearance !== this._appearance) write(page.appearance, paddedRows(appearance, this._channels, buffers.stride));
    this._appearance = appearance;
    buffers.count = live;
    return false;
  }

  /** Run some moments, and find a box around the Gaussians of all. */
  async _survey() {
    const boxes = [];
    for (const values of surveyedValues(this._frames.time)) {
      await this.update(values, SURVEY_CAMERA);
      boxes.push(await extentInBackground({ rows: numbersOf(this.buffers.pages[0].rows), count: this.buffers.count }));
    }
    const extent = mergedExtent(boxes);
    this.extent = { ...extent, center: times(linearPart(this._frames.transform), extent.center) }; // which mirrors axes, at most
  }

  destroy() {
    this._frames.destroy();
  }
}

/** A model that three.js draws; elements use it as they use a `ShownModel`. */
class ModelOfThree {
  /** @param {import("./model.js").Model} model */
  constructor(shared, model, file) {
    const { three, device } = shared;
    this.renderedBy = "webgl2";
    this.kernels = { device };
    this.file = file;
    this.model = model;
    this.playback = model.time ? new Playback(model.time) : null;
    this.orbit = new OrbitCamera(model.extent, model.up);
    /** @type {import("./camera.js").Camera | null} */
    this.camera = null;
    this.isStale = true;
    this.isDestroyed = false;
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
    await this._shared.inTurn(async () => {
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
    const { model, playback, _shared: { three, renderer } } = this;
    if (this.isDestroyed) return null;
    const camera = this.orbit.camera(width, height);
    if (this.isStale || model.followsCamera) {
      const time = playback && model.time ? { [model.time.name]: playback.value } : {};
      await model.update({ ...time, ...inputs }, camera);
      if (this.isDestroyed) return null;
      [this.isStale, this._seen] = [false, ""];
    }
    this._fill(camera);
    const [red, green, blue, alpha] = background;
    const { isLinear } = model.buffers;
    renderer.outputColorSpace = isLinear ? three.SRGBColorSpace : three.LinearSRGBColorSpace;
    const color = new three.Color().setRGB(red, green, blue, isLinear ? three.SRGBColorSpace : three.LinearSRGBColorSpace);
    renderer.setClearColor(color, alpha);
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

  /** Take the camera of the present time, where a timeline has cameras. */
  followTime() {
    const place = this.model.cameraAt?.(this.playback?.currentTime ?? 0);
    if (place) this.orbit.move(place);
  }

  get inputs() {
    return this.model.inputs;
  }

  async usePosts(posts, _, onError) {
    if (posts.length) onError(new GsgenError("post-process models need WebGPU: the picture is plain"));
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
    return this._shared.inTurn(async () => {
      if (!(await this._render(width, height, look))) {
        throw new GsgenError("the model was removed before its picture was drawn");
      }
      return encodedCanvas(this._shared.canvas, encoding);
    });
  }

  /** Surfaces are found by WebGPU alone. */
  async pick() {
    return null;
  }

  get boundingBox() {
    const { center, half = [0, 0, 0] } = this.model.extent;
    return { min: center.map((x, i) => x - half[i]), max: center.map((x, i) => x + half[i]) };
  }

  destroy() {
    this.isDestroyed = true;
    this._picture?.close();
    this._gaussians?.destroy();
    this.model.destroy();
  }
}
