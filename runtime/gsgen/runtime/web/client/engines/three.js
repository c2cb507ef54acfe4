/** Models in scenes of three.js r187: objects that its `WebGPURenderer` draws, through its passes and in headsets. */

import { failing } from "../errors.js";
import { open } from "../frames.js";
import { IDENTITY, composed, determinant, linearPart, transposed4 } from "../matrices.js";
import { Playback, valueOfTime } from "../playback.js";
import { ThreeGaussians, loadThree } from "../three_adapter.js";
import { CAMERA_AXES } from "../three_modules.js";

export * from "../three_adapter.js";

const MODES = ["color", "depth", "alpha"];

/** A model whose `object` a scene of three.js holds. */
export class ThreeModel {
  /**
   * Open a model from its address.
   * @param {string} address
   * @param {{provider?: "webgpu" | "wasm", isEncoded?: boolean}} [options] See the constructor.
   */
  static async open(address, { provider, ...options } = {}) {
    const [modules, frames] = await Promise.all([loadThree(), open(address, { provider })]);
    return new ThreeModel(modules, frames, options);
  }

  /**
   * @param {{three: any, GaussianSplat: any}} modules As `loadThree` returns them.
   * @param {import("../frames.js").Frames} frames
   * @param {{isEncoded?: boolean}} [options] Whether sRGB colours are blended as they are, for renderers
   *     whose `outputColorSpace` is `LinearSRGBColorSpace`. Otherwise they are light, as those of materials.
   */
  constructor(modules, frames, { isEncoded = false } = {}) {
    const { three } = modules;
    this.frames = frames;
    /** Values of inputs by name or role; another object when they change. @type {Record<string, any>} */
    this.values = {};
    this._three = three;
    this._isEncoded = isEncoded;
    this._gaussians = new ThreeGaussians(modules, { ...frames, transform: IDENTITY });
    this._playback = frames.time && new Playback(frames.time);
    /** @type {import("../frames.js").Frame | null} */
    this._frame = null;
    /** @type {any[]} Inputs that the frame was computed of. */
    this._cause = [];
    this._isDestroyed = false;
    /** @type {import("../camera.js").Camera | null} Of the last picture, in the rows' axes. */
    this._camera = null;
    this._seen = ""; // the camera for which Gaussians are widened
    const splats = this._gaussians.object;
    splats.applyMatrix4(new three.Matrix4().fromArray(transposed4([...frames.transform])));
    const [x, y, z] = frames.up;
    const turn = new three.Euler(y < 0 ? Math.PI : (-z * Math.PI) / 2, 0, (x * Math.PI) / 2); // three.js has y up
    splats.applyMatrix4(new three.Matrix4().makeRotationFromEuler(turn));
    this._splats = splats;
    /** What scenes hold: place, turn and scale are free. */
    this.object = new three.Group();
    this.object.add(splats);
    this._ownColor = splats.material.colorNode;
    // three.js sees harmonics from one place; headsets have two eyes.
    const { cameraPosition, modelWorldMatrixInverse, overrideNode, vec4 } = three.TSL;
    const { center, eye } = this._gaussians.nodes(three.TSL);
    this._center = vec4(center, 1);
    splats.material.contextNode = overrideNode(eye, modelWorldMatrixInverse.mul(vec4(cameraPosition, 1)).xyz);
    const prepare = splats.onBeforeRender;
    splats.onBeforeRender = (renderer, scene, camera) => {
      this._see(renderer, camera);
      prepare(renderer, scene, camera);
    };
    this.mode = "color";
  }

  /** Factor of all opacities. */
  get opacity() {
    return this._splats.material.opacity;
  }

  set opacity(opacity) {
    this._splats.material.opacity = opacity;
  }

  /** Colours that are drawn: the model's; the depth of each Gaussian, near ones in white; or white. */
  get mode() {
    return this._mode;
  }

  set mode(mode) {
    if (!MODES.includes(mode)) failing("mode")(`is ${mode}, expected ${MODES.join(", ")}`);
    this._mode = mode;
    const { material } = this._splats;
    material.colorNode = this._paint(this._three.TSL);
    material.needsUpdate = true;
  }

  /** Whether its time begins again after its end; at first, as the model says. */
  get loop() {
    return !!this._playback?.loop;
  }

  set loop(isEndless) {
    if (this._playback) this._playback.loop = isEndless;
  }

  /** The sphere around the last frame, in the world. */
  get sphere() {
    this._splats.updateWorldMatrix(true, false);
    return this._splats.boundingSphere.clone().applyMatrix4(this._splats.matrixWorld);
  }

  /**
   * Compute the frame of a time, unless it is the last one.
   * @param {number} seconds
   * @returns {Promise<import("../frames.js").Frame | null>}
   */
  async frameAt(seconds) {
    const { frames, values, _playback: playback, _camera: camera } = this;
    const time = playback && valueOfTime(playback, playback.timeIn(seconds) / playback.duration);
    const cause = [time, values, frames.followsCamera && JSON.stringify(camera)];
    if (this._isDestroyed || (this._frame && cause.every((part, index) => part === this._cause[index]))) return null;
    const frame = await frames.run(frames.time ? { [frames.time.name]: time, ...values } : values, camera ?? undefined);
    this._cause = cause;
    return frame;
  }

  /** Show a frame in the next picture. @param {import("../frames.js").Frame} frame */
  show(frame) {
    this._frame = frame;
    this._gaussians.fill(frame, this._camera);
  }

  /** Return the colours of a mode, of nodes of three.js. */
  _paint({ Fn, cameraViewMatrix, modelWorldMatrix, sRGBTransferEOTF, sRGBTransferOETF, uniform, varying, vec3, vec4 }) {
    const { _center: center, _mode: mode, _isEncoded: isEncoded, _splats: splats } = this;
    const isLinear = this.frames.colorSpace === "linear";
    const sphere = uniform(new this._three.Vector4()).onObjectUpdate(({ camera }, { value }) => {
      const around = splats.boundingSphere.clone().applyMatrix4(splats.matrixWorld);
      value.set(...around.center.applyMatrix4(camera.matrixWorldInverse).toArray(), around.radius);
    });
    const height = varying(cameraViewMatrix.mul(modelWorldMatrix.mul(center)).z);
    return Fn(() => {
      const own = this._ownColor.toVar();
      let color = own.rgb;
      if (mode === "alpha") color = vec3(1);
      else if (mode === "depth") color = vec3(height.sub(sphere.z).div(sphere.w).add(1).div(2).clamp(0, 1));
      else if (isLinear && isEncoded) color = sRGBTransferOETF(color);
      else if (!isLinear && !isEncoded) color = sRGBTransferEOTF(color);
      return vec4(color, own.a);
    })();
  }

  /** Take the camera of a picture: of a headset its first eye, beside which the other one looks the same way. */
  _see(renderer, camera) {
    const eye = camera.isArrayCamera ? camera.cameras[0] : camera;
    const { width, height } = eye.viewport ?? renderer.getRenderTarget() ?? renderer.getDrawingBufferSize(new this._three.Vector2());
    const view = composed(CAMERA_AXES, transposed4(composedElements(eye.matrixWorldInverse, this._splats.matrixWorld)));
    const size = Math.cbrt(Math.abs(determinant(linearPart(view)))) || 1; // of the object: the camera is scaled instead
    const [fx, , , , , fy, , , right, up] = eye.projectionMatrix.elements;
    this._camera = {
      view: view.map((number, index) => (index < 12 ? number / size : number)),
      fx: (fx * width) / 2, fy: (fy * height) / 2, cx: ((1 - right) * width) / 2, cy: ((1 + up) * height) / 2,
      width, height, near: eye.near / size,
    };
    if (!this._gaussians.needsCamera || !this._frame) return;
    const seen = JSON.stringify(this._camera);
    if (seen !== this._seen) this._gaussians.fill(this._frame, this._camera);
    this._seen = seen;
  }

  /** Remove its object, and release its memory. */
  destroy() {
    this._isDestroyed = true;
    this.object.removeFromParent();
    this._gaussians.destroy();
    this.frames.destroy();
  }
}

/** Return the elements of a product of two matrices of three.js. */
const composedElements = (a, b) => a.clone().multiply(b).elements;

/** One time for all its models, which show frames of the same moment. */
export class ThreeClock {
  /** @param {ThreeModel[]} models */
  constructor(...models) {
    this.models = new Set(models);
    /** Seconds, of which each model shows its own share: see `loop`. */
    this.time = 0;
    this.rate = 1;
    this.paused = false;
    /** @type {number | null} */
    this._last = null;
    /** @type {Promise<void> | null} */
    this._round = null;
  }

  /**
   * Move on to a moment of the page's clock; new frames are begun once the last ones are shown.
   * @param {number} now Milliseconds, as animation loops get them.
   * @returns {Promise<void>} Settles with the frames; pictures need not wait for them.
   */
  update(now) {
    if (!this.paused && this._last !== null) this.time += (this.rate * (now - this._last)) / 1000;
    this._last = now;
    return this._begin();
  }

  /** Show the frames of a time. @param {number} seconds */
  async seek(seconds) {
    this.time = seconds;
    await this._round;
    await this._begin();
  }

  /** Begin to show the frames of its time, unless a round of them runs. */
  _begin() {
    return (this._round ??= this._show().finally(() => (this._round = null)));
  }

  async _show() {
    const models = [...this.models];
    const frames = await Promise.all(models.map((model) => model.frameAt(this.time)));
    for (const [index, model] of models.entries()) {
      const frame = frames[index];
      if (frame && this.models.has(model)) model.show(frame);
    }
  }
}
