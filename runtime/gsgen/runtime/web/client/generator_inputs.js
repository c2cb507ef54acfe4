/** The inputs of a generator: GPU buffers, and the conversion of values to their bytes. */

import { eyeOf } from "./camera.js";
import { GsgenError } from "./errors.js";
import { storageBuffer } from "./gpu_buffers.js";
import { transposed4 } from "./matrices.js";

const CAMERA_MATRICES = ["view", "projection"];
const MATRICES = [...CAMERA_MATRICES, "image_view"];
const FAR_RATIO = 1e5; // of the far plane's distance to the near plane's
const ARRAYS = { float32: Float32Array, int32: Int32Array }; // the types that rules allow

/** Return the matrix camera → clip that generators receive, 4×4 row by row. */
export function projectionOf({ fx, fy, cx, cy, width, height, near }) {
  const far = FAR_RATIO * near;
  return [
    (2 * fx) / width, 0, (2 * cx) / width - 1, 0,
    0, (-2 * fy) / height, 1 - (2 * cy) / height, 0,
    0, 0, far / (far - near), (-near * far) / (far - near),
    0, 0, 1, 0,
  ];
}

/** Return the default of an input, as the contract defines it for the input's role. */
function defaultOf(spec, shape) {
  const size = shape.reduce((a, b) => a * b, 1);
  const fallback = CAMERA_MATRICES.includes(spec.role) ? "identity" : (spec.range?.[0] ?? 0);
  const value = spec.default ?? fallback;
  if (value === "zeros") return new Array(size).fill(0);
  if (value === "identity") return identityOf(spec.role, shape, size);
  return Array.isArray(value) ? value : new Array(size).fill(value);
}

function identityOf(role, shape, size) {
  const numbers = new Array(size).fill(0);
  const [rows, columns] = [shape[shape.length - 2], shape[shape.length - 1]];
  if (role !== "pose" && shape.length > 1 && rows === columns) {
    for (let i = 0; i < size; i++) numbers[i] = Number(i % (rows * columns) % (columns + 1) === 0);
  } else if (columns === 4) {
    for (let i = 0; i < size; i += 4) numbers[i] = 1; // quaternions w, x, y, z
  }
  return numbers;
}

/** Return 4×4 matrices one after the other, each transposed. */
function transposedMatrices(numbers) {
  const starts = Array.from({ length: numbers.length / 16 }, (_, i) => 16 * i);
  return starts.flatMap((start) => transposed4([...numbers.slice(start, start + 16)]));
}

/** The input tensors of a session, in buffers that stay: a captured graph reads the same ones. */
export class GeneratorInputs {
  constructor(device, ort, session, manifest) {
    this._device = device;
    this._isTransposed = (manifest.space?.matrix_order ?? "column") === "column";
    const declared = new Map(manifest.inputs.map((spec) => [spec.name, spec]));
    /** @type {Map<string, {spec: any, type: string, size: number, buffer: GPUBuffer, last: string}>} */
    this._inputs = new Map();
    this.feeds = {};
    for (const { name, type, shape } of session.inputMetadata) {
      const spec = declared.get(name) ?? { name, role: "" };
      const dims = shape.map(Number);
      const size = dims.reduce((a, b) => a * b, 1);
      const buffer = storageBuffer(device, `input ${name}`, 4 * size);
      this._inputs.set(name, { spec, type, size, buffer, last: "" });
      this.feeds[name] = ort.Tensor.fromGpuBuffer(buffer, { dataType: type, dims });
      this._write(name, defaultOf(spec, dims));
    }
  }

  /** Whether an input depends on the camera. */
  get followsCamera() {
    const roles = [...CAMERA_MATRICES, "camera_position", "viewport"];
    return [...this._inputs.values()].some(({ spec }) => roles.includes(spec.role));
  }

  /**
   * Write the values of a frame; return whether any input changed.
   * @param {Record<string, any>} values By name or role.
   * @param {import("./camera.js").Camera} camera
   */
  update(values, camera) {
    const [projection, viewport] = [projectionOf(camera), [camera.width, camera.height]];
    const known = { view: camera.view, projection, camera_position: eyeOf(camera), viewport };
    let isChanged = false;
    for (const [name, { spec }] of this._inputs) {
      const value = values[name] ?? values[spec.role] ?? known[spec.role];
      if (value !== undefined) isChanged = this.write(name, value) || isChanged;
    }
    return isChanged;
  }

  /** Write the value of an input; return whether it changed. */
  write(name, value) {
    return this._write(name, ArrayBuffer.isView(value) ? value : [value].flat(Infinity));
  }

  /** Return the shape of an input. */
  shape(name) {
    return this.feeds[name].dims;
  }

  _write(name, numbers) {
    const input = this._inputs.get(name);
    const { spec, type, size } = input;
    if (numbers.length !== size || !numbers.every(Number.isFinite)) {
      throw new GsgenError(`is [${numbers.slice(0, 6)}], expected ${size} finite numbers`, {
        where: `input ${name}`,
      });
    }
    const [low, high] = spec.range ?? [-Infinity, Infinity];
    if (spec.role === "time" && numbers.some((number) => number < low || number > high)) {
      throw new GsgenError(`is ${numbers}, expected ${low} to ${high}`, { where: `input ${name}` });
    }
    const isMatrix = MATRICES.includes(spec.role) && this._isTransposed;
    const ordered = isMatrix ? transposedMatrices(numbers) : numbers;
    const key = ordered.join();
    if (key === input.last) return false;
    input.last = key;
    const array = ARRAYS[type].from(ordered);
    const bytes = new Uint8Array(Math.ceil(array.byteLength / 4) * 4);
    bytes.set(new Uint8Array(array.buffer));
    this._device.queue.writeBuffer(input.buffer, 0, bytes);
    return true;
  }

  /** Release the buffers. */
  destroy() {
    for (const { buffer } of this._inputs.values()) buffer.destroy();
  }
}
