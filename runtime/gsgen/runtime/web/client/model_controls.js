/** The properties and methods by which a page plays, sets and turns the model of an element. */

import { AttributedElement } from "./attributed_element.js";
import { computedColor } from "./attributes.js";
import { ControlListener } from "./controls.js";
import { ElementView } from "./element_view.js";
import { GsgenError } from "./errors.js";
import { unknownInputs } from "./key_frames.js";
import { OrbitCamera, orbitProblem } from "./orbit_camera.js";
import { candidatesOf } from "./source_files.js";
import { written } from "./words.js";

/** @typedef {import("./shown_model.js").ShownModel} ShownModel */

const MOST_PIXELS_PER_CSS = 2;
const REST = 3000; // milliseconds from a visitor's turn until the camera turns by itself again

const wantsRest = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

/** An element with at most one model; its subclass loads and draws it. */
export class ModelControls extends AttributedElement {
  constructor() {
    super();
    this._view = new ElementView(this.attachShadow({ mode: "open" }));
    /** @type {ShownModel | null} */
    this._shown = null;
    /** @type {{file: any, orbit: OrbitCamera, playback: any, camera: any} | null} Of a model that comes back. */
    this._kept = null;
    /** What is set before there is a model. @type {{time?: number, plays?: boolean, orbit?: any}} */
    this._wish = {};
    this._rate = 1;
    this._wasPaused = true;
    this._turned = { byVisitor: -Infinity, last: 0 };
    this._renewReady();
    this.inputs = {};
  }

  /** Return what may be shown, the best first. */
  _candidates() {
    return candidatesOf(this);
  }

  /** Draw a frame before the next repaint, where there is a model in view. */
  _requestFrame() {}

  /** Load the model, if that has to be done yet. */
  _loadIfPending() {}

  /** A promise of the model of `src`: resolved when it is shown, rejected if it cannot be. */
  get ready() {
    return this._ready.promise;
  }

  _renewReady() {
    /** @type {PromiseWithResolvers<this> & {isSettled?: boolean}} */
    this._ready = Promise.withResolvers();
    this._ready.promise.catch(() => {}); // the event `error` tells it, too
  }

  _settleReady(error = null) {
    if (this._ready.isSettled) this._renewReady();
    this._ready.isSettled = true;
    if (error) this._ready.reject(error);
    else this._ready.resolve(this);
  }

  _tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
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
    for (const { name, hint } of this._shown ? unknownInputs(this._inputs, this._shown.inputs) : []) {
      this._complain(`inputs.${name}`, `is no input of the model. ${hint}`);
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
    const target = point.length === 3 ? point : undefined;
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
   * @returns {Promise<{point: number[], normal: number[] | null, model: HTMLElement} | null>}
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
}
