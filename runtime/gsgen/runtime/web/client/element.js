/** The element `<gsgen-model>`: shows a splat file or a generator in a page. */

import { Annotations } from "./annotations.js";
import { AttributedElement } from "./attributed_element.js";
import { computedColor } from "./attributes.js";
import { sharedBackend } from "./backend.js";
import { ControlListener } from "./controls.js";
import { ElementView } from "./element_view.js";
import { GsgenError } from "./errors.js";
import { OrbitCamera, orbitProblem } from "./orbit_camera.js";
import { candidatesOf, canShow, sourceFile } from "./source_files.js";
import { nearestWord, written } from "./words.js";

/** @typedef {"empty" | "loading" | "ready" | "failed"} State */
/** @typedef {import("./shown_model.js").ShownModel} ShownModel */

const MOST_PIXELS_PER_CSS = 2;
const MINUTE = 60_000; // milliseconds
const MOST_LOSSES = 6; // of the device within a minute, after which the element gives up
const LOSS_DELAY = 100; // milliseconds from an error of a lost device to the news of its loss
const MOST_FAILED_FRAMES = 3; // one after the other, of a time that plays
const REST = 3000; // milliseconds from a visitor's turn until the camera turns by itself again
const NEW_HOME = ["camera-orbit", "camera-target", "up"];
const NEW_LENS = ["min-camera-orbit", "max-camera-orbit", "field-of-view"];

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));
const wantsRest = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

export class GsgenModel extends AttributedElement {
  /** Return whether a `<source>` of a MIME type is tried. @param {string} type */
  static canShow(type) {
    return canShow(type);
  }

  constructor() {
    super();
    this._view = new ElementView(this.attachShadow({ mode: "open" }));
    this._internals = this.attachInternals();
    /** @type {State} */
    this._state = "empty";
    /** What was found out about the model: its errors, or its manifest. @type {any} */
    this.report = null;
    /** @type {ShownModel | null} */
    this._shown = null;
    /** @type {import("./present.js").Presenter | null} */
    this._presenter = null;
    /** @type {import("./source_files.js").SourceFile | null} Kept, so that it is not loaded again. */
    this._file = null;
    /** @type {string[]} The addresses that the last load tried. */
    this._tried = [];
    this._isPending = true; // until it is in view
    this._loading = new AbortController();
    /** @type {{file: any, orbit: OrbitCamera, playback: any, camera: any} | null} Of a model that comes back. */
    this._kept = null;
    this._isBack = false; // after a loss
    /** @type {number[]} Moments at which the device was lost. */
    this._losses = [];
    this._failedFrames = 0;
    this._frameRequest = 0;
    this._isVisible = false;
    this._isDrawing = false;
    this._isMissed = false;
    /** What is set before there is a model. @type {{time?: number, plays?: boolean, orbit?: any}} */
    this._wish = {};
    this._rate = 1;
    this._wasPaused = true;
    /** @type {(Blob | string)[] | null} */
    this._pictures = null;
    this._turned = { byVisitor: -Infinity, last: 0 };
    this._renewReady();
    this.inputs = {};
    this._view.play.addEventListener("click", () => (this.paused ? this.play() : this.pause()));
    this._view.time.addEventListener("input", () => {
      // The slider shows the present time again when the model pauses.
      const share = Number(this._view.time.value) / 1000;
      this.pause();
      this.currentTime = share * this.duration;
    });
    this._view.poster.addEventListener("error", () => this._complain("poster", `"${this.poster}" cannot be shown`));
    this.addEventListener("dragover", (event) => this.fileDrop && event.preventDefault());
    this.addEventListener("drop", (event) => this._drop(event));
    this._resizes = new ResizeObserver(() => this._requestFrame());
    this._visibility = new IntersectionObserver(([entry]) => this._see(entry.isIntersecting));
    this._annotations = new Annotations(this, this._view.annotations, {
      onChange: () => this._childrenChanged(),
      complain: (where, problem) => this._complain(where, problem),
    });
  }

  connectedCallback() {
    super.connectedCallback();
    this._describe();
    this._view.showPoster(this._shown ? null : this.poster);
    this._resizes.observe(this);
    this._visibility.observe(this);
    this._annotations.observe();
    if (!this._shown) this._isPending = true;
    if (this.loading === "eager") this._loadIfPending();
    this._requestFrame();
  }

  disconnectedCallback() {
    // An element that moves is connected again at once, and keeps its model.
    queueMicrotask(() => {
      if (this.isConnected) return;
      this._resizes.disconnect();
      this._visibility.disconnect();
      this._annotations.disconnect();
      this._loading.abort();
      this._release();
      this._enter("empty");
    });
  }

  /** A document takes no style from another one. */
  adoptedCallback() {
    this._view.adopt();
  }

  attributeChangedCallback(name, before, now) {
    super.attributeChangedCallback(name, before, now);
    if (!this.isConnected || before === now) return;
    const { _playback: playback, _shown: shown } = this;
    if (name === "src" || name === "images") this._sourceChanged();
    else if (name === "alt" || name === "camera-controls") this._describe();
    else if (name === "poster" && !shown) this._view.showPoster(this.poster);
    else if (name === "loading" && this.loading === "eager") this._loadIfPending();
    else if (shown && NEW_HOME.includes(name)) shown.orbit = this._firstOrbit(shown.model);
    else if (shown && NEW_LENS.includes(name)) shown.orbit = this._firstOrbit(shown.model).following(shown.orbit);
    else if (playback && name === "loop") playback.loop = this._loops(playback);
    else if (playback && name === "time" && this.time !== null) {
      playback.value = this.time;
      this._timeChanged();
    }
    this._requestFrame();
  }

  // ----- State

  /** `empty`, `loading`, `ready` or `failed`; for CSS, too: `:state(failed)`. */
  get state() {
    return this._state;
  }

  /** A promise of the model of `src`: resolved when it is shown, rejected if it cannot be. */
  get ready() {
    return this._ready.promise;
  }

  /** Whether nothing remains to be loaded. */
  get complete() {
    return !this._candidates().length || this._state === "ready" || this._state === "failed";
  }

  /** The address that is shown: that of `src`, or of a `<source>`. */
  get currentSrc() {
    return this._file?.address ?? "";
  }

  _renewReady() {
    /** @type {PromiseWithResolvers<GsgenModel> & {isSettled?: boolean}} */
    this._ready = Promise.withResolvers();
    this._ready.promise.catch(() => {}); // the event `error` tells it, too
  }

  _settleReady(error = null) {
    if (this._ready.isSettled) this._renewReady();
    this._ready.isSettled = true;
    if (error) this._ready.reject(error);
    else this._ready.resolve(this);
  }

  /** @param {State} state */
  _enter(state) {
    if (state === this._state) return;
    this._state = state;
    this._internals.states.clear();
    this._internals.states.add(state);
    this._tell("statechange", { state });
  }

  _tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  /** Tell an error, and show it in place of the model. */
  _fail(error) {
    const { rule = "", where = "", hint = "", message, findings = [] } = error;
    this._view.hideProgress();
    this._view.showError(error);
    this.report = { manifest: null, errors: [{ rule, where, message, hint }], findings };
    this._enter("failed");
    this._tell("error", { rule, where, message, hint });
    this._settleReady(error);
    if (!(error instanceof GsgenError)) reportError(error);
  }

  // ----- Time

  get _playback() {
    return this._shown?.playback ?? this._kept?.playback ?? null;
  }

  /** Seconds since the start of the model's time. @returns {number} */
  get currentTime() {
    return this._playback?.currentTime ?? this._wish.time ?? 0;
  }

  /** @param {number} seconds */
  set currentTime(seconds) {
    if (!this._isNumber("currentTime", seconds)) return;
    if (this._playback) this._playback.currentTime = seconds;
    else this._wish.time = seconds;
    this._timeChanged();
  }

  get duration() {
    return this._playback?.duration ?? 0;
  }

  get paused() {
    return this._playback?.paused ?? !this._wish.plays;
  }

  get ended() {
    return Boolean(this._playback?.paused && this._playback.ended);
  }

  /** How fast time passes: 1 is as the model says, and below 0 it goes back. @returns {number} */
  get playbackRate() {
    return this._rate;
  }

  /** @param {number} rate */
  set playbackRate(rate) {
    if (!this._isNumber("playbackRate", rate)) return;
    this._rate = rate;
    if (this._playback) this._playback.rate = rate;
    this._tell("ratechange", {});
  }

  /** Play the model's time, also before it is loaded. @returns {Promise<void>} Resolved when it plays. */
  play() {
    this._wish.plays = true;
    this._playback?.play();
    if (this._shown && !this._playback) this._complain("play()", "does nothing: the model has no time");
    this._timeChanged();
    const playing = this.ready.then(() => {});
    playing.catch(() => {}); // the event `error` tells it, too
    return playing;
  }

  pause() {
    this._wish.plays = false;
    this._playback?.pause();
    this._timeChanged();
  }

  _isNumber(where, value) {
    const isNumber = Number.isFinite(value);
    if (!isNumber) this._complain(where, `is ${written(value)}, expected a finite number`);
    return isNumber;
  }

  _loops(playback) {
    return this.loop || playback.loopsByItself;
  }

  _startTime(playback) {
    const { time, plays = this.autoplay && !wantsRest() } = this._wish;
    playback.loop = this._loops(playback);
    playback.rate = this._rate;
    if (this.time !== null) playback.value = this.time;
    if (time !== undefined) playback.currentTime = time;
    if (plays) playback.play();
    this._wish = { orbit: this._wish.orbit };
  }

  _timeChanged() {
    const { _playback: playback, _shown: shown } = this;
    this._view.showTime(playback);
    if (!playback) return;
    if (shown) shown.isStale = true;
    shown?.followTime();
    this._tell("timeupdate", { currentTime: playback.currentTime });
    if (playback.paused !== this._wasPaused) {
      this._wasPaused = playback.paused;
      this._tell(playback.paused ? "pause" : "play", {});
      if (this.ended) this._tell("ended", {});
    }
    this._requestFrame();
  }

  // ----- Inputs

  /** Values of the model's inputs by name; they replace those of the time and the camera. */
  get inputs() {
    return this._inputs;
  }

  set inputs(values) {
    const isObject = typeof values === "object" && values !== null && !Array.isArray(values);
    if (!isObject) this._complain("inputs", `is ${written(values)}, expected values by name`);
    const changed = (isDone) => {
      this._checkInputs();
      this.requestFrame();
      return isDone;
    };
    /** @type {Record<string, any>} */
    this._inputs = new Proxy(isObject ? values : {}, {
      set: (target, name, value) => changed(Reflect.set(target, name, value)),
      deleteProperty: (target, name) => changed(Reflect.deleteProperty(target, name)),
    });
    changed(true);
  }

  /** Tell which inputs the model lacks. */
  _checkInputs() {
    if (!this._shown) return;
    const { inputs } = this._shown.model;
    const known = inputs.flatMap(({ name, role }) => [name, role]).filter(Boolean);
    const names = inputs.map(({ name }) => name).join(", ");
    for (const name of Object.keys(this._inputs)) {
      if (known.includes(name)) continue;
      const nearest = nearestWord(name, known);
      const hint = nearest ? `is ${nearest} meant?` : names ? `it has ${names}` : "it has none";
      this._complain(`inputs.${name}`, `is no input of the model; ${hint}`);
    }
  }

  /** Draw again before the next repaint, with the present values of the inputs. */
  requestFrame() {
    if (this._shown) this._shown.isStale = true;
    this._requestFrame();
  }

  // ----- Camera

  /** The camera of the last frame; one that is set has a `view`, world → camera. */
  get camera() {
    return this._shown?.camera ?? this._kept?.camera ?? null;
  }

  set camera(camera) {
    const { view, fy, height } = camera ?? {};
    const fieldOfView = fy && height ? (360 / Math.PI) * Math.atan(height / (2 * fy)) : undefined;
    this.orbit = /** @type {any} */ ({ view, fieldOfView });
  }

  /**
   * Azimuth, elevation, fieldOfView (degrees), radius and target of the camera; of those that are
   * set, what is absent stays.
   * @returns {import("./orbit_camera.js").Orbit | null}
   */
  get orbit() {
    return (this._shown ?? this._kept)?.orbit.orbitState ?? null;
  }

  set orbit(orbit) {
    const problem = orbitProblem(orbit);
    const camera = (this._shown ?? this._kept)?.orbit;
    if (problem) this._complain(problem.where, problem.message);
    else if (camera) camera.move(/** @type {any} */ (orbit));
    else this._wish.orbit = { ...this._wish.orbit, ...orbit };
    this._moved();
  }

  /** Turn the camera towards a point of the world. @param {number[]} point */
  lookAt(point) {
    const problem = orbitProblem({ target: point });
    if (problem) return this._complain("lookAt()", `got ${written(point)}, expected a point [x, y, z]`);
    this._shown?.orbit.focus(point);
    this._moved();
  }

  /** Return to the first camera. */
  resetCamera() {
    this._shown?.orbit.reset();
    this._moved();
  }

  /** Return the camera of the attributes, or of a scene. @param {import("./model.js").Model} model */
  _firstOrbit({ extent, up, camera = {} }) {
    const [azimuth, elevation, radius] = this._valueOf("camera-orbit").map((part) => part ?? undefined);
    const point = this._valueOf("camera-target");
    const target = point.length === 3 ? point.map((part, axis) => part ?? extent.center[axis]) : undefined;
    const limits = ["min-camera-orbit", "max-camera-orbit"].map((name) => this._valueOf(name));
    const [, sign, letter] = /^([+-]?)([xyz])$/.exec(this.up) ?? [];
    const axis = letter ? ["x", "y", "z"].map((name) => Number(name === letter && `${sign}1`)) : up;
    const own = { azimuth, elevation, radius, target };
    const place = Object.values(own).some((part) => part !== undefined) ? own : camera;
    const given = this.hasAttribute("field-of-view") ? undefined : camera.fieldOfView;
    return new OrbitCamera(extent, axis, { ...place, fieldOfView: given ?? this.fieldOfView, limits });
  }

  _describe() {
    this._view.describe(this.alt, this.cameraControls);
    this._listener?.destroy();
    this._listener = null;
    if (!this.cameraControls) return;
    this._listener = new ControlListener(this._view.canvas, () => this._shown?.orbit ?? null, {
      onMove: () => {
        this._turned.byVisitor = performance.now();
        this._moved();
      },
      onFocus: async (x, y) => {
        const found = await this.pick(x, y);
        if (found) this.lookAt(found.point);
      },
    });
  }

  _moved() {
    this._requestFrame();
    this._tell("camera-change", {});
  }

  /** Turn the camera by itself, where the attribute `auto-rotate` asks for it. */
  _rotate(now) {
    const seconds = Math.min((now - this._turned.last) / 1000, 0.1);
    this._turned.last = now;
    if (!this.autoRotate || wantsRest()) return;
    const angle = (seconds * this.rotationPerSecond * Math.PI) / 180;
    if (now - this._turned.byVisitor > REST) this._shown?.orbit.orbit(angle, 0);
    this._requestFrame();
  }

  // ----- What is shown

  /**
   * Return what lies at a place of the element, in its CSS pixels; null where nothing is.
   * @returns {Promise<{point: number[], normal: number[] | null, model: GsgenModel} | null>}
   */
  async pick(x, y) {
    if (![x, y].every((part) => this._isNumber("pick(x, y)", part))) return null;
    const found = await this._shown?.pick(x / this.clientWidth, y / this.clientHeight);
    return found ? { ...found, model: this } : null;
  }

  /** Return the least and greatest coordinates of the model, without what floats far outside. */
  getBoundingBox() {
    return this._shown?.boundingBox ?? null;
  }

  /**
   * Return the picture, encoded.
   * @param {{width?: number, height?: number, type?: string, quality?: number} | string} [options]
   *     Pixels; as large as the element if absent. A text is the type.
   * @returns {Promise<Blob>}
   */
  async toBlob(options = {}) {
    const [ownWidth, ownHeight] = this._size();
    const given = typeof options === "string" ? { type: options } : options;
    const { width = ownWidth, height = ownHeight, type, quality } = given;
    if (!this.isConnected || !this._candidates().length) {
      throw new GsgenError("there is no model in this document", { where: "toBlob()" });
    }
    this._loadIfPending();
    await this.ready;
    const shown = /** @type {ShownModel} */ (this._shown);
    const most = shown.kernels.device.limits.maxTextureDimension2D;
    if (![width, height].every((side) => Number.isInteger(side) && side >= 1 && side <= most)) {
      throw new GsgenError(`is ${width}×${height}, expected whole numbers from 1 to ${most}`, { where: "toBlob()" });
    }
    return shown.picture(width, height, this._look(), { type, quality });
  }

  // ----- Loading

  /** Return what may be shown, the best first. */
  _candidates() {
    return candidatesOf(this);
  }

  _see(isVisible) {
    this._isVisible = isVisible;
    if (isVisible) this._loadIfPending();
    this._requestFrame();
  }

  /** Show a file that was dropped on an element with the attribute `file-drop`. */
  _drop(event) {
    const dropped = [...(event.dataTransfer?.files ?? [])];
    const [file] = dropped;
    if (!file || !this.fileDrop) return;
    event.preventDefault();
    if (dropped.every(({ type }) => type.startsWith("image/"))) {
      this.pictures = dropped;
      return;
    }
    this.name = file.name;
    const before = this.src;
    this.src = URL.createObjectURL(file);
    if (before.startsWith("blob:")) URL.revokeObjectURL(before);
  }

  /**
   * The pictures that a generator computes its Gaussians from: files, or those of `images`.
   * @returns {(Blob | string)[]}
   */
  get pictures() {
    return this._pictures ?? this._valueOf("images").map((source) => new URL(source, document.baseURI).href);
  }

  /** @param {(Blob | string)[] | null} sources Files or addresses; null for those of `images`. */
  set pictures(sources) {
    this._pictures = sources && [...sources];
    if (this.isConnected) this._sourceChanged();
  }

  _childrenChanged() {
    const sources = this._candidates().map(({ source }) => source);
    const isLonger = this._state === "failed" && sources.length > this._tried.length;
    if (sources[0] !== this._tried[0] || isLonger) this._sourceChanged();
    this._requestFrame();
  }

  _sourceChanged() {
    this._isPending = true;
    this._kept = null;
    this._loading.abort();
    if (this._ready.isSettled) this._renewReady();
    if (this._candidates().length) {
      if (this._isVisible || this._shown || this.loading === "eager") this._loadIfPending();
      return;
    }
    this._release();
    [this._file, this._kept, this._tried] = [null, null, []];
    this._view.showError(null);
    this._view.hideProgress();
    this._view.showPoster(this.poster);
    this._enter("empty");
  }

  _loadIfPending() {
    if (this._isPending && this.isConnected) this._load();
  }

  /** Release the model, but for its camera and time: it may come back. */
  _release() {
    cancelAnimationFrame(this._frameRequest);
    this._frameRequest = 0;
    if (this._shown) {
      const { file, orbit, playback, camera } = this._shown;
      this._kept = { file, orbit, playback, camera };
      this._shown.destroy();
    }
    this._presenter?.destroy();
    this._shown = this._presenter = null;
  }

  async _load() {
    const candidates = this._candidates();
    this._loading.abort();
    const { signal } = (this._loading = new AbortController());
    this._tried = candidates.map(({ source }) => source);
    this._isPending = !candidates.length;
    if (!candidates.length) {
      const types = [...this.querySelectorAll(":scope > source")].map((element) => element.getAttribute("type"));
      if (types.length) this._complain("source", `has no type that is shown: ${types.join(", ")}`);
      return;
    }
    if (this._ready.isSettled) this._renewReady();
    this._view.showError(null);
    this._enter("loading");
    for (const { source, element } of candidates) {
      try {
        return await this._open(source, signal);
      } catch (error) {
        await pause(LOSS_DELAY); // a loss of the device loads again
        if (signal.aborted) return;
        element?.dispatchEvent(new Event("error"));
        if (source !== candidates[candidates.length - 1].source) continue;
        this._release();
        this._fail(error);
      }
    }
  }

  async _open(source, signal) {
    const file = sourceFile(source);
    this._file = file;
    const progress = (loaded, total) => {
      this._view.showProgress(loaded, total);
      this._tell("progress", { loaded, total });
    };
    const [backend, bytes] = await Promise.all([sharedBackend(), file.bytes(progress, signal)]);
    signal.throwIfAborted();
    backend.lost.then((loss) => signal.aborted || this._lose(loss));
    const name = this.getAttribute("name") ?? source;
    const options = {
      source,
      target: this.target,
      pictures: this.pictures,
      maxError: this.maxError ?? undefined,
      maxSplats: this.maxSplats ?? undefined,
      onChange: () => this._requestFrame(),
      signal,
      onWarning: (where, problem) => this._complain(where, problem),
      onError: ({ message, hint }) => this._tell("error", { rule: "", where: name, message, hint }),
    };
    const shown = await backend.show(bytes, name, file, options);
    if (signal.aborted) return shown.destroy();
    this._prepare(shown);
    const [width, height] = this._size();
    // The last picture stays until this one is drawn.
    const failure = width && height ? await shown.draw(width, height, this._look(shown)).then(() => null, (error) => error) : null;
    if (failure) await pause(LOSS_DELAY);
    if (signal.aborted) return shown.destroy();
    this._shown?.destroy();
    [this._shown, this._kept, this._failedFrames] = [shown, null, 0];
    this._view.hideProgress();
    this._view.showPoster(null);
    this._view.say(`Loaded${backend.note}: ${this.getAttribute("alt") ?? name}`);
    this._timeChanged();
    this._checkInputs();
    if (failure) return this._fail(failure);
    this._present(this._look());
    this._succeed();
    this._requestFrame();
  }

  /** Give a model its camera and its time: its own of before, or those of the attributes. */
  _prepare(shown) {
    const kept = this._kept?.file === shown.file ? this._kept : null;
    if (kept) {
      [shown.orbit, shown.playback] = [kept.orbit, kept.playback];
      return;
    }
    shown.orbit = this._firstOrbit(shown.model);
    const { orbit } = this._wish;
    if (shown.playback) this._startTime(shown.playback);
    shown.followTime();
    if (orbit) shown.orbit.move(orbit);
    this._wish = {};
  }

  /** Tell that the model is shown, at first or again. */
  _succeed() {
    const { model, renderedBy } = /** @type {ShownModel} */ (this._shown);
    const isRecovery = this._isBack || this._state === "failed";
    this._isBack = false;
    this._view.showError(null);
    this.report = { manifest: model.manifest ?? null, errors: [], findings: model.findings ?? [], renderedBy };
    this._enter("ready");
    this._tell(isRecovery ? "recover" : "load", { count: model.buffers.count });
    this._settleReady();
  }

  /** Open everything again if the device goes away, as browsers allow after a driver's fault. */
  _lose({ message, reason }) {
    const now = performance.now();
    this._losses = [...this._losses.filter((moment) => now - moment < MINUTE), now];
    this._release();
    this._isBack = true;
    if (this._losses.length <= MOST_LOSSES) this._load();
    else {
      this._loading.abort();
      this._fail(new GsgenError(`the graphics device was lost: ${message || reason}`));
    }
  }

  // ----- Frames

  /** Return width and height of the picture, in pixels. */
  _size() {
    const scale = Math.min(devicePixelRatio, MOST_PIXELS_PER_CSS);
    return [this.clientWidth, this.clientHeight].map((side) => Math.round(side * scale));
  }

  /** @returns {import("./shown_model.js").Look} */
  _look(shown = this._shown) {
    const color = this._valueOf("background");
    const background = color ? computedColor(this._view.probe, color) : (shown?.model.background ?? [0, 0, 0, 1]);
    return { mode: this.mode, background, inputs: this._inputs };
  }

  _requestFrame() {
    if (this._frameRequest || !this._shown || !this._isVisible) return;
    this._frameRequest = requestAnimationFrame((now) => {
      this._frameRequest = 0;
      this._draw(now);
    });
  }

  async _draw(now) {
    const { _shown: shown } = this;
    const [width, height] = this._size();
    if (!shown || !width || !height) return;
    if (this._isDrawing) {
      this._isMissed = true;
      return;
    }
    this._isDrawing = true;
    try {
      if (shown.playback?.advance(now)) this._timeChanged();
      this._rotate(now);
      const look = this._look();
      await shown.draw(width, height, look);
      if (this._shown === shown) this._present(look);
    } catch (error) {
      await this._failFrame(error, shown);
    } finally {
      this._isDrawing = false;
    }
    const plays = shown.playback && !shown.playback.paused && this._failedFrames < MOST_FAILED_FRAMES;
    if (this._isMissed || plays) this._requestFrame();
    this._isMissed = false;
  }

  /** Show the last frame on the canvas. @param {import("./shown_model.js").Look} look */
  _present(look) {
    const { _shown: shown, _view: { canvas } } = this;
    if (!shown?.camera) return;
    const { camera } = shown;
    if (canvas.width !== camera.width) canvas.width = camera.width;
    if (canvas.height !== camera.height) canvas.height = camera.height;
    if (this._presenter?.device !== shown.kernels.device) {
      this._presenter?.destroy();
      this._presenter = shown.presenterOf(canvas);
    }
    shown.show(this._presenter, look);
    this._annotations.place(camera);
    if (this._failedFrames || this._state === "failed") this._succeed();
    this._failedFrames = 0;
  }

  /** Tell the error of a frame once; the next frame that is drawn takes it back. */
  async _failFrame(error, shown) {
    await pause(LOSS_DELAY);
    if (this._shown !== shown) return; // removed, replaced or lost meanwhile
    this._failedFrames += 1;
    const isKnown = this._state === "failed" && this.report?.errors[0]?.message === error.message;
    if (!isKnown) this._fail(error);
  }
}
