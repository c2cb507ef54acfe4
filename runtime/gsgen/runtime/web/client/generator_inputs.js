/** The inputs of a generator: tensors, and the conversion of values to their numbers. */

import { eyeOf } from "./camera.js";
import { GsgenError } from "./errors.js";
import { extentInBackground } from "./file_reader.js";
import { mergedExtent } from "./framing.js";
import { storageBuffer } from "./gpu_buffers.js";
import { IDENTITY, transposed4 } from "./matrices.js";

const CAMERA_MATRICES = ["view", "projection"];
const MATRICES = [...CAMERA_MATRICES, "image_view"];
const FAR_RATIO = 1e5; // of the far plane's distance to the near plane's
const ARRAYS = { float32: Float32Array, int32: Int32Array }; // the types that rules allow
const SURVEYED = 4; // moments of the time that the camera is placed for
const FRAMES = 100; // of a time that declares none
const FRAMES_PER_SECOND = 25;

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

/** Return the values of a camera by role. */
function cameraValues(camera) {
  const viewport = [camera.width, camera.height];
  return { view: camera.view, projection: projectionOf(camera), camera_position: eyeOf(camera), viewport };
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

/** Return the time of a generator, or its frame number in place of one. @param {any[]} inputs */
export function timeOf(inputs) {
  const spec =
    inputs.find(({ role, range }) => role === "time" && range) ??
    inputs.find(({ role, range }) => role === "frame_index" && range);
  if (!spec) return null;
  const [low, high] = spec.range;
  const isNumber = spec.role === "frame_index";
  const frames = spec.frames ?? (isNumber ? high - low + 1 : FRAMES);
  const seconds = frames / (spec.fps ?? FRAMES_PER_SECOND);
  return { name: spec.name, low, high, seconds, loop: Boolean(spec.loop), isWhole: isNumber };
}

/** The camera of generators that follow one, before there is any. */
const SURVEY_CAMERA = { view: [...IDENTITY], fx: 1, fy: 1, cx: 0.5, cy: 0.5, width: 1, height: 1, near: 0.01 };

/**
 * Run some moments of a generator, and return a box around the Gaussians of all.
 * @param {any} model
 * @param {() => any} liveRows Returns the rows of the last moment, and how many there are.
 */
export async function surveyedExtent(model, liveRows) {
  const { time } = model;
  const boxes = [];
  for (let moment = 0; moment < (time ? SURVEYED : 1); moment++) {
    const values = time ? { [time.name]: time.low + ((time.high - time.low) * moment) / SURVEYED } : {};
    await model.update(values, SURVEY_CAMERA);
    boxes.push(await extentInBackground(await liveRows()));
  }
  return mergedExtent(boxes);
}

/** Return the upward axis of a generator's space. */
export function upOf({ space }) {
  const axis = space?.up ?? "-y";
  return ["x", "y", "z"].map((letter) => (axis.endsWith(letter) ? (axis[0] === "-" ? -1 : 1) : 0));
}

/** Input tensors in GPU buffers that stay: a captured graph reads the same ones. */
export function gpuTensors(ort, device) {
  return (name, dataType, dims) => {
    const buffer = storageBuffer(device, `input ${name}`, 4 * dims.reduce((a, b) => a * b, 1));
    const write = (array) => {
      const bytes = new Uint8Array(Math.ceil(array.byteLength / 4) * 4);
      bytes.set(new Uint8Array(array.buffer));
      device.queue.writeBuffer(buffer, 0, bytes);
    };
    return { tensor: ort.Tensor.fromGpuBuffer(buffer, { dataType, dims }), write, destroy: () => buffer.destroy() };
  };
}

/** Input tensors in the memory of the page. */
export function pageTensors(ort) {
  return (name, dataType, dims) => {
    const data = new ARRAYS[dataType](dims.reduce((a, b) => a * b, 1));
    return { tensor: new ort.Tensor(dataType, data, dims), write: (array) => data.set(array), destroy: () => {} };
  };
}

/** The input tensors of a session, which stay. */
export class GeneratorInputs {
  /** @param {(name: string, type: string, dims: number[]) => any} makeTensor As `gpuTensors` returns it. */
  constructor(session, manifest, makeTensor) {
    this._isTransposed = (manifest.space?.matrix_order ?? "column") === "column";
    const declared = new Map(manifest.inputs.map((spec) => [spec.name, spec]));
    /** @type {Map<string, {spec: any, type: string, size: number, stored: any, last: string}>} */
    this._inputs = new Map();
    this.feeds = {};
    for (const { name, type, shape } of session.inputMetadata) {
      const spec = declared.get(name) ?? { name, role: "" };
      const dims = shape.map(Number);
      const size = dims.reduce((a, b) => a * b, 1);
      const stored = makeTensor(name, type, dims);
      this._inputs.set(name, { spec, type, size, stored, last: "" });
      this.feeds[name] = stored.tensor;
      if (spec.role !== "image") this._write(name, defaultOf(spec, dims));
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
   * @param {import("./camera.js").Camera | null} [camera]
   */
  update(values, camera = null) {
    const known = camera ? cameraValues(camera) : {};
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
    input.stored.write(ARRAYS[type].from(ordered));
    return true;
  }

  /** Release the buffers. */
  destroy() {
    for (const { stored } of this._inputs.values()) stored.destroy();
  }
}
