/** The element `<gsgen-model>`: shows a splat file or a generator in a page. */

import { unproject } from "./camera.js";
import { ControlListener, OrbitCamera } from "./controls.js";
import { download } from "./download.js";
import { ElementView } from "./element_view.js";
import { GsgenError } from "./errors.js";
import { openModel } from "./model.js";
import { Playback } from "./playback.js";
import { Presenter } from "./present.js";
import { Renderer } from "./renderer.js";
import { sharedKernels } from "./shared.js";

const MOST_PIXELS_PER_CSS = 2;
const MOST_LOSSES = 3; // of the device, after which the element gives up

/** @param {string} text Such as `#102030` or `0.1 0.2 0.3`. */
function colorOf(text) {
  const hex = /^#([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2})$/i.exec(text.trim());
  const numbers = hex
    ? hex.slice(1).map((part) => parseInt(part, 16) / 255)
    : text.trim().split(/[\s,]+/).map(Number);
  return numbers.length === 3 && numbers.every(Number.isFinite) ? numbers : [0, 0, 0];
}

/** Return the value of a model's time input; frame numbers are whole. */
function timeValue({ time }, playback) {
  return time.isWhole ? Math.min(Math.floor(playback.value), time.high) : playback.value;
}

export class GsgenModel extends HTMLElement {
  static observedAttributes = [
    "src", "alt", "poster", "camera-controls", "camera-orbit", "field-of-view", "up", "background",
    "mode", "time", "loop",
  ];

  constructor() {
    super();
    this._view = new ElementView(this.attachShadow({ mode: "open" }));
    /** Values of the model's inputs, by name; set it, or change it and call `requestFrame()`. */
    this._inputs = {};
    /** What was found out about the model: its errors, or its manifest. */
    this.report = null;
    this._losses = 0;
    this._frameRequest = 0;
    this._isVisible = false;
    this._isDrawing = false;
    this._view.play.addEventListener("click", () => (this.paused ? this.play() : this.pause()));
    this._view.time.addEventListener("input", () => {
      // The slider shows the present time again when the model pauses.
      const share = Number(this._view.time.value) / 1000;
      this.pause();
      this.currentTime = share * this.duration;
    });
    this.addEventListener("dragover", (event) => this.hasAttribute("file-drop") && event.preventDefault());
    this.addEventListener("drop", (event) => this._drop(event));
    this._resizes = new ResizeObserver(() => this.requestFrame());
    this._visibility = new IntersectionObserver(([entry]) => this._see(entry.isIntersecting));
  }

  connectedCallback() {
    this._view.describe(this.getAttribute("alt") ?? "", this.hasAttribute("camera-controls"));
    this._view.showPoster(this.getAttribute("poster"));
    this._resizes.observe(this);
    this._visibility.observe(this);
    if (this.getAttribute("loading") === "eager") this._load();
  }

  disconnectedCallback() {
    this._resizes.disconnect();
    this._visibility.disconnect();
    this._release();
  }

  attributeChangedCallback(name, before, now) {
    if (!this.isConnected || before === now) return;
    if (name === "src" && (this._loading || this._isVisible)) this._load();
    else if (name === "alt" || name === "camera-controls") {
      this._view.describe(this.getAttribute("alt") ?? "", this.hasAttribute("camera-controls"));
      this._listen();
    } else if (name === "poster") this._view.showPoster(now);
    else if (["camera-orbit", "field-of-view", "up"].includes(name)) this._placeCamera();
    else if (name === "time" && this._playback) {
      this._playback.value = Number(now);
      this._timeChanged();
    } else if (name === "loop" && this._playback) this._playback.loop = this._loops();
    this.requestFrame();
  }

  // ----- Properties and methods

  /** Seconds since the start of the model's time. */
  get currentTime() {
    return this._playback?.currentTime ?? 0;
  }

  set currentTime(seconds) {
    if (!this._playback) return;
    this._playback.currentTime = Math.min(Math.max(seconds, 0), this._playback.duration);
    this._timeChanged();
  }

  get duration() {
    return this._playback?.duration ?? 0;
  }

  get paused() {
    return this._playback?.paused ?? true;
  }

  /** Values of the model's inputs by name; they replace those of the time and the camera. */
  get inputs() {
    return this._inputs;
  }

  set inputs(values) {
    this._inputs = values;
    this._isStale = true;
    this.requestFrame();
  }

  /** The camera of the last frame. */
  get camera() {
    return this._camera ?? null;
  }

  play() {
    this._playback?.play();
    this._timeChanged();
  }

  pause() {
    this._playback?.pause();
    this._timeChanged();
  }

  /** Turn the camera towards a point of the world. @param {number[]} point */
  lookAt(point) {
    this._orbit?.focus(point);
    this._moved();
  }

  /** Return the picture as a PNG. @param {string} [type] @returns {Promise<Blob>} */
  async toBlob(type = "image/png") {
    await this._draw(performance.now(), true);
    return new Promise((resolve, reject) => {
      this._view.canvas.toBlob((blob) => {
        if (blob) resolve(blob);
        else reject(new GsgenError("the picture cannot be encoded", { where: type }));
      }, type);
    });
  }

  /** Draw again before the next repaint. */
  requestFrame() {
    if (this._frameRequest || !this._model || !this._isVisible) return;
    this._frameRequest = requestAnimationFrame((now) => {
      this._frameRequest = 0;
      this._draw(now).catch((error) => this._model && this._fail(error));
    });
  }

  // ----- Loading

  _see(isVisible) {
    this._isVisible = isVisible;
    if (isVisible && !this._loading) this._load();
    this.requestFrame();
  }

  /** Show a file that was dropped on an element with the attribute `file-drop`. */
  _drop(event) {
    const file = event.dataTransfer?.files[0];
    if (!file || !this.hasAttribute("file-drop")) return;
    event.preventDefault();
    this.setAttribute("name", file.name);
    this.setAttribute("src", URL.createObjectURL(file));
  }

  _release() {
    cancelAnimationFrame(this._frameRequest);
    this._frameRequest = 0;
    this._loading?.abort();
    this._loading = null;
    this._listener?.destroy();
    this._listener = null;
    this._renderer?.destroy();
    this._presenter?.destroy();
    this._model?.destroy();
    this._renderer = this._presenter = this._model = this._playback = this._orbit = null;
  }

  async _load() {
    const source = this.getAttribute("src");
    this._release();
    if (!source) return;
    const loading = new AbortController();
    this._loading = loading;
    this._view.showError(null);
    try {
      await this._open(source, loading.signal);
    } catch (error) {
      if (!loading.signal.aborted) this._fail(error);
    }
  }

  async _open(source, signal) {
    const started = sharedKernels();
    const data = download(
      source,
      (loaded, total) => {
        this._view.showProgress(loaded, total);
        this._tell("progress", { loaded, total });
      },
      signal,
    );
    const [kernels, bytes] = await Promise.all([started, data]);
    await kernels.presenting; // so that no frame comes between the model and its camera
    signal.throwIfAborted();
    const name = this.getAttribute("name") ?? source;
    const number = (attribute) => parseFloat(this.getAttribute(attribute) ?? "") || undefined;
    const model = await openModel(kernels, bytes, name, {
      source,
      target: this.getAttribute("target") ?? undefined,
      maxError: number("max-error"),
      maxSplats: number("max-splats"),
      onChange: () => this.requestFrame(),
      onError: ({ message, hint }) => this._tell("error", { rule: "", where: name, message, hint }),
    });
    if (signal.aborted) return model.destroy();
    this._watch(kernels.device, signal);
    this._model = model;
    this._renderer = new Renderer(kernels, { onStale: () => this.requestFrame() });
    this._renderer.setScene(model.sets);
    this._presenter = new Presenter(kernels, this._view.canvas);
    await this._presenter.prepare();
    if (model.time) this._startTime(model.time);
    this._placeCamera();
    this._listen();
    this._isStale = true;
    await this._draw(performance.now());
    this._view.hideProgress();
    this._view.showPoster(null);
    this._view.say(`Loaded: ${this.getAttribute("alt") ?? name}`);
    this.report = { manifest: model.manifest ?? null, errors: [], findings: model.findings ?? [] };
    this._tell("load", { count: model.buffers.count });
    this.requestFrame();
  }

  /** Open everything again if the device goes away, as browsers allow after a driver's fault. */
  _watch(device, signal) {
    device.lost.then(({ message, reason }) => {
      if (signal.aborted) return;
      this._losses += 1;
      if (this._losses <= MOST_LOSSES) this._load();
      else this._fail(new GsgenError(`the graphics device was lost: ${message || reason}`));
    });
  }

  _fail(error) {
    this._view.hideProgress();
    this._view.showError(error);
    const { rule = "", where = "", hint = "", message, findings = [] } = error;
    this.report = { manifest: null, errors: [{ rule, where, message, hint }], findings };
    this._tell("error", { rule, where, message, hint });
    if (!(error instanceof GsgenError)) throw error;
  }

  _tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  // ----- Time

  _loops() {
    return this.hasAttribute("loop") || Boolean(this._model?.time?.loop);
  }

  _startTime(time) {
    const playback = new Playback(time);
    this._playback = playback;
    playback.loop = this._loops();
    if (this.hasAttribute("time")) playback.value = Number(this.getAttribute("time"));
    const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (this.hasAttribute("autoplay") && !isStill) playback.play();
    this._view.showTime(playback);
  }

  _timeChanged() {
    this._isStale = true;
    this._view.showTime(this._playback ?? null);
    this._tell("timeupdate", { currentTime: this.currentTime });
    this.requestFrame();
  }

  // ----- Camera

  _placeCamera() {
    if (!this._model) return;
    const orbit = (this.getAttribute("camera-orbit") ?? "").trim().split(/[\s,]+/).map(parseFloat);
    const [azimuth, elevation, radius] = orbit.map((x) => (Number.isFinite(x) ? x : undefined));
    const fovY = parseFloat(this.getAttribute("field-of-view") ?? "") || undefined;
    const axis = /^([+-]?)([xyz])$/.exec(this.getAttribute("up") ?? "");
    const up = axis
      ? ["x", "y", "z"].map((name) => (name === axis[2] ? (axis[1] === "-" ? -1 : 1) : 0))
      : this._model.up;
    this._orbit = new OrbitCamera(this._model.extent, up, { azimuth, elevation, radius, fovY });
    this.requestFrame();
  }

  _listen() {
    this._listener?.destroy();
    this._listener = null;
    if (!this._model || !this.hasAttribute("camera-controls")) return;
    this._listener = new ControlListener(this._view.canvas, () => this._orbit ?? null, {
      onMove: () => this._moved(),
      onFocus: (x, y) => this._focusAt(x, y).catch((error) => this._fail(error)),
    });
  }

  _moved() {
    this.requestFrame();
    this._tell("camera-change", {});
  }

  /** Turn to the surface at a place of the canvas, in CSS pixels. */
  async _focusAt(x, y) {
    const { _renderer: renderer, _camera: camera } = this;
    if (!renderer || !camera) return;
    const { clientWidth, clientHeight } = this._view.canvas;
    const [across, down] = [(x * camera.width) / clientWidth, (y * camera.height) / clientHeight];
    await renderer.draw(camera, { outputs: ["depth"] });
    const image = await renderer.readImage("depth");
    const pixel = 4 * (Math.floor(down) * camera.width + Math.floor(across));
    const median = image[pixel + 1];
    if (median > 0) this._orbit?.focus(unproject(camera, across, down, median));
    this._moved();
  }

  // ----- Frames

  async _draw(now, isWhole = false) {
    const { canvas } = this._view;
    const scale = Math.min(devicePixelRatio, MOST_PIXELS_PER_CSS);
    const [width, height] = [this.clientWidth, this.clientHeight].map((x) => Math.round(x * scale));
    if (!this._model || !this._orbit || !width || !height) return;
    if (this._isDrawing) {
      this._isMissed = true;
      return;
    }
    this._isDrawing = true;
    try {
      if (canvas.width !== width) canvas.width = width;
      if (canvas.height !== height) canvas.height = height;
      await this._drawFrame(this._orbit.camera(width, height), now, isWhole);
    } finally {
      this._isDrawing = false;
    }
    if (this._isMissed || (this._playback && !this._playback.paused)) this.requestFrame();
    this._isMissed = false;
  }

  async _drawFrame(camera, now, isWhole) {
    const { _model: model, _playback: playback, _renderer: renderer } = this;
    if (playback?.advance(now)) this._timeChanged();
    if (this._isStale || model.followsCamera) {
      const time = playback && model.time ? { [model.time.name]: timeValue(model, playback) } : {};
      if (await model.update({ ...time, ...this._inputs }, camera)) renderer.setScene(model.sets);
      if (this._model !== model) return; // removed or replaced meanwhile
      this._isStale = false;
    }
    const mode = this.getAttribute("mode") ?? "color";
    const output = mode === "normal" ? "normal" : mode === "color" ? "color" : "depth";
    const options = { outputs: [output], background: colorOf(this.getAttribute("background") ?? "0 0 0") };
    if (isWhole) await renderer.drawWhole(camera, options);
    else await renderer.draw(camera, options);
    if (this._model !== model) return;
    this._camera = camera;
    const { distance, extent } = this._orbit;
    this._presenter.show(renderer.host.image(output), camera, {
      mode,
      depths: [Math.max(distance - extent.reach, 0), distance + extent.reach],
      isLinear: model.buffers.isLinear,
    });
  }
}
