/** Gaussians as other engines store them: a rotation, three standard deviations and a colour each. */

import { harmonics } from "../harmonics.js";
import { linearPart, normalized, plus, relativeStretch, solve, times } from "../matrices.js";

/**
 * Four numbers of each Gaussian.
 * @typedef {object} Target
 * @property {Float32Array} centers x y z, and one number that stays.
 * @property {Float32Array} scales Standard deviations along the axes, and one number that stays.
 * @property {Float32Array} rotations Quaternions x y z w.
 * @property {Float32Array} colors Red, green, blue, opacity; of rows that are not drawn, opacity 0.
 */
/** @typedef {Pick<import("../frames.js").Frames, "capacity" | "channels" | "space" | "transform">} Format */

const SMALL = 1e-10; // beside the largest variance
const MOST_SWEEPS = 12;

/** Converts frames of a model to ellipsoids in the world of its transform. */
export class Ellipsoids {
  /** @param {Format} format Of the frames. */
  constructor({ capacity, channels, space, transform }) {
    this.capacity = capacity;
    this._channels = channels;
    this._degree = space === "sh" ? Math.min(Math.sqrt(channels / 3) - 1, 3) : null;
    /** Whether colours depend on the camera: frames are filled again when it moves. */
    this.needsCamera = !!this._degree;
    this._transform = transform;
    this._toHarmonics = relativeStretch(linearPart(transform));
    /** What the stored colours are of: the appearance, the eye, how many rows. */
    this._colored = { appearance: /** @type {Float32Array | null} */ (null), eye: "", live: 0 };
    /** Bounding box of three standard deviations. */
    this.low = [0, 0, 0];
    this.high = [0, 0, 0];
  }

  /**
   * Write a frame.
   * @param {import("../frames.js").Frame} frame
   * @param {Target} target The same arrays each time.
   * @param {readonly number[] | null} [eye] Where the camera is, in the world of the transform;
   *     without one, harmonics above degree 0 are left out.
   */
  write({ rows, appearance, live }, target, eye = null) {
    const { centers, scales, rotations, colors } = target;
    const [a, b, c, x0, d, e, f, y0, g, h, i, z0] = this._transform;
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    let drawn = 0;
    for (let row = 0; row < this.capacity; row++) {
      const [from, to] = [10 * row, 4 * row];
      let isDrawn = row < live && rows[from + 3] > 0;
      for (let number = 0; isDrawn && number < 10; number++) isDrawn = Math.abs(rows[from + number]) < Infinity;
      if (!isDrawn) {
        colors[to + 3] = 0;
        continue;
      }
      drawn += 1;
      const [x, y, z] = [rows[from], rows[from + 1], rows[from + 2]];
      centers[to] = a * x + b * y + c * z + x0;
      centers[to + 1] = d * x + e * y + f * z + y0;
      centers[to + 2] = g * x + h * y + i * z + z0;
      colors[to + 3] = Math.min(rows[from + 3], 1);
      // The covariance A Σ Aᵀ, whose axes are the ellipsoid's.
      const [xx, xy, xz, yy, yz, zz] = [rows[from + 4], rows[from + 5], rows[from + 6], rows[from + 7], rows[from + 8], rows[from + 9]];
      const [p, q, r] = [a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz];
      const [s, t, u] = [d * xx + e * xy + f * xz, d * xy + e * yy + f * yz, d * xz + e * yz + f * zz];
      const [v, w, k] = [g * xx + h * xy + i * xz, g * xy + h * yy + i * yz, g * xz + h * yz + i * zz];
      squares[0] = p * a + q * b + r * c;
      squares[1] = s * d + t * e + u * f;
      squares[2] = v * g + w * h + k * i;
      [products[0], products[1], products[2]] = [s * g + t * h + u * i, p * g + q * h + r * i, p * d + q * e + r * f];
      for (let axis = 0; axis < 3; axis++) {
        const reach = 3 * Math.sqrt(Math.max(squares[axis], 0));
        low[axis] = Math.min(low[axis], centers[to + axis] - reach);
        high[axis] = Math.max(high[axis], centers[to + axis] + reach);
      }
      diagonalize();
      for (let axis = 0; axis < 3; axis++) scales[to + axis] = Math.sqrt(Math.max(squares[axis], 0));
      rotations.set(turn, to);
    }
    if (drawn) [this.low, this.high] = [low, high];
    this._color({ rows, appearance, live }, colors, eye);
  }

  /** Write colours, unless those that are stored are the frame's. */
  _color({ rows, appearance, live }, colors, eye) {
    const degree = eye ? this._degree : this._degree && 0;
    const local = degree ? solve(linearPart(this._transform), [0, 1, 2].map((axis) => eye[axis] - this._transform[4 * axis + 3])) : [0, 0, 0];
    // Where directions count, they are of each row's place: other rows have other colours.
    const isStored = !degree && this._colored.appearance === appearance && this._colored.eye === `${degree}` && live <= this._colored.live;
    if (isStored) return;
    const { _channels: channels } = this;
    const count = degree === null ? 1 : (degree + 1) ** 2;
    for (let row = 0; row < live; row++) {
      const [from, to] = [channels * row, 4 * row];
      let weights = RGB;
      if (degree !== null) {
        const offset = degree ? plus([rows[10 * row], rows[10 * row + 1], rows[10 * row + 2]], -1, local) : UP;
        weights = harmonics(normalized(times(this._toHarmonics, offset)));
      }
      for (let part = 0; part < 3; part++) {
        let sum = degree === null ? 0 : 0.5;
        for (let index = 0; index < count; index++) sum += weights[index] * appearance[from + 3 * index + part];
        colors[to + part] = sum > 0 ? sum : 0;
      }
    }
    this._colored = { appearance, eye: `${degree}`, live };
  }
}

const [RGB, UP] = [new Float64Array([1]), [0, 0, 1]];
const squares = new Float64Array(3); // the diagonal of a covariance
const products = new Float64Array(3); // its other numbers: that of y and z, of x and z, of x and y
const turn = new Float64Array(4);

/**
 * Find the axes of a covariance by Jacobi's rotations, which a quaternion collects (McAdams et al.
 * 2011, "Computing the singular value decomposition of 3×3 matrices").
 */
function diagonalize() {
  turn.fill(0);
  turn[3] = 1;
  const limit = SMALL * (squares[0] + squares[1] + squares[2]);
  for (let sweep = 0; sweep < MOST_SWEEPS; sweep++) {
    if (Math.abs(products[0]) + Math.abs(products[1]) + Math.abs(products[2]) <= limit) break;
    for (let axis = 0; axis < 3; axis++) {
      const product = products[axis];
      if (product === 0) continue;
      // Turn the two other axes until their product is 0.
      const [p, q] = [(axis + 1) % 3, (axis + 2) % 3];
      const ratio = (squares[q] - squares[p]) / (2 * product);
      const tangent = (ratio < 0 ? -1 : 1) / (Math.abs(ratio) + Math.sqrt(ratio * ratio + 1));
      const cosine = 1 / Math.sqrt(tangent * tangent + 1);
      const sine = tangent * cosine;
      squares[p] -= tangent * product;
      squares[q] += tangent * product;
      const [first, second] = [products[q], products[p]];
      products[axis] = 0;
      products[q] = cosine * first - sine * second;
      products[p] = sine * first + cosine * second;
      // The quaternion times that of the turn, −angle about the axis.
      const whole = Math.sqrt((1 + cosine) / 2);
      const part = -sine / (2 * whole);
      const [along, across, beside, real] = [turn[axis], turn[p], turn[q], turn[3]];
      turn[axis] = whole * along + part * real;
      turn[p] = whole * across + part * beside;
      turn[q] = whole * beside - part * across;
      turn[3] = whole * real - part * along;
    }
  }
}
