/** Cameras that turn about a point: orbit, pan, zoom and fly. */

import { DEFAULT_NEAR, eyeOf, turnTowards, viewOf } from "./camera.js";
import { cross, dot, linearPart, normalized, plus, product, rotation, times, transposed } from "./matrices.js";
import { written } from "./words.js";

const RADIANS = Math.PI / 180;
const POLE = RADIANS; // least angle between the view and straight up or down
const SPEED = 0.5; // reaches per second
const FAST = 4; // factor of the speed with shift
const MIN_DISTANCE = 1e-4; // reaches between the camera and the pivot
const NEAR_SHARE = 0.01; // distance of the near plane, relative to that of the pivot

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/**
 * Where a camera is, seen from the point that it looks at; angles are in degrees.
 * @typedef {object} Orbit
 * @property {number} azimuth About the upward axis.
 * @property {number} elevation Above the level of the point.
 * @property {number} radius Distance to the point.
 * @property {number[]} target The point.
 * @property {number} fieldOfView Vertical.
 */

/** A camera that turns about a pivot in front of it. */
export class OrbitCamera {
  /**
   * @param {{center: number[], reach: number}} extent Centre and half diagonal of the scene.
   * @param {readonly number[]} up
   * @param {Partial<Omit<Orbit, "target">> & {target?: (number | null)[], view?: number[],
   *     limits?: (number | null)[][]}} [home] What is absent shows the whole scene. `limits` are the least and most azimuth, elevation and radius.
   */
  constructor(extent, up, { fieldOfView = 50, limits = [], ...home } = {}) {
    this.up = normalized([...up]);
    this.extent = extent;
    this.home = home;
    this.fovY = fieldOfView;
    const [low, high] = [limits[0] ?? [], limits[1] ?? []];
    this._limits = [0, 1, 2].map((i) => [low[i] ?? -Infinity, high[i] ?? Infinity]);
    this.reset();
  }

  /** Return to the first position and direction. */
  reset() {
    const { azimuth = 30, elevation = 20, radius = null, target = [], view } = this.home;
    this._pivot = this.extent.center.map((middle, axis) => target[axis] ?? middle);
    this._isCentered = [0, 1, 2].map((axis) => (target[axis] ?? null) === null);
    this._fitted = radius === null;
    this.distance = radius ?? this.extent.reach;
    this._turnTo(azimuth, elevation);
    if (view) this.move({ view });
    this._limit();
  }

  /** The orbit of the camera; what is absent of one that is set stays. @returns {Orbit} */
  get orbitState() {
    const { azimuth, elevation } = this._angles();
    const [radius, fieldOfView] = [this.distance, this.fovY];
    return { azimuth, elevation, radius, target: [...this.pivot], fieldOfView };
  }

  /** @param {Partial<Orbit> & {view?: number[]}} orbit Or a matrix world → camera. */
  move({ azimuth, elevation, radius, target, fieldOfView, view }) {
    if (view) {
      this.turn = linearPart([...view]);
      [this.distance, this._fitted] = [radius ?? this.distance, false];
      this.pivot = plus(eyeOf(/** @type {any} */ ({ view })), this.distance, this.turn.slice(6));
    }
    const angles = this._angles();
    if (azimuth !== undefined || elevation !== undefined) {
      this._turnTo(azimuth ?? angles.azimuth, elevation ?? angles.elevation);
    }
    if (radius !== undefined) [this.distance, this._fitted] = [radius, false];
    if (target !== undefined) this.pivot = [...target];
    if (fieldOfView !== undefined) this.fovY = fieldOfView;
    this._limit();
  }

  /** Take another extent of the scene, whose middle the camera looks at unless it was moved. */
  fit(extent) {
    this.extent = extent;
    this._pivot = this._pivot.map((part, axis) => (this._isCentered[axis] ? extent.center[axis] : part));
  }

  /** The point that the camera looks at. */
  get pivot() {
    return this._pivot;
  }

  set pivot(point) {
    this._pivot = point;
    this._isCentered = [false, false, false];
  }

  /** Take the place of another camera, within the own limits. @param {OrbitCamera} other */
  following(other) {
    [this.turn, this.distance, this._fitted] = [other.turn, other.distance, other._fitted];
    [this._pivot, this._isCentered] = [other._pivot, other._isCentered];
    this._limit();
    return this;
  }

  /** Two level axes, from which azimuths are counted. */
  _level() {
    const sizes = this.up.map(Math.abs);
    const axis = [0, 1, 2].map((i) => Number(i === sizes.indexOf(Math.min(...sizes))));
    const side = normalized(cross(this.up, axis));
    return [cross(side, this.up), side];
  }

  _turnTo(azimuth, elevation) {
    const [front, side] = this._level();
    const [turn, lift] = [azimuth * RADIANS, clamp(elevation, -90, 90) * RADIANS];
    const level = plus(front.map((x) => x * Math.cos(turn)), Math.sin(turn), side);
    const offset = plus(level.map((x) => x * Math.cos(lift)), Math.sin(lift), this.up);
    this.turn = turnTowards(offset.map((x) => -x), this.up);
  }

  _angles() {
    const [front, side] = this._level();
    const back = this.turn.slice(6).map((x) => -x);
    const azimuth = Math.atan2(dot(back, side), dot(back, front)) / RADIANS;
    return { azimuth, elevation: Math.asin(clamp(dot(back, this.up), -1, 1)) / RADIANS };
  }

  /** Take the camera back into its limits. */
  _limit() {
    const [azimuths, elevations, radii] = this._limits;
    if (this.distance < radii[0] || this.distance > radii[1]) {
      [this.distance, this._fitted] = [clamp(this.distance, radii[0], radii[1]), false];
    }
    if (![...azimuths, ...elevations].some(Number.isFinite)) return;
    const { azimuth, elevation } = this._angles();
    // Of the angles that stand for one direction, the one nearest to the middle of the limits.
    const middle = azimuths.every(Number.isFinite) ? (azimuths[0] + azimuths[1]) / 2 : azimuth;
    const around = azimuth + 360 * Math.round((middle - azimuth) / 360);
    const target = [clamp(around, azimuths[0], azimuths[1]), clamp(elevation, elevations[0], elevations[1])];
    if (target[0] !== around || target[1] !== elevation) this._turnTo(target[0], target[1]);
  }

  /** The camera centre, in world units. */
  get eye() {
    return plus(this.pivot, -this.distance, this.turn.slice(6));
  }

  /** Return the camera of an image. @returns {import("./camera.js").Camera} */
  camera(width, height) {
    if (this._fitted) {
      const narrow = this.fovY * Math.min(1, width / height);
      const [, , radii] = this._limits;
      this.distance = clamp(this.extent.reach / Math.sin((narrow * RADIANS) / 2), radii[0], radii[1]);
    }
    const focal = height / 2 / Math.tan((this.fovY * RADIANS) / 2);
    return {
      view: viewOf(this.turn, this.eye),
      fx: focal,
      fy: focal,
      cx: width / 2,
      cy: height / 2,
      width,
      height,
      near: Math.min(DEFAULT_NEAR, NEAR_SHARE * this.distance),
      kind: "pinhole",
    };
  }

  /** Turn about the pivot by angles to the right and down. */
  orbit(around, over) {
    let turn = product(this.turn, rotation(this.up, around));
    const ahead = turn.slice(6);
    const angle = Math.acos(clamp(dot(ahead, this.up), -1, 1));
    const target = clamp(angle + over, Math.min(angle, POLE), Math.max(angle, Math.PI - POLE));
    turn = product(turn, rotation(turn.slice(0, 3), target - angle));
    // Rows are made orthogonal again, so that rounding errors of many drags do not add up.
    const forward = normalized(turn.slice(6));
    const right = normalized(plus(turn.slice(0, 3), -dot(turn, forward), forward));
    this.turn = [...right, ...cross(forward, right), ...forward];
    this._limit();
  }

  /** Turn in place by angles to the right and down. */
  look(around, over) {
    const { eye } = this;
    this._fitted = false;
    this.orbit(-around, -over);
    this.pivot = plus(eye, this.distance, this.turn.slice(6));
  }

  /** Move so that the pivot follows a drag in pixels of an image. */
  pan(right, down, height) {
    const scale = (2 * this.distance * Math.tan((this.fovY * RADIANS) / 2)) / height;
    const steps = [-right * scale, -down * scale, 0];
    this.pivot = plus(this.pivot, 1, times(transposed(this.turn), steps));
  }

  /** Multiply the distance to the pivot. */
  zoom(factor) {
    const { reach } = this.extent;
    this._fitted = false;
    this.distance = clamp(this.distance * factor, MIN_DISTANCE * reach, 1e4 * reach);
    this._limit();
  }

  /** Move in a direction (right, down, forward) for some seconds. */
  fly(direction, seconds, isFast) {
    const length = SPEED * this.extent.reach * seconds * (isFast ? FAST : 1);
    const steps = normalized(direction).map((part) => part * length);
    this._fitted = false;
    this.pivot = plus(this.pivot, 1, times(transposed(this.turn), steps));
  }

  /** Turn towards a point, which becomes the pivot. */
  focus(point) {
    const { eye } = this;
    const ahead = plus(point, -1, eye);
    const distance = Math.hypot(...ahead);
    if (!(distance > MIN_DISTANCE * this.extent.reach)) return;
    this._fitted = false;
    this.turn = turnTowards(ahead, this.up);
    [this.distance, this.pivot] = [distance, [...point]];
    this._limit();
  }
}

const isPoint = (value) => Array.isArray(value) && value.length === 3 && value.every(Number.isFinite);

/** What each part of an orbit that a page sets has to be. */
const PARTS = {
  azimuth: Number.isFinite,
  elevation: (value) => Math.abs(value) <= 90,
  radius: (value) => value > 0 && Number.isFinite(value),
  target: isPoint,
  fieldOfView: (value) => value >= 1 && value <= 170,
  view: (value) => value?.length === 16 && [...value].every(Number.isFinite),
};

/** Return what is wrong with an orbit that a page sets: where, and the problem; null if nothing is. */
export function orbitProblem(orbit) {
  const given = Object.keys(orbit ?? {}).filter((name) => name in PARTS && orbit[name] !== undefined);
  if (!given.length) return { where: "orbit", message: `has none of ${Object.keys(PARTS).join(", ")}` };
  const wrong = given.find((name) => !PARTS[name](orbit[name]));
  return wrong ? { where: `orbit.${wrong}`, message: `is ${written(orbit[wrong])}, which no camera has` } : null;
}
