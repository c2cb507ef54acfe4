/** Gaussians in GPU memory: pages of rows and appearance, as frame plans bind them. */

import { failing } from "./errors.js";
import { storageBuffer } from "./gpu_buffers.js";

const ROW_BYTES = 40; // x y z opacity xx xy xz yy yz zz

/** Return the SH degree of an appearance; null for RGB. */
export function degreeOf(channels, space) {
  return space === "rgb" ? null : Math.sqrt(channels / 3) - 1;
}

/** Return how the appearance of `channels` numbers of a dtype is stored. */
export function appearanceKind(plans, channels, dtype) {
  const isWideEnough = (entry) => entry.dtype === dtype && entry.channels >= channels;
  const fail = failing("appearance", "Drop harmonics above degree 3.");
  return plans.appearances.find(isWideEnough) ?? fail(`has ${channels} channels; at most 48 can be drawn`);
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

/** Gaussians in GPU memory, whose rows may arrive one after the other. */
export class SplatBuffers {
  /**
   * @param {GPUDevice} device
   * @param {{count: number, channels: number, space: "sh" | "rgb", antialias?: "classic" | "mip",
   *     colorSpace?: "srgb" | "linear"}} facts The count is that of all rows there will be.
   */
  constructor(device, plans, facts, dtype = "float32") {
    const { count, channels, space, antialias, colorSpace } = facts;
    const storage = appearanceKind(plans, channels, dtype);
    this.count = 0; // rows that are there
    this.capacity = count;
    this.degree = degreeOf(channels, space);
    this.antialias = antialias ?? "classic";
    this.isLinear = colorSpace === "linear";
    /** @type {GPUBuffer | null} Live rows of each page, where only the GPU knows them. */
    this.liveCounts = null;
    this._rows = storageBuffer(device, "rows", ROW_BYTES * count);
    this._appearance = storageBuffer(device, "appearance", storage.bytes * count);
    this.pages = pagesOf(plans, storage, this._rows, this._appearance, count);
    this._device = device;
    this._bytes = storage.bytes;
    this.stride = storage.bytes / (dtype === "float16" ? 2 : 4); // numbers of appearance per row
  }

  /**
   * Write rows from one on.
   * @param {Float32Array | null} rows
   * @param {Float32Array | Uint16Array | null} appearance Filled up to whole vectors of four numbers.
   */
  write(first, rows, appearance) {
    const { queue } = this._device;
    const copy = (buffer, offset, { buffer: bytes, byteOffset, byteLength }) => {
      queue.writeBuffer(buffer, offset, bytes, byteOffset, byteLength);
    };
    if (rows) copy(this._rows, ROW_BYTES * first, rows);
    if (appearance) copy(this._appearance, this._bytes * first, appearance);
  }

  /** Release the buffers. */
  destroy() {
    this._rows.destroy();
    this._appearance.destroy();
  }
}

/** Return rows of numbers, each filled up with zeros to a length. */
export function paddedRows(numbers, channels, length) {
  if (channels === length) return numbers;
  const count = numbers.length / channels;
  const Numbers = /** @type {any} */ (numbers.constructor);
  const padded = new Numbers(count * length);
  for (let row = 0; row < count; row++) {
    padded.set(numbers.subarray(row * channels, (row + 1) * channels), row * length);
  }
  return padded;
}
