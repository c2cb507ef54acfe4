/** Reads splat files into the contract's packed rows: PLY of 3D Gaussian splatting, SPZ and SOG. */

import { failing } from "./errors.js";
import { IDENTITY } from "./matrices.js";

const MOST_COEFFICIENTS = 16; // degree 3
const CONVERT = "Convert it: gsgen convert FILE model.spz";
// Axes right, up, back → right, down, forward.
const FROM_SPZ_AXES = Object.freeze([1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]);

/**
 * Read a splat file.
 * @param {string} name Its address, for messages.
 * @returns {Promise<import("./splat_buffers.js").Splats>}
 */
export async function readSplats(data, name) {
  const start = new Uint8Array(data, 0, Math.min(4, data.byteLength));
  const magic = String.fromCharCode(...start);
  if (magic.startsWith("ply")) return readPly(data, name);
  if (start[0] === 0x1f && start[1] === 0x8b) return readSpz(await inflated(data, name), name);
  if (magic === "NGSP") return readSpz(data, name);
  if (magic === "PK\x03\x04") return (await import("./sog.js")).readSog(data, name);
  const hint = "The page reads .ply, .spz (versions 1 to 3), .sog and .onnx. " + CONVERT;
  return failing(name, hint)("is neither PLY nor SPZ nor SOG");
}

/** Unpack bytes. @param {CompressionFormat} format */
export async function inflated(data, name, format = "gzip") {
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream(format));
  try {
    return await new Response(stream).arrayBuffer();
  } catch (error) {
    return failing(name, "Download it again.")(`cannot be unpacked: ${error.message}`);
  }
}

/** Arrays of Gaussians that fill one after the other. */
export class RowWriter {
  constructor(count, coefficients) {
    this.count = count;
    this.channels = 3 * coefficients;
    this.rows = new Float32Array(10 * count);
    this.appearance = new Float32Array(this.channels * count);
  }

  /**
   * Write a row; the covariance is R S Sᵀ Rᵀ (Kerbl et al. 2023, equation 6).
   * @param {number[]} quaternion w, x, y, z; a zero quaternion turns nothing.
   */
  set(index, center, opacity, logScale, quaternion) {
    const norm = Math.hypot(...quaternion);
    const [w, x, y, z] = norm ? quaternion.map((part) => part / norm) : [1, 0, 0, 0];
    const [a, b, c] = logScale.map(Math.exp);
    const m = [
      a * (1 - 2 * (y * y + z * z)), b * 2 * (x * y - w * z), c * 2 * (x * z + w * y),
      a * 2 * (x * y + w * z), b * (1 - 2 * (x * x + z * z)), c * 2 * (y * z - w * x),
      a * 2 * (x * z - w * y), b * 2 * (y * z + w * x), c * (1 - 2 * (x * x + y * y)),
    ];
    const entry = (i, j) => m[i] * m[j] + m[i + 1] * m[j + 1] + m[i + 2] * m[j + 2];
    const covariance = [entry(0, 0), entry(0, 3), entry(0, 6), entry(3, 3), entry(3, 6), entry(6, 6)];
    this.rows.set([...center, opacity, ...covariance], 10 * index);
  }

  /** @returns {import("./splat_buffers.js").Splats} */
  splats(antialias, transform = IDENTITY) {
    const { rows, appearance, channels, count } = this;
    return { rows, appearance, channels, count, space: "sh", antialias, transform };
  }
}

const sigmoid = (x) => 1 / (1 + Math.exp(-x));

const PLY_READERS = {
  float: ["getFloat32", 4], float32: ["getFloat32", 4],
  double: ["getFloat64", 8], float64: ["getFloat64", 8],
  uchar: ["getUint8", 1], uint8: ["getUint8", 1], char: ["getInt8", 1], int8: ["getInt8", 1],
  ushort: ["getUint16", 2], uint16: ["getUint16", 2], short: ["getInt16", 2], int16: ["getInt16", 2],
  uint: ["getUint32", 4], uint32: ["getUint32", 4], int: ["getInt32", 4], int32: ["getInt32", 4],
};

/** Return the columns of a PLY file's vertices, its count, and where the bytes begin. */
function plyHeader(data, name) {
  const head = new TextDecoder("latin1").decode(new Uint8Array(data, 0, Math.min(65536, data.byteLength)));
  const end = head.search(/end_header\r?\n/);
  const fail = failing(name, CONVERT);
  if (end < 0) fail("has no end_header in its first 65536 bytes");
  const lines = head.slice(0, end).split(/\r?\n/).map((line) => line.trim().split(/\s+/));
  if (!lines.some(([word, kind]) => word === "format" && kind === "binary_little_endian")) {
    fail("is not binary_little_endian, which pages read");
  }
  const elements = lines.filter(([word]) => word === "element");
  if (elements[0]?.[1] !== "vertex" || elements[0].length !== 3) fail("does not begin with vertices");
  if (elements.length > 1) fail("has more than vertices: a mesh, or a compressed PLY");
  const columns = new Map();
  let size = 0;
  for (const [word, type, column] of lines) {
    if (word !== "property") continue;
    if (!(type in PLY_READERS)) fail(`has a property of type ${type}`);
    columns.set(column, { read: PLY_READERS[type][0], offset: size });
    size += PLY_READERS[type][1];
  }
  const count = Number(elements[0][2]);
  const first = end + head.slice(end).indexOf("\n") + 1;
  if (first + size * count > data.byteLength) {
    fail(`ends after ${data.byteLength} bytes, expected ${first + size * count}`, "Download it again.");
  }
  return { columns, size, count, first };
}

function readPly(data, name) {
  const { columns, size, count, first } = plyHeader(data, name);
  const fail = failing(name, CONVERT);
  const view = new DataView(data);
  const required = ["x", "y", "z", "opacity", "f_dc_0", "f_dc_1", "f_dc_2"];
  required.push(...[0, 1, 2].map((i) => `scale_${i}`), ...[0, 1, 2, 3].map((i) => `rot_${i}`));
  const missing = required.filter((column) => !columns.has(column));
  const hint = "A PLY of Gaussians has x y z f_dc_* opacity scale_* rot_*. " + CONVERT;
  if (missing.length) fail(`has no ${missing.join(", ")}`, hint);
  const numbers = (names) => names.map((column) => columns.get(column));
  const read = (row, { read: method, offset }) => view[method](first + row * size + offset, true);
  const higher = [...columns.keys()].filter((column) => column.startsWith("f_rest_")).length;
  const stored = 1 + higher / 3;
  if (![1, 4, 9, 16, 25].includes(stored)) fail(`has ${higher} columns f_rest_*, expected 0, 9, 24 or 45`);
  const coefficients = Math.min(stored, MOST_COEFFICIENTS);
  const [center, scale, turn] = [required.slice(0, 3), required.slice(7, 10), required.slice(10)].map(numbers);
  const [opacity] = numbers(["opacity"]);
  // f_rest holds all red coefficients, then all green, then all blue.
  const harmonics = numbers(["f_dc_0", "f_dc_1", "f_dc_2"]);
  for (let k = 1; k < coefficients; k++) {
    for (let c = 0; c < 3; c++) harmonics.push(columns.get(`f_rest_${c * (stored - 1) + k - 1}`));
  }
  const writer = new RowWriter(count, coefficients);
  for (let row = 0; row < count; row++) {
    const value = (column) => read(row, column);
    writer.set(row, center.map(value), sigmoid(value(opacity)), scale.map(value), turn.map(value));
    const base = row * writer.channels;
    for (let i = 0; i < harmonics.length; i++) writer.appearance[base + i] = read(row, harmonics[i]);
  }
  return writer.splats("classic");
}

/** SPZ of nianticlabs/spz, versions 1 to 3, unpacked; rows keep its axes: right, up, back. */
function readSpz(data, name) {
  const view = new DataView(data);
  const fail = failing(name, CONVERT);
  if (data.byteLength < 16) fail("ends within the header", "Download it again.");
  const magic = view.getUint32(0, true);
  const [version, count] = [view.getUint32(4, true), view.getUint32(8, true)];
  const [degree, bits, flags] = [12, 13, 14].map((offset) => view.getUint8(offset));
  if (magic !== 0x5053474e) fail("is not an SPZ file");
  if (version < 1 || version > 3) fail(`has version ${version} of SPZ, expected 1, 2 or 3`);
  if (degree > 3) fail(`has SH of degree ${degree}, expected 0 to 3`);
  if (flags & 2) fail("has extensions, which may turn its axes");
  const stored = (degree + 1) ** 2;
  const widths = [version === 1 ? 6 : 9, 1, 3, 3, version <= 2 ? 3 : 4, 3 * (stored - 1)];
  const starts = [16];
  for (const width of widths) starts.push(starts[starts.length - 1] + width * count);
  if (starts[6] !== data.byteLength) {
    fail(`unpacks to ${data.byteLength} bytes, expected ${starts[6]}`, "Download it again.");
  }
  const bytes = new Uint8Array(data);
  const writer = new RowWriter(count, stored);
  for (let row = 0; row < count; row++) {
    const [p, a, c, s, r, h] = starts.map((start, i) => start + widths[i] * row);
    const center = [0, 1, 2].map((i) => spzCoordinate(view, bytes, p, i, version, bits));
    const scale = [0, 1, 2].map((i) => bytes[s + i] / 16 - 10);
    const turnBytes = [0, 1, 2].map((i) => bytes[r + i] / 127.5 - 1);
    const turn = version <= 2 ? withLargest(0, turnBytes) : wordRotation(view.getUint32(r, true));
    writer.set(row, center, bytes[a] / 255, scale, turn);
    const base = row * writer.channels;
    for (let i = 0; i < 3; i++) writer.appearance[base + i] = (bytes[c + i] / 255 - 0.5) / 0.15;
    for (let i = 3; i < writer.channels; i++) {
      writer.appearance[base + i] = (bytes[h + i - 3] - 128) / 128;
    }
  }
  return writer.splats(flags & 1 ? "mip" : "classic", FROM_SPZ_AXES);
}

function spzCoordinate(view, bytes, first, axis, version, bits) {
  if (version <= 1) return view.getFloat16(first + 2 * axis, true);
  const offset = first + 3 * axis;
  const whole = bytes[offset] | (bytes[offset + 1] << 8) | (bytes[offset + 2] << 16);
  return ((whole << 8) >> 8) / 2 ** bits;
}

/** The two highest bits name the largest part; the others have ten bits each, the last the lowest. */
function wordRotation(word) {
  const parts = [20, 10, 0].map((shift) => {
    const field = (word >>> shift) & 0x3ff;
    const size = ((field & 0x1ff) / 511) * Math.SQRT1_2;
    return field & 0x200 ? -size : size;
  });
  const [x, y, z, w] = withLargest(word >>> 30, parts);
  return [w, x, y, z];
}

/** Return a unit quaternion from three of its parts, and the index of the fourth. */
export function withLargest(index, parts) {
  const square = parts.reduce((sum, part) => sum + part * part, 0);
  return parts.toSpliced(index, 0, Math.sqrt(Math.max(1 - square, 0)));
}
