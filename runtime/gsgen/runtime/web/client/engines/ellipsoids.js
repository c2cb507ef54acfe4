/** Gaussians as other engines store them: a rotation, three standard deviations and a colour each. */

import { GsgenError } from "../errors.js";
import { writeColor } from "../harmonics.js";
import { linearPart, placeRow, plus, relativeStretch, solve } from "../matrices.js";

/**
 * Four numbers of each Gaussian.
 * @typedef {object} Target
 * @property {Float32Array} centers x y z, and one number that stays.
 * @property {Float32Array} scales Standard deviations along the axes, and one number that stays.
 * @property {Float32Array} rotations Quaternions x y z w.
 * @property {Float32Array} colors sRGB and opacity; of rows that are not drawn, opacity 0.
 */
/** @typedef {Pick<import("../frames.js").Frames, "capacity" | "channels" | "space" | "colorSpace" | "transform">} Format */

const SMALL = 1e-9; // beside the largest variance
const MOST_TURNS = 36;

/** Converts frames of a model to ellipsoids in the world of its transform. */
export class Ellipsoids {
  /** @param {Format} format Of the frames. */
  constructor({ capacity, channels, space, colorSpace, transform }) {
    this.capacity = capacity;
    this._channels = channels;
    this._degree = space === "sh" ? Math.min(Math.sqrt(channels / 3) - 1, 3) : null;
    this._isLinear = colorSpace === "linear";
    /** Whether colours depend on the camera: frames are filled again when it moves. */
    this.needsCamera = !!this._degree;
    this._transform = transform;
    this._toHarmonics = relativeStretch(linearPart(transform));
    /** What the stored colours are of: the appearance, whether an eye, how many rows. */
    this._colored = { appearance: /** @type {Float32Array | null} */ (null), hasEye: false, live: 0 };
    /** Bounding box of three standard deviations. */
    this.low = [0, 0, 0];
    this.high = [0, 0, 0];
  }

  /** Return arrays for frames, in which nothing is drawn. @returns {Target} */
  target() {
    const [centers, scales, rotations, colors] = [0, 1, 2, 3].map(() => new Float32Array(4 * this.capacity));
    return { centers, scales, rotations, colors };
  }

  /**
   * Write a frame.
   * @param {import("../frames.js").Frame} frame
   * @param {Target} target The same arrays each time.
   * @param {readonly number[] | null} [eye] Where the camera is, in the world of the transform;
   *     without one, harmonics above degree 0 are left out.
   */
  write(frame, target, eye = null) {
    const { rows, live } = frame;
    const { centers, scales, rotations, colors } = target;
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let row = 0; row < this.capacity; row++) {
      const from = 10 * row, to = 4 * row;
      let sum = 0; // is finite where all numbers are, which are float32
      for (let number = 0; number < 10; number++) sum += rows[from + number];
      if (!(row < live && rows[from + 3] > 0 && Math.abs(sum) < Infinity)) {
        colors[to + 3] = 0;
        continue;
      }
      placeRow(this._transform, rows, from, placed, 0);
      colors[to + 3] = Math.min(placed[3], 1);
      for (let axis = 0, square = 4; axis < 3; square += 3 - axis++) {
        const center = (centers[to + axis] = placed[axis]);
        const reach = 3 * Math.sqrt(Math.max(placed[square], 0));
        if (center - reach < low[axis]) low[axis] = center - reach;
        if (center + reach > high[axis]) high[axis] = center + reach;
      }
      writeAxes(scales, rotations, to);
    }
    if (low[0] < Infinity) [this.low, this.high] = [low, high];
    this._color(frame, colors, eye);
  }

  /** Write colours, unless those that are stored are the frame's. */
  _color({ rows, appearance, live }, colors, eye) {
    const [degree, hasEye] = [eye ? this._degree : this._degree && 0, !!eye];
    const { _channels: channels, _colored: stored, _transform: m } = this;
    // Where directions count, they are of each row's place: other rows have other colours.
    if (!degree && stored.appearance === appearance && stored.hasEye === hasEye && live <= stored.live) return;
    const own = degree ? solve(linearPart(m), plus([...eye], -1, [m[3], m[7], m[11]])) : [0, 0, 0];
    for (let row = 0; row < live; row++) {
      const [from, to] = [channels * row, 4 * row];
      if (degree === null) for (let part = 0; part < 3; part++) colors[to + part] = appearance[from + part];
      else {
        const at = 10 * row;
        writeColor(this._toHarmonics, rows[at] - own[0], rows[at + 1] - own[1], rows[at + 2] - own[2], degree, appearance, from, colors, to);
      }
      for (let part = to; part < to + 3; part++) {
        colors[part] = colors[part] > 0 ? (this._isLinear ? encoded(colors[part]) : colors[part]) : 0;
      }
    }
    this._colored = { appearance, hasEye, live };
  }
}

/** Return an sRGB colour of linear light (IEC 61966-2-1). */
const encoded = (light) => (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);

const placed = new Float64Array(10); // a row in the world

/**
 * Write the axes of the ellipsoid in `placed`, which Jacobi's rotations find and a quaternion collects
 * (McAdams et al. 2011, "Computing the singular value decomposition of 3×3 matrices").
 */
function writeAxes(scales, rotations, to) {
  // The diagonal of the covariance, and opposite each of its numbers the product of the two other axes.
  let xx = placed[4], yy = placed[7], zz = placed[9], yz = placed[8], zx = placed[6], xy = placed[5];
  let x = 0, y = 0, z = 0, w = 1;
  const limit = SMALL * (xx + yy + zz);
  for (let turn = 0; turn < MOST_TURNS; turn++) {
    if (turn % 3 === 0 && Math.abs(yz) + Math.abs(zx) + Math.abs(xy) <= limit) break;
    if (yz !== 0) {
      // Turn y and z about x until their product is 0.
      const ratio = (zz - yy) / (2 * yz);
      const tangent = (ratio < 0 ? -1 : 1) / (Math.abs(ratio) + Math.sqrt(ratio * ratio + 1));
      const cosine = 1 / Math.sqrt(tangent * tangent + 1);
      const sine = tangent * cosine;
      yy -= tangent * yz;
      zz += tangent * yz;
      yz = 0;
      const first = xy;
      xy = cosine * first - sine * zx;
      zx = sine * first + cosine * zx;
      // The quaternion times that of the turn, −angle about the axis.
      const whole = Math.sqrt((1 + cosine) / 2);
      const part = -sine / (2 * whole);
      const along = x, across = y;
      x = whole * along + part * w;
      y = whole * across + part * z;
      z = whole * z - part * across;
      w = whole * w - part * along;
    }
    // The next axis is called x.
    const square = xx, product = yz, part = x;
    (xx = yy), (yy = zz), (zz = square);
    (yz = zx), (zx = xy), (xy = product);
    (x = y), (y = z), (z = part);
  }
  scales[to] = Math.sqrt(Math.max(xx, 0));
  scales[to + 1] = Math.sqrt(Math.max(yy, 0));
  scales[to + 2] = Math.sqrt(Math.max(zz, 0));
  rotations[to] = x;
  rotations[to + 1] = y;
  rotations[to + 2] = z;
  rotations[to + 3] = w;
}

/**
 * Refuse an engine that lacks what an adapter calls.
 * @param {string} name Of its package.
 * @param {string} version Which is installed.
 * @param {string} first The first that has the calls.
 * @param {boolean} hasCalls
 * @throws {GsgenError}
 */
export function requireCalls(name, version, first, hasCalls) {
  if (!hasCalls) throw new GsgenError(`${name} is ${version}, expected ${first} or later`, { hint: `Install ${name}@${first}.` });
}
