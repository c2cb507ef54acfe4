/** Gaussians in GPU memory: pages of rows and appearance, as frame plans bind them. */

import { GsgenError } from "./errors.js";
import { storageBuffer } from "./gpu_buffers.js";

/**
 * Gaussians in the contract's packed rows.
 * @typedef {object} Splats
 * @property {Float32Array} rows x y z opacity xx xy xz yy yz zz, ten numbers each.
 * @property {Float32Array | Uint16Array} appearance SH or RGB; float16 as the bits of each number.
 * @property {number} channels Numbers of appearance per Gaussian.
 * @property {"sh" | "rgb"} space
 * @property {number} count Number of live rows, which are the first.
 * @property {"classic" | "mip"} [antialias]
 * @property {"srgb" | "linear"} [colorSpace]
 * @property {readonly number[]} transform From the axes of the rows to those of a camera.
 */

const ROW_BYTES = 40;

/** Return the SH degree of an appearance; null for RGB. */
export function degreeOf(channels, space) {
  return space === "rgb" ? null : Math.sqrt(channels / 3) - 1;
}

/** Return how the appearance of `channels` numbers of a dtype is stored. */
export function appearanceKind(plans, channels, dtype) {
  const isWideEnough = (entry) => entry.dtype === dtype && entry.channels >= channels;
  const found = plans.appearances.find(isWideEnough);
  if (!found) {
    throw new GsgenError(`has ${channels} channels; at most 48 can be drawn`, {
      where: "appearance",
      hint: "Drop harmonics above degree 3.",
    });
  }
  return found;
}

/** Cut rows in GPU buffers into pages. @returns {import("./host.js").Page[]} */
export function pagesOf(plans, storage, rows, appearance, capacity) {
  const pages = [];
  for (let first = 0; first < capacity; first += plans.constants.PAGE_ROWS) {
    pages.push({
      kind: storage.kind,
      capacity: Math.min(plans.constants.PAGE_ROWS, capacity - first),
      rows,
      rowsOffset: first * ROW_BYTES,
      appearance,
      appearanceOffset: first * storage.bytes,
      firstRow: first,
    });
  }
  return pages;
}

/** Gaussians of a file in GPU memory. */
export class SplatBuffers {
  /** @param {GPUDevice} device @param {Splats} splats */
  constructor(device, plans, splats) {
    const { rows, appearance, channels, space, count } = splats;
    const isHalf = appearance instanceof Uint16Array;
    const storage = appearanceKind(plans, channels, isHalf ? "float16" : "float32");
    this.count = count;
    this.capacity = rows.length / 10;
    this.degree = degreeOf(channels, space);
    this.antialias = splats.antialias ?? "classic";
    this.isLinear = splats.colorSpace === "linear";
    /** @type {GPUBuffer | null} Live rows of each page, where only the GPU knows them. */
    this.liveCounts = null;
    this._rows = storageBuffer(device, "rows", ROW_BYTES * this.capacity);
    this._appearance = storageBuffer(device, "appearance", storage.bytes * this.capacity);
    this.pages = pagesOf(plans, storage, this._rows, this._appearance, this.capacity);
    this._device = device;
    this._length = storage.bytes / appearance.BYTES_PER_ELEMENT;
    this.write(rows, appearance, channels);
  }

  /** Write the first rows. */
  write(rows, appearance, channels) {
    const padded = paddedRows(appearance, channels, this._length);
    for (const [buffer, array] of [[this._rows, rows], [this._appearance, padded]]) {
      this._device.queue.writeBuffer(buffer, 0, array.buffer, array.byteOffset, array.byteLength);
    }
  }

  /** Release the buffers. */
  destroy() {
    this._rows.destroy();
    this._appearance.destroy();
  }
}

/** Return rows of numbers, each filled up with zeros to a length. */
function paddedRows(numbers, channels, length) {
  if (channels === length) return numbers;
  const count = numbers.length / channels;
  const Numbers = /** @type {any} */ (numbers.constructor);
  const padded = new Numbers(count * length);
  for (let row = 0; row < count; row++) {
    padded.set(numbers.subarray(row * channels, (row + 1) * channels), row * length);
  }
  return padded;
}
