// Runs a model at its probes, and gives the rules of level `values` what came out.

import fs from 'node:fs';
import path from 'node:path';
import {setFlagsFromString} from 'node:v8';
import {pathToFileURL} from 'node:url';
import {half} from './onnx_file.mjs';

/** Load ONNX Runtime Web from a folder; it runs on one thread of the CPU. */
export async function startRuntime(folder) {
  // Code for a few runs need not be optimised: that takes minutes, and node would wait for it.
  setFlagsFromString('--liftoff-only');
  const ort = await import(pathToFileURL(path.resolve(folder, 'ort.webgpu.bundle.min.mjs')));
  ort.env.wasm.numThreads = 1;
  ort.env.wasm.wasmBinary = fs.readFileSync(path.join(folder, 'ort-wasm-simd-threaded.asyncify.wasm'));
  ort.env.logLevel = 'fatal';
  return ort;
}

const ARRAYS = {float32: Float32Array, float64: Float64Array, int32: Int32Array, uint8: Uint8Array,
  int64: BigInt64Array, float16: Uint16Array};

/** Run the model at each probe, and at `more(probes)`; the result has `runs` or `error`. */
export async function runProbes(m, more) {
  const external = [...new Set(m.model.graph.initializers.filter((tensor) => tensor.location === 1)
    .map((tensor) => tensor.external.find(({key}) => key === 'location').value))];
  let session;
  const results = [];
  try {
    session = await m.runtime.InferenceSession.create(m.bytes, {executionProviders: ['wasm'],
      logSeverityLevel: 4,
      externalData: external.map((name) => ({path: name, data: fs.readFileSync(path.join(m.folder, name))}))});
    for (const {label, inputs} of [...m.probes, ...more]) {
      const feeds = {};
      for (const [name, {dtype, shape, values}] of Object.entries(inputs)) {
        const numbers = dtype === 'float16' ? values.map(bitsOfHalf) : values;
        feeds[name] = new m.runtime.Tensor(dtype, ARRAYS[dtype].from(numbers), shape);
      }
      const outputs = new Map(Object.entries(await session.run(feeds)).map(([name, tensor]) =>
        [name, {dtype: tensor.type, dims: [...tensor.dims], data: tensor.type === 'float16'
          ? Float64Array.from(new Uint16Array(tensor.data.buffer, tensor.data.byteOffset, tensor.data.length), half)
          : tensor.data}]));
      results.push({label, inputs, outputs});
    }
  } catch (error) {
    return {runs: results, error: String(error.message ?? error).split('\n')[0]};
  } finally {
    await session?.release();
  }
  return {runs: results};
}

function bitsOfHalf(value) {
  const bits = new Uint32Array(Float32Array.of(value).buffer)[0];
  const sign = (bits >>> 16) & 0x8000;
  const size = Math.abs(value);
  if (size >= 65520) return sign | 0x7c00;
  if (size < 2 ** -14) return sign | Math.round(size * 2 ** 24);
  const exponent = Math.floor(Math.log2(size));
  return sign | (((exponent + 15) << 10) + Math.round((size / 2 ** exponent - 1) * 1024));
}

/** One run of a generator: its rows, colours and cells, as numbers. */
export class Frame {
  constructor(run, manifest) {
    const {gaussians, appearance, count, cells} = manifest.outputs;
    const output = (part) => part && run.outputs.get(part.name);
    this.label = run.label;
    this.inputs = run.inputs;
    this.gaussians = output(gaussians);
    this.colors = output(appearance);
    this.cells = output(cells);
    this.isRgb = appearance?.space === 'rgb';
    this.rows = this.gaussians?.dims[0] ?? 0;
    this.stored = Number(output(count)?.data[0] ?? this.rows);
    this.live = Math.min(Math.max(this.stored, 0), this.rows); // C28
    this.channels = this.colors?.dims[1] ?? 0;
    this.meant = this.isRgb ? 3 : this.channels; // L11: a fourth channel has no meaning
  }

  row(i) {
    return this.gaussians.data.subarray(10 * i, 10 * i + 10);
  }

  color(i) {
    return this.colors.data.subarray(this.channels * i, this.channels * i + this.meant);
  }

  finite(i) {
    return this.row(i).every(Number.isFinite) && (!this.colors || this.color(i).every(Number.isFinite));
  }

  /** Whether a float16 row holds a value that was clamped: GV010 alone judges it (L9). */
  saturated(i) {
    return this.isHalf && this.row(i).some((n) => Math.abs(n) >= 65504);
  }

  /** The rows that are drawn (I8): live, finite, and of an opacity of at least 1/255. */
  get drawn() {
    this.kept ??= Array.from({length: this.live}, (_, i) => i)
      .filter((i) => this.row(i)[3] >= 1 / 255 && this.finite(i) && !this.saturated(i));
    return this.kept;
  }

  get isHalf() {
    return this.gaussians.dtype === 'float16';
  }
}

/** The eigenvalues of xx xy xz yy yz zz, lowest first. */
export function eigenvalues([xx, xy, xz, yy, yz, zz]) {
  const off = xy * xy + xz * xz + yz * yz;
  const mean = (xx + yy + zz) / 3;
  const spread = Math.sqrt(((xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2 * off) / 6);
  if (spread === 0) return [mean, mean, mean];
  const [a, b, c] = [xx, yy, zz].map((n) => (n - mean) / spread);
  const [d, e, f] = [xy, xz, yz].map((n) => n / spread);
  const determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e);
  const angle = Math.acos(Math.min(1, Math.max(-1, determinant / 2))) / 3;
  const high = mean + 2 * spread * Math.cos(angle);
  const low = mean + 2 * spread * Math.cos(angle + (2 * Math.PI) / 3);
  return [low, 3 * mean - low - high, high];
}

/** Whether a covariance is positive semi-definite up to rounding (L8.2). */
export function semiDefinite(covariance, isHalf) {
  const trace = covariance[0] + covariance[3] + covariance[5];
  const slack = isHalf ? 2 ** -10 * trace + 3 * 2 ** -25 : 1e-5 * trace;
  return eigenvalues(covariance)[0] >= -slack;
}
