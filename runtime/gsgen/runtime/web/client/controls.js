/** Moves cameras by mouse, touch and keys. */

const RADIANS = Math.PI / 180;
const TURN = 0.3 * RADIANS; // per dragged pixel
const STEP = 6 * RADIANS; // per pressed arrow
const WHEEL = 0.0012; // logarithm of the distance per wheel unit; a notch is 100
const SWIPE = 8; // pixels of a finger after which it is known where to it moves

/** @type {Record<string, number[]>} Direction of each flying key: right, down and forward. */
const FLIGHT = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0],
  KeyD: [1, 0, 0], KeyQ: [0, 1, 0], KeyE: [0, -1, 0],
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/** Moves a camera by the pointers and keys of an element. */
export class ControlListener {
  /**
   * @param {HTMLElement} target
   * @param {() => import("./orbit_camera.js").OrbitCamera | null} camera
   * @param {{onMove: () => void, onFocus?: (x: number, y: number) => void}} callbacks
   */
  constructor(target, camera, { onMove, onFocus = () => {} }) {
    this._target = target;
    this._camera = camera;
    this._onMove = onMove;
    /** @type {Map<number, PointerEvent>} */
    this._pointers = new Map();
    /** @type {PointerEvent | null} The finger of which it is not known yet whether it turns or scrolls. */
    this._swipe = null;
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
    this._swipe = event.pointerType === "touch" && !this._pointers.size ? event : null;
    this._pointers.set(event.pointerId, event);
  }

  /** Return whether a finger moves up or down, or not far yet: the page scrolls then, and nothing turns. */
  _scrolls(event) {
    const start = this._swipe;
    if (start?.pointerId !== event.pointerId) return false;
    const [right, down] = [event.clientX - start.clientX, event.clientY - start.clientY].map(Math.abs);
    if (right <= down || right < SWIPE) return true;
    this._swipe = null;
    this._pointers.set(event.pointerId, event);
    return true;
  }

  _drag(event) {
    const last = this._pointers.get(event.pointerId);
    const camera = this._camera();
    if (!last || !camera || this._scrolls(event)) return;
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
