/** Models in browsers without WebGPU: three.js sorts and draws them by WebGL 2, for all elements of a page. */

import { GsgenError, failing } from "./errors.js";
import { framesOf } from "./frames.js";
import { SURVEY_CAMERA, surveyedValues } from "./generator_inputs.js";
import { linearPart, times } from "./matrices.js";
import { extentOf, mergedExtent } from "./model.js";
import { inTurns, once } from "./once.js";
import { OrbitCamera } from "./orbit_camera.js";
import { Playback } from "./playback.js";
import { encodedCanvas, timeValue } from "./shown_model.js";
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
    return { ...modules, canvas, renderer, lost, device: { limits: { maxTextureDimension2D } }, inTurn: inTurns() };
  },
  ({ lost }) => lost,
);

/**
 * Return three.js as what draws the elements of a page.
 * @param {GsgenError} missing Why WebGPU does not.
 * @returns {Promise<import("./backend.js").Backend>}
 */
export async function webGl2(missing) {
  let shared;
  try {
    shared = await sharedThree();
  } catch (error) {
    throw new GsgenError(`${missing.message}, and ${error.message}`, { hint: `${missing.hint} ${error.hint ?? ""}`.trim() });
  }
  const show = async (bytes, name, file) => {
    const frames = await framesOf(bytes, name, { provider: "wasm" });
    if (frames.inputs.some(({ role }) => role === "image")) {
      frames.destroy();
      failing(name, "Take a browser with WebGPU.")("is computed from pictures, which needs WebGPU");
    }
    return new ModelOfThree(shared, frames, await extentOfFrames(frames), file);
  };
  return { note: " without WebGPU", lost: shared.lost, show };
}

/** Return the extent of some moments. @param {import("./frames.js").Frames} frames */
async function extentOfFrames({ time, run, transform }) {
  const boxes = [];
  for (const values of surveyedValues(time)) {
    const { rows, live } = await run(values, SURVEY_CAMERA);
    boxes.push(extentOf({ rows, count: live }));
  }
  const extent = mergedExtent(boxes);
  return { ...extent, center: times(linearPart(transform), extent.center) }; // which mirrors axes, at most
}

/** A model that three.js draws; elements use it as they use a `ShownModel`. */
class ModelOfThree {
  /** @param {import("./frames.js").Frames} frames */
  constructor(shared, frames, extent, file) {
    const { three, device } = shared;
    this.renderedBy = "webgl2";
    this.kernels = { device };
    this.file = file;
    const { capacity: count, colorSpace, run, destroy, ...described } = frames;
    this.model = { ...described, extent, buffers: { count } };
    this.playback = frames.time ? new Playback(frames.time) : null;
    this.orbit = new OrbitCamera(extent, frames.up);
    /** @type {import("./camera.js").Camera | null} */
    this.camera = null;
    this.isStale = true;
    this.isDestroyed = false;
    this._shared = shared;
    this._frames = frames;
    this._gaussians = new ThreeGaussians(shared, frames);
    this._scene = new three.Scene();
    this._scene.add(this._gaussians.object);
    this._eye = new three.PerspectiveCamera();
    /** @type {import("./frames.js").Frame} */
    this._frame = { rows: new Float32Array(0), appearance: new Float32Array(0), live: 0 };
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
    const { model, playback, _frames: frames, _shared: { three, renderer } } = this;
    if (this.isDestroyed) return null;
    const camera = this.orbit.camera(width, height);
    const needsRun = this.isStale || frames.followsCamera;
    if (needsRun) {
      const time = playback ? { [model.time.name]: timeValue(model, playback) } : {};
      this._frame = await frames.run({ ...time, ...inputs }, camera);
      if (this.isDestroyed) return null;
      this.isStale = false;
    }
    if (needsRun || this._gaussians.needsCamera) this._gaussians.fill(this._frame, camera);
    const [red, green, blue, alpha] = background;
    const isLinear = frames.colorSpace === "linear";
    renderer.outputColorSpace = isLinear ? three.SRGBColorSpace : three.LinearSRGBColorSpace;
    const color = new three.Color().setRGB(red, green, blue, isLinear ? three.SRGBColorSpace : three.LinearSRGBColorSpace);
    renderer.setClearColor(color, alpha);
    renderer.setSize(width, height, false);
    placeEye(this._eye, camera);
    this._gaussians.sort();
    renderer.render(this._scene, this._eye);
    return camera;
  }

  /** Only scenes have timelines of cameras. */
  followTime() {}

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
    const { center, half } = this.model.extent;
    return { min: center.map((x, i) => x - half[i]), max: center.map((x, i) => x + half[i]) };
  }

  destroy() {
    this.isDestroyed = true;
    this._picture?.close();
    this._gaussians.destroy();
    this._frames.destroy();
  }
}
