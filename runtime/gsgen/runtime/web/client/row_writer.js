/** Turns the numbers of splat files into the contract's packed rows, batch by batch. */

import { failing } from "./errors.js";
import { extentOf } from "./framing.js";
import { IDENTITY } from "./matrices.js";

export const MOST_COEFFICIENTS = 16; // degree 3: the page draws no more
export const SH_C0 = 0.5 / Math.sqrt(Math.PI);
const BATCH_ROWS = 1 << 14;
const FEWEST_BATCH_ROWS = 256;
const BATCHES = 16; // of a small file, whose first rows are drawn before the others arrive
const SAMPLED_ROWS = 1 << 14; // of a part that is not whole, by which it is framed
const LARGEST_LOG_SCALE = 88; // whose exponential is a float32

const { fround } = Math;

/** Logits and constant harmonics of bytes, of which Python rounds the first and the last to float32 before. */
export const BYTE_LOGITS = Float32Array.from({ length: 256 }, (_, byte) => logit(fround(byte / 255)));
export const SHARE_LOGITS = Float32Array.from({ length: 256 }, (_, byte) => logit(byte / 255));
export const BYTE_COLORS = Float32Array.from({ length: 256 }, (_, byte) => constantTerm(fround(byte / 255)));

export function logit(opacity) {
  return fround(Math.log(opacity) - Math.log1p(-opacity));
}

/** Return the harmonic of degree 0 of a colour from 0 to 1. */
export function constantTerm(color) {
  return fround(fround(color - 0.5) / fround(SH_C0));
}

/** A unit quaternion w, x, y, z, which functions of this module fill. */
export const turn = new Float32Array(4);

/** Normalise a quaternion; one of zeros is the identity, or stays. */
export function setUnit(w, x, y, z, ofZeros = 1) {
  const most = Math.max(Math.abs(w), Math.abs(x), Math.abs(y), Math.abs(z), Number.MIN_VALUE);
  const a = w / most, b = x / most, c = y / most, d = z / most;
  const length = Math.sqrt(a * a + b * b + c * c + d * d);
  const divisor = Math.max(length, 0.5);
  turn[0] = length > 0 ? a / divisor : ofZeros;
  turn[1] = b / divisor;
  turn[2] = c / divisor;
  turn[3] = d / divisor;
}

const parts = new Float32Array(4);

/** Set a unit quaternion from three of its parts, and the index of the fourth in w, x, y, z. */
export function setFromLargest(index, a, b, c) {
  parts[index] = Math.sqrt(Math.max(1 - (a * a + b * b + c * c), 0));
  parts[index > 0 ? 0 : 1] = a;
  parts[index > 1 ? 1 : 2] = b;
  parts[index > 2 ? 2 : 3] = c;
  setUnit(parts[0], parts[1], parts[2], parts[3]);
}

/**
 * What takes the parts of a file: sets of rows with one transform each.
 * @typedef {object} Sink
 * @property {(facts: PartFacts) => number} begin Announces a part, and returns its number.
 * @property {(part: number, first: number, rows: Float32Array | null, appearance: Float32Array) =>
 *     Promise<void> | void} write Takes rows from one on; without rows, their appearance alone.
 * @property {(part: number, extent: import("./framing.js").Extent) => void} grow Tells how far the
 *     rows so far extend, each time they have doubled.
 * @property {(part: number, count: number, extent: import("./framing.js").Extent) => void} end
 */
/**
 * @typedef {object} PartFacts
 * @property {number} count Rows at most.
 * @property {number} channels Numbers of appearance per row.
 * @property {"sh" | "rgb"} space
 * @property {"classic" | "mip"} antialias
 * @property {"srgb" | "linear"} colorSpace
 * @property {readonly number[]} transform From the axes of the rows to those of a camera.
 * @property {readonly number[] | null} up What the file declares.
 */

/** Collects the rows of a part, leaves out those that cannot be drawn, and sends the others. */
export class RowWriter {
  /**
   * @param {Sink} sink
   * @param {string} name Of the file, for messages.
   * @param {{count: number, coefficients?: number, space?: "sh" | "rgb", antialias?: boolean,
   *     isLinear?: boolean, transform?: readonly number[], up?: readonly number[] | null}} facts
   */
  constructor(sink, name, facts) {
    const { count, coefficients = 1, space = "sh", antialias = false, isLinear = false } = facts;
    this.name = name;
    this.count = count;
    this.channels = 3 * Math.min(coefficients, MOST_COEFFICIENTS);
    this.stride = 4 * Math.ceil(this.channels / 4); // rows of appearance in GPU memory
    const share = FEWEST_BATCH_ROWS * Math.ceil(count / BATCHES / FEWEST_BATCH_ROWS);
    this.batch = Math.min(BATCH_ROWS, share || FEWEST_BATCH_ROWS);
    this._sink = sink;
    this._part = sink.begin({
      count, space, channels: this.channels,
      antialias: antialias ? "mip" : "classic",
      colorSpace: isLinear ? "linear" : "srgb",
      transform: facts.transform ?? IDENTITY,
      up: facts.up ?? null,
    });
    this._placed = new Float32Array(10 * count); // what framing looks at
    this._told = 0; // rows when their extent was last told
    this.sent = 0;
    this._renew();
  }

  _renew() {
    this.rows = new Float32Array(10 * this.batch);
    this.appearance = new Float32Array(this.stride * this.batch);
    this.used = 0;
  }

  /** Yield the first row and the number of rows of each batch, which is sent afterwards. */
  async *batches(count = this.count) {
    for (let first = 0; first < count; first += this.batch) {
      yield [first, Math.min(this.batch, count - first)];
      await this.flush();
    }
  }

  /**
   * Write a row from the parameters of a splat, as 3DGS trains them; the covariance is R S Sᵀ Rᵀ
   * (Kerbl et al. 2023, equation 6). The caller writes its appearance, and then keeps the row.
   * @returns {number} Where its appearance begins.
   */
  place(x, y, z, w, i, j, k, logScale0, logScale1, logScale2, logitOpacity) {
    w = fround(w), i = fround(i), j = fround(j), k = fround(k);
    logScale0 = fround(logScale0), logScale1 = fround(logScale1), logScale2 = fround(logScale2);
    const norm = Math.sqrt(w * w + i * i + j * j + k * k);
    const isScale = logScale0 <= LARGEST_LOG_SCALE && logScale1 <= LARGEST_LOG_SCALE && logScale2 <= LARGEST_LOG_SCALE;
    this.isValid =
      isScale && norm > 0 && norm < Infinity && logitOpacity === logitOpacity &&
      Number.isFinite(fround(x) + fround(y) + fround(z));
    w /= norm, i /= norm, j /= norm, k /= norm;
    const a = Math.exp(logScale0), b = Math.exp(logScale1), c = Math.exp(logScale2);
    const m0 = (1 - 2 * (j * j + k * k)) * a, m1 = 2 * (i * j - w * k) * b, m2 = 2 * (i * k + w * j) * c;
    const m3 = 2 * (i * j + w * k) * a, m4 = (1 - 2 * (i * i + k * k)) * b, m5 = 2 * (j * k - w * i) * c;
    const m6 = 2 * (i * k - w * j) * a, m7 = 2 * (j * k + w * i) * b, m8 = (1 - 2 * (i * i + j * j)) * c;
    const { rows } = this;
    const first = 10 * this.used;
    rows[first] = x;
    rows[first + 1] = y;
    rows[first + 2] = z;
    rows[first + 3] = 1 / (1 + Math.exp(-fround(logitOpacity)));
    rows[first + 4] = m0 * m0 + m1 * m1 + m2 * m2;
    rows[first + 5] = m0 * m3 + m1 * m4 + m2 * m5;
    rows[first + 6] = m0 * m6 + m1 * m7 + m2 * m8;
    rows[first + 7] = m3 * m3 + m4 * m4 + m5 * m5;
    rows[first + 8] = m3 * m6 + m4 * m7 + m5 * m8;
    rows[first + 9] = m6 * m6 + m7 * m7 + m8 * m8;
    return this.stride * this.used;
  }

  /** Keep the row that was placed, unless it cannot be drawn; return its number, or −1. */
  keep() {
    let sum = 0;
    const first = this.stride * this.used;
    for (let i = 0; i < this.channels; i++) sum += this.appearance[first + i];
    if (!this.isValid || !Number.isFinite(sum)) {
      this.appearance.fill(0, first, first + this.channels);
      return -1;
    }
    this.used += 1;
    return this.sent + this.used - 1;
  }

  /** Send the rows that were kept. */
  async flush() {
    const { rows, appearance, used, sent } = this;
    if (!used) return;
    const own = rows.subarray(0, 10 * used);
    this._placed.set(own, 10 * sent);
    this.sent += used;
    this._renew();
    await this._sink.write(this._part, sent, own, appearance.subarray(0, this.stride * used));
    if (this.sent < 2 * this._told || this.sent === this.count) return;
    this._told = this.sent;
    this._sink.grow(this._part, extentOf(this._sample()));
  }

  /** Return some of the rows that were sent. */
  _sample() {
    const step = Math.ceil(this.sent / SAMPLED_ROWS);
    const count = Math.floor(this.sent / step);
    if (step === 1) return { rows: this._placed, count };
    const rows = new Float32Array(10 * count);
    for (let row = 0; row < count; row++) rows.set(this._placed.subarray(10 * step * row, 10 * step * row + 10), 10 * row);
    return { rows, count };
  }

  /** Send the appearance of rows that were sent before. */
  async repeat(first, appearance) {
    await this._sink.write(this._part, first, null, appearance);
  }

  /** Say that all rows were sent. */
  end() {
    if (!this.sent) failing(this.name, "Is it the right file?")("has no row that can be drawn");
    this._sink.end(this._part, this.sent, extentOf({ rows: this._placed, count: this.sent }));
  }
}
