/** Cameras that visitors move: orbit, pan, zoom and fly, by mouse, touch and keys. */

import { DEFAULT_NEAR, turnTowards, viewOf } from "./camera.js";
import { cross, dot, normalized, plus, product, rotation, times, transposed } from "./matrices.js";

const RADIANS = Math.PI / 180;
const POLE = RADIANS; // least angle between the view and straight up or down
const TURN = 0.3 * RADIANS; // per dragged pixel
const STEP = 6 * RADIANS; // per pressed arrow
const WHEEL = 0.0012; // logarithm of the distance per wheel unit; a notch is 100
const SPEED = 0.5; // reaches per second
const FAST = 4; // factor of the speed with shift
const MIN_DISTANCE = 1e-4; // reaches between the camera and the pivot
const NEAR_SHARE = 0.01; // distance of the near plane, relative to that of the pivot

/** @type {Record<string, number[]>} Direction of each flying key: right, down and forward. */
const FLIGHT = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0],
  KeyD: [1, 0, 0], KeyQ: [0, 1, 0], KeyE: [0, -1, 0],
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/** A camera that turns about a pivot in front of it. */
export class OrbitCamera {
  /**
   * @param {{center: number[], reach: number}} extent Centre and half diagonal of the scene.
   * @param {readonly number[]} up
   * @param {{azimuth?: number, elevation?: number, radius?: number | null, fovY?: number}} [home]
   *     Angles are in degrees.
   */
  constructor(extent, up, { azimuth = 30, elevation = 20, radius = null, fovY = 50 } = {}) {
    this.up = normalized([...up]);
    this.extent = extent;
    this.home = { azimuth, elevation, radius };
    this.fovY = fovY;
    this.reset();
  }

  /** Return to the first position and direction. */
  reset() {
    const { azimuth, elevation, radius } = this.home;
    const sizes = this.up.map(Math.abs);
    const axis = [0, 1, 2].map((i) => Number(i === sizes.indexOf(Math.min(...sizes))));
    const side = normalized(cross(this.up, axis));
    const front = cross(side, this.up);
    const [turn, lift] = [azimuth * RADIANS, elevation * RADIANS];
    const level = plus(front.map((x) => x * Math.cos(turn)), Math.sin(turn), side);
    const offset = plus(level.map((x) => x * Math.cos(lift)), Math.sin(lift), this.up);
    this.turn = turnTowards(offset.map((x) => -x), this.up);
    this.pivot = [...this.extent.center];
    this._fitted = radius === null;
    this.distance = radius ?? this.extent.reach;
  }

  /** The camera centre, in world units. */
  get eye() {
    return plus(this.pivot, -this.distance, this.turn.slice(6));
  }

  /** Return the camera of an image. @returns {import("./camera.js").Camera} */
  camera(width, height) {
    if (this._fitted) {
      const narrow = this.fovY * Math.min(1, width / height);
      this.distance = this.extent.reach / Math.sin((narrow * RADIANS) / 2);
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
  }
}

/** Moves a camera by the pointers and keys of an element. */
export class ControlListener {
  /**
   * @param {HTMLElement} target
   * @param {() => OrbitCamera | null} camera
   * @param {{onMove: () => void, onFocus?: (x: number, y: number) => void}} callbacks
   */
  constructor(target, camera, { onMove, onFocus = () => {} }) {
    this._target = target;
    this._camera = camera;
    this._onMove = onMove;
    /** @type {Map<number, PointerEvent>} */
    this._pointers = new Map();
    this._held = new Set();
    this._flying = 0;
    this._stop = new AbortController();
    const { signal } = this._stop;
    const listen = (name, handle) => {
      target.addEventListener(name, handle, { signal, passive: false });
    };
    listen("pointerdown", (event) => this._press(event));
    listen("pointermove", (event) => this._drag(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      listen(name, (event) => this._pointers.delete(event.pointerId));
    }
    listen("wheel", (event) => this._wheel(event));
    listen("keydown", (event) => this._key(event));
    listen("keyup", (event) => this._held.delete(event.code));
    listen("blur", () => this._held.clear());
    listen("contextmenu", (event) => event.preventDefault());
    listen("dblclick", (event) => onFocus(event.offsetX, event.offsetY));
  }

  /** Stop listening. */
  destroy() {
    this._stop.abort();
    this._held.clear();
  }

  _press(event) {
    this._target.setPointerCapture(event.pointerId);
    this._pointers.set(event.pointerId, event);
  }

  _drag(event) {
    const last = this._pointers.get(event.pointerId);
    const camera = this._camera();
    if (!last || !camera) return;
    const [right, down] = [event.clientX - last.clientX, event.clientY - last.clientY];
    const height = this._target.clientHeight;
    const others = [...this._pointers.values()].filter((other) => other !== last);
    this._pointers.set(event.pointerId, event);
    if (others.length) {
      const span = (from) => Math.hypot(from.clientX - others[0].clientX, from.clientY - others[0].clientY);
      camera.zoom(span(last) / Math.max(span(event), 1));
      camera.pan(right / 2, down / 2, height);
    } else if (event.shiftKey || event.buttons & 6) {
      camera.pan(right, down, height);
    } else if (event.altKey) {
      camera.look(right * TURN, down * TURN);
    } else {
      camera.orbit(right * TURN, down * TURN);
    }
    this._onMove();
  }

  /** Zoom by the wheel; until the element has the focus, the wheel scrolls the page. */
  _wheel(event) {
    const camera = this._camera();
    if (!camera || !this._target.matches(":focus, :focus-within")) return;
    event.preventDefault();
    const unit = event.deltaMode === 1 ? 33 : 1;
    camera.zoom(Math.exp(clamp(event.deltaY * unit * WHEEL, -5, 5)));
    this._onMove();
  }

  _key(event) {
    const camera = this._camera();
    if (!camera || event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.code];
    if (arrow && event.shiftKey) camera.pan(-20 * arrow[0], 20 * arrow[1], this._target.clientHeight);
    else if (arrow) camera.orbit(-arrow[0] * STEP, arrow[1] * STEP);
    else if (event.key === "+" || event.key === "=") camera.zoom(1 / 1.2);
    else if (event.key === "-") camera.zoom(1.2);
    else if (event.code === "Home" || event.code === "KeyR") camera.reset();
    else if (event.code in FLIGHT) return this._startFlight(event);
    else return;
    event.preventDefault();
    this._onMove();
  }

  _startFlight(event) {
    event.preventDefault();
    this._isFast = event.shiftKey;
    this._held.add(event.code);
    if (!this._flying) this._flying = requestAnimationFrame((now) => this._fly(now, now));
  }

  _fly(before, now) {
    const camera = this._camera();
    const keys = [...this._held].map((code) => FLIGHT[code]);
    const direction = [0, 1, 2].map((i) => keys.reduce((sum, key) => sum + key[i], 0));
    this._flying = 0;
    if (!keys.length || !camera) return;
    if (direction.some(Boolean)) {
      camera.fly(direction, Math.min((now - before) / 1000, 0.1), this._isFast);
      this._onMove();
    }
    this._flying = requestAnimationFrame((next) => this._fly(now, next));
  }
}
