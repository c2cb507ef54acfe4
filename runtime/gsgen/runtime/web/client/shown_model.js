/** A model on its way to the screen: with the renderer, the camera and the time that it is drawn with. */

import { unproject } from "./camera.js";
import { download } from "./download.js";
import { GsgenError } from "./errors.js";
import { Governor } from "./governor.js";
import { linearPart, normalized, times, transposed } from "./matrices.js";
import { inTurns } from "./once.js";
import { OrbitCamera } from "./orbit_camera.js";
import { Playback } from "./playback.js";
import { Presenter } from "./present.js";
import { Renderer } from "./renderer.js";

/**
 * How a frame looks.
 * @typedef {object} Look
 * @property {"color" | "depth" | "median" | "normal" | "alpha"} mode
 * @property {number[]} background Red, green, blue and alpha in sRGB.
 * @property {Record<string, any>} inputs Values of the model's inputs.
 */

/** Return linear light of a number in sRGB. */
function linearOf(part) {
  return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
}

/** Return the picture of a canvas, encoded. @param {OffscreenCanvas} canvas */
export async function encodedCanvas(canvas, { type = "image/png", quality = undefined } = {}) {
  const blob = await canvas.convertToBlob({ type, quality });
  if (blob.type !== type) throw new GsgenError(`the browser encodes no ${type}`, { hint: "Take image/png." });
  return blob;
}

/** A model with its camera and its time. */
export class PlacedModel {
  /** @param {import("./model.js").Model} model @param {import("./source_files.js").SourceFile} file */
  constructor(model, file) {
    this.model = model;
    this.file = file;
    this.playback = model.time ? new Playback(model.time) : null;
    this.orbit = new OrbitCamera(model.extent, model.up);
    /** @type {import("./camera.js").Camera | null} The camera of the last frame. */
    this.camera = null;
    this.isStale = true; // the Gaussians are those of other inputs
    this.isDestroyed = false;
    /** @type {import("./sound.js").Sound | null} */
    this._sound = null;
    this._isInView = true;
    this._inTurn = inTurns(); // frames, and pictures between them
  }

  get inputs() {
    return this.model.inputs;
  }

  /** Say whether frames come; if not, the model gives back what only they need. */
  see(isInView = this._isInView) {
    this._isInView = isInView;
    this._inTurn(async () => this._isInView || this.isDestroyed || this.model.hide?.());
  }

  /** Play the sound of a scene from now on. @param {ShadowRoot} root Where its captions are shown. */
  async useSound(root, signal) {
    const { playback, model: { sound } } = this;
    if (!sound || !playback) return;
    const files = await Promise.all(sound.addresses.map((address) => address && download(address, undefined, signal)));
    const { Sound } = await import("./sound.js");
    if (!this.isDestroyed) await (this._sound = new Sound(root, playback, sound.start, files)).failed;
  }

  /** Play the sound of the present time, and take the camera, where a timeline has cameras. */
  followTime() {
    this._sound?.follow();
    const place = this.model.cameraAt?.(this.playback?.currentTime ?? 0);
    if (place) this.orbit.move(place);
  }

  /** Return the camera of the orbit, around what has arrived. */
  _framed(width, height) {
    this.orbit.fit(this.model.extent);
    return this.orbit.camera(width, height);
  }

  /** Return the camera in some seconds, where a timeline that plays has cameras. */
  _cameraIn(seconds, { width, height }) {
    const { model, playback } = this;
    const place = playback && model.cameraAt?.(playback.timeIn(seconds));
    if (!place) return null;
    const orbit = Object.assign(Object.create(OrbitCamera.prototype), this.orbit);
    orbit.move(place);
    return orbit.camera(width, height);
  }

  /** Compute the Gaussians of the present time; return whether the pages are others than before. */
  async _update(camera, inputs) {
    const { model, playback } = this;
    const time = playback && model.time ? { [model.time.name]: playback.value } : {};
    const path = playback && !playback.paused && this._cameraIn(0, camera) ? (seconds) => this._cameraIn(seconds, camera) : null;
    const isChanged = await model.update({ ...time, ...inputs }, camera, path);
    if (!this.isDestroyed) this.isStale = false;
    return isChanged;
  }

  /** The box around most centres: floating Gaussians far outside are left out. */
  get boundingBox() {
    const { center, half = [0, 0, 0] } = this.model.extent;
    return { min: center.map((x, i) => x - half[i]), max: center.map((x, i) => x + half[i]) };
  }

  destroy() {
    this.isDestroyed = true;
    this._sound?.destroy();
    this.model.destroy();
  }
}

export class ShownModel extends PlacedModel {
  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {import("./model.js").Model} model
   * @param {import("./source_files.js").SourceFile} file
   * @param {() => void} onStale Called when a frame has to be drawn again.
   */
  constructor(kernels, model, file, onStale) {
    super(model, file);
    this.kernels = kernels;
    /** @type {"webgpu" | "webgl2"} */
    this.renderedBy = "webgpu";
    this.renderer = new Renderer(kernels, { onStale });
    this.renderer.setScene(model.sets);
    this._governor = new Governor();
    this._doneAt = 0; // when the last frame was measured
    this._isReduced = false;
    this._state = ""; // of the last frame
    /** @type {import("./post_process.js").Posts | null} */
    this._posts = null;
    this._hasPosts = false; // or opens them
    this._opening = Promise.resolve();
    /** @type {import("./post_process.js").Picture | null} What comes of the last frame. */
    this._processed = null;
    this._stop = new AbortController();
  }

  /** The inputs of the model, and of post-process models. */
  get inputs() {
    return [...this.model.inputs, ...(this._posts?.inputs ?? [])];
  }

  /**
   * Take the post-process models that pictures go through from now on.
   * @param {import("./post_process.js").Post[]} posts
   * @param {string} target Whose limits rules check.
   * @param {(error: GsgenError) => void} onError Told why there are none.
   * @returns {Promise<boolean>} Whether there were or are any.
   */
  async usePosts(posts, target, onError) {
    if (!posts.length && !this._hasPosts) return false;
    this._hasPosts = posts.length > 0;
    this._stop.abort();
    const { signal } = (this._stop = new AbortController());
    this._onPostError = onError;
    this._opening = (async () => {
      try {
        const opened = posts.length ? await (await import("./post_process.js")).Posts.open(this.kernels, posts, target, signal) : null;
        await this._inTurn(async () => {
          if (signal.aborted) return opened?.destroy();
          this._posts?.destroy();
          [this._posts, this._processed] = [opened, null];
        });
      } catch (error) {
        if (!signal.aborted) onError(error);
      }
    })();
    await this._opening;
    return true;
  }

  /** Compile the kernels of a frame, so that those of few rows do not queue up. @param {Look} look */
  async compile(width, height, look) {
    return this._inTurn(() => this.renderer.configure(this._framed(width, height), [this._output(look)]));
  }

  /** What a frame shows of a file, as text. */
  _stateOf(camera, { mode, background }) {
    return JSON.stringify([camera, mode, background, this.model.buffers.count]);
  }

  /** Return whether the last frame shows all that has arrived of a file. @param {Look} look */
  async showsAll(width, height, look) {
    await this._inTurn(async () => {});
    return this._state === this._stateOf(this._framed(width, height), look);
  }

  /**
   * Draw a frame of the camera into GPU memory.
   * @param {Look} look
   * @param {number} [leastScale] Below 1, slow frames have fewer pixels: no fewer than this share of a side.
   */
  async draw(width, height, look, leastScale = 1) {
    return this._inTurn(async () => {
      const begun = performance.now();
      const scale = Math.max(this._governor.scale, leastScale);
      const [columns, rows] = [width, height].map((side) => Math.max(Math.round(scale * side), 1));
      this._processed = null;
      this._isReduced = scale < 1;
      await this._drawWith(this.renderer, this._framed(columns, rows), look);
      if (leastScale === 1) return;
      this.kernels.device.queue.onSubmittedWorkDone().then(() => {
        const now = performance.now();
        this._governor.measured(now - Math.max(begun, this._doneAt));
        this._doneAt = now;
      });
    });
  }

  /** Whether the last frame is what stays. @param {Look} look */
  isFinal(look) {
    return !this._isReduced && (!this._posts || look.mode !== "color" || Boolean(this._processed));
  }

  /** Draw a frame that stays: it goes through post-process models. @param {Look} look */
  async drawFinal(width, height, look) {
    return this._inTurn(async () => {
      await this._drawWith(this.renderer, this._framed(width, height), look);
      this._isReduced = false;
      if (this.camera) this._processed = await this._process(this.renderer, this.camera, look);
    });
  }

  /** Return the image of a renderer. @returns {import("./post_process.js").Picture} */
  _plain(renderer, look) {
    const image = renderer.host.image(this._output(look));
    return { image, isLinear: this.model.buffers.isLinear, backgroundAlpha: look.background[3] };
  }

  /** Return what comes of the image of a renderer; the image itself where a model fails. */
  async _process(renderer, { width, height }, look) {
    const plain = this._plain(renderer, look);
    if (!this._posts || look.mode !== "color") return plain;
    try {
      return await this._posts.run(plain, width, height, look.inputs, this.playback?.currentTime ?? 0);
    } catch (error) {
      if (!(error instanceof GsgenError)) throw error;
      this._onPostError(error);
      return plain;
    }
  }

  /** Return what shows frames on a canvas. @param {HTMLCanvasElement | OffscreenCanvas} canvas */
  presenterOf(canvas) {
    return new Presenter(this.kernels, canvas);
  }

  /** Show the last frame on a canvas. @param {Presenter} presenter @param {Look} look */
  show(presenter, look) {
    if (this.camera) this._show(presenter, this.camera, look, this._processed ?? this._plain(this.renderer, look));
  }

  async _drawWith(renderer, camera, look, { isWhole = false } = {}) {
    const { model } = this;
    if (this.isDestroyed) return;
    if ((this.isStale || model.followsCamera) && (await this._update(camera, look.inputs))) this.renderer.setScene(model.sets);
    if (this.isDestroyed) return;
    const [red, green, blue, alpha] = look.background;
    const sRgb = [red, green, blue];
    const light = model.buffers.isLinear ? sRgb.map(linearOf) : sRgb;
    const output = this._output(look);
    const options = { outputs: [output], background: light.map((part) => part * alpha), ...(await model.surfaces?.(camera, output)) };
    if (renderer !== this.renderer) renderer.setScene(model.sets);
    const state = this._stateOf(camera, look);
    if (isWhole) await renderer.drawWhole(camera, options);
    else await renderer.draw(camera, options);
    if (renderer === this.renderer) [this.camera, this._state] = [camera, state];
  }

  _output({ mode }) {
    return mode === "normal" || mode === "color" ? mode : "depth";
  }

  _show(presenter, camera, look, { image, ...light }) {
    const { distance, extent } = this.orbit;
    const depths = [Math.max(distance - extent.reach, 0), distance + extent.reach];
    presenter.show(image, camera, { mode: look.mode, depths, ...light });
  }

  /** Run a task with a renderer of its own between two frames. */
  async _aside(task) {
    return this._inTurn(async () => {
      const renderer = new Renderer(this.kernels);
      try {
        return await task(renderer);
      } finally {
        renderer.destroy();
      }
    });
  }

  /**
   * Return a picture of the model in its own size, encoded.
   * @param {Look} look
   * @returns {Promise<Blob>}
   */
  async picture(width, height, look, encoding = {}) {
    const canvas = new OffscreenCanvas(width, height);
    const presenter = this.presenterOf(canvas);
    await this._opening;
    try {
      return await this._aside(async (renderer) => {
        const camera = this._framed(width, height);
        await this._drawWith(renderer, camera, look, { isWhole: true });
        if (this.isDestroyed) throw new GsgenError("the model was removed before its picture was drawn");
        this._show(presenter, camera, look, await this._process(renderer, camera, look));
        return encodedCanvas(canvas, encoding); // at once: the next task finds an empty canvas
      });
    } finally {
      presenter.destroy();
      this.see();
    }
  }

  /**
   * Return the point of the surface and its normal at a place of the last frame, in world units.
   * @param {number} across Share of the width, from 0 to 1.
   * @param {number} down
   * @returns {Promise<{point: number[], normal: number[] | null} | null>} Null if there is no surface.
   */
  async pick(across, down) {
    const { camera } = this;
    if (!camera || !(across >= 0 && across < 1 && down >= 0 && down < 1)) return null;
    const [x, y] = [across * camera.width, down * camera.height];
    const pixel = /** @type {const} */ ([Math.floor(x), Math.floor(y)]);
    return this._aside(async (renderer) => {
      const { surfaces } = this.model;
      renderer.setScene(this.model.sets);
      await renderer.drawWhole(camera, { outputs: ["depth"], ...(await surfaces?.(camera, "depth")) });
      const [, median] = await renderer.readPixel("depth", ...pixel);
      if (!(median > 0)) return null;
      const point = unproject(camera, x, y, median);
      if (surfaces) return { point, normal: null }; // normals of meshes are not drawn
      await renderer.drawWhole(camera, { outputs: ["normal"] });
      const [a, b, c] = await renderer.readPixel("normal", ...pixel);
      const normal = Math.hypot(a, b, c) > 0 ? normalized(times(transposed(linearPart(camera.view)), [a, b, c])) : null;
      return { point, normal };
    });
  }

  /** Release all GPU memory. */
  destroy() {
    this._stop.abort();
    this._posts?.destroy();
    this.renderer.destroy();
    super.destroy();
  }
}
