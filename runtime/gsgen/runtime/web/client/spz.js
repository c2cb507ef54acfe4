/** Reads SPZ files (nianticlabs/spz), versions 1 to 4: quantised streams of attributes. */

import { ByteSource } from "./byte_source.js";
import { failing } from "./errors.js";
import { IDENTITY } from "./matrices.js";
import { SHARE_LOGITS, MOST_COEFFICIENTS, RowWriter, setFromLargest, setUnit, turn } from "./row_writer.js";

const MAGIC = 0x5053474e;
const [HEADER, HEADER_OF_4, ENTRY, RECORD] = [16, 32, 16, 8]; // bytes
const [ANTIALIASED, EXTENDED] = [1, 2];
const COORDINATES = 0xadbe0003; // an extension: SPZ_ADOBE_coordinate_system
const AXES = [1, -1, -1]; // right, up, back → right, down, forward
const PIECE = 1 << 20; // bytes that are unpacked at once

const { fround } = Math;
const COLORS = Float32Array.from({ length: 256 }, (_, byte) => fround(fround(byte / 255) - 0.5) / fround(0.15));

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readSpz(source, { sink }) {
  const frame = await unpackedSpz(await source.rest(), source.name);
  const [x, y, z] = frame.signs;
  await writeSpz(frame, sink, source.name, [x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, 0, 0, 0, 0, 1]);
}

/** Return the header and the streams of an SPZ file. @param {Uint8Array} data */
export async function unpackedSpz(data, name) {
  if (data[0] === 0x1f) data = await ByteSource.of(data, name).unpacked("gzip").rest();
  const fail = failing(name, "Download it again, or convert it: gsgen convert FILE model.ply");
  if (data.length < HEADER) fail("ends within its header");
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const [magic, version, count] = [0, 4, 8].map((offset) => view.getUint32(offset, true));
  const [degree, bits, flags, pieces] = data.subarray(12, 16);
  if (magic !== MAGIC) fail("is not an SPZ file");
  if (version < 1 || version > 4) fail(`has version ${version} of SPZ, expected 1 to 4`);
  if (!count) fail("has 0 splats");
  if (degree > 4) fail(`has SH of degree ${degree}, expected 0 to 4`);
  if (bits > 24) fail(`has ${bits} fractional bits, expected 0 to 24`);
  const stored = (degree + 1) ** 2;
  const widths = [version === 1 ? 6 : 9, 1, 3, 3, version <= 2 ? 3 : 4, 3 * (stored - 1)];
  const sizes = widths.map((width) => width * count);
  const frame = { version, count, stored, bits, isMip: Boolean(flags & ANTIALIASED), signs: AXES, streams: [] };
  if (version <= 3) {
    const end = sizes.reduce((sum, size) => sum + size, HEADER);
    if (data.length < end || (data.length > end && !(flags & EXTENDED))) fail(`unpacks to ${data.length} bytes, expected ${end}`);
    if (flags & EXTENDED) frame.signs = declaredAxes(data.subarray(end), fail);
    let first = HEADER;
    frame.streams = sizes.map((size) => data.subarray(first, (first += size)));
    return frame;
  }
  const contents = view.getUint32(HEADER, true);
  let first = contents + ENTRY * pieces;
  if (pieces !== sizes.filter(Boolean).length || contents < HEADER_OF_4 || first > data.length) {
    fail(`has ${pieces} streams at byte ${contents}, expected ${sizes.filter(Boolean).length}`);
  }
  if (flags & EXTENDED) frame.signs = declaredAxes(data.subarray(HEADER_OF_4, contents), fail);
  let entry = contents;
  for (const size of sizes) {
    if (!size) {
      frame.streams.push(new Uint8Array(0)); // empty streams are left out
      continue;
    }
    const [packed, unpacked] = [0, 8].map((offset) => Number(view.getBigUint64(entry + offset, true)));
    if (unpacked !== size || first + packed > data.length) fail(`has a stream of ${unpacked} bytes, expected ${size}`);
    frame.streams.push(await unzstd(data.subarray(first, first + packed), size, fail));
    first += packed;
    entry += ENTRY;
  }
  if (first !== data.length) fail(`has ${data.length} bytes, expected ${first}`);
  return frame;
}

/** Unpack a zstd stream, with turns of the event loop in between. */
async function unzstd(packed, size, fail) {
  const { Decompress } = await import("./fzstd.js");
  const bytes = new Uint8Array(size);
  let length = 0;
  const unpacker = new Decompress((piece) => {
    if (length + piece.length > size) fail(`has a stream of more than ${size} bytes`);
    bytes.set(piece, length);
    length += piece.length;
  });
  try {
    for (let first = 0; first < packed.length; first += PIECE) {
      unpacker.push(packed.subarray(first, first + PIECE), first + PIECE >= packed.length);
      await new Promise((resolve) => setTimeout(resolve));
    }
  } catch (error) {
    if (error.hint !== undefined) throw error;
    fail(`has a stream that cannot be unpacked: ${error.message}`);
  }
  if (length !== size) fail(`has a stream that unpacks to ${length} bytes, expected ${size}`);
  return bytes;
}

/** Return the signs of the axes that records of extensions declare. @param {Uint8Array} records */
function declaredAxes(records, fail) {
  const view = new DataView(records.buffer, records.byteOffset, records.length);
  let signs = AXES;
  for (let offset = 0; offset < records.length; ) {
    if (offset + RECORD > records.length) fail("ends within an extension");
    const [kind, length] = [view.getUint32(offset, true), view.getUint32(offset + 4, true)];
    offset += RECORD + length;
    if (offset > records.length) fail("ends within an extension");
    if (kind !== COORDINATES) continue;
    const code = length === 1 ? records[offset - 1] : length >= 4 ? view.getUint32(offset - length, true) : 0;
    if (code < 1 || code > 8) fail(`has the coordinate system ${code}, expected 1 to 8`);
    signs = [(code - 1) & 1 ? 1 : -1, (code - 1) & 2 ? -1 : 1, (code - 1) & 4 ? 1 : -1];
  }
  return signs;
}

/** Write the rows of an SPZ file, in its own axes. */
export async function writeSpz(frame, sink, name, transform = IDENTITY, isLinear = false) {
  const { version, count, stored, bits, isMip, streams } = frame;
  const [positions, alphas, colors, scales, turns, harmonics] = streams;
  const writer = new RowWriter(sink, name, { count, coefficients: stored, antialias: isMip, isLinear, transform });
  const [places, words] = [positions, turns].map(({ buffer, byteOffset, length }) => new DataView(buffer, byteOffset, length));
  const step = 2 ** -bits;
  const coordinate = version === 1
    ? (i) => places.getFloat16(2 * i, true)
    : (i) => ((positions[3 * i] | (positions[3 * i + 1] << 8) | (positions[3 * i + 2] << 16)) << 8 >> 8) * step;
  const drawn = 3 * (Math.min(stored, MOST_COEFFICIENTS) - 1);
  for await (const [first, rows] of writer.batches()) {
    for (let row = first; row < first + rows; row++) {
      const i = 3 * row;
      if (version <= 2) {
        const [x, y, z] = [turns[i] / 127.5 - 1, turns[i + 1] / 127.5 - 1, turns[i + 2] / 127.5 - 1];
        setUnit(Math.sqrt(Math.max(1 - (x * x + y * y + z * z), 0)), x, y, z);
      } else setFromWord(words.getUint32(4 * row, true));
      let base = writer.place(
        coordinate(i), coordinate(i + 1), coordinate(i + 2), turn[0], turn[1], turn[2], turn[3],
        scales[i] / 16 - 10, scales[i + 1] / 16 - 10, scales[i + 2] / 16 - 10, SHARE_LOGITS[alphas[row]],
      );
      for (let c = 0; c < 3; c++) writer.appearance[base++] = COLORS[colors[i + c]];
      const higher = 3 * (stored - 1) * row;
      for (let k = 0; k < drawn; k++) writer.appearance[base++] = (harmonics[higher + k] - 128) / 128;
      writer.keep();
    }
  }
  writer.end();
}

/** The two highest bits name the largest of x, y, z, w; the others have ten bits each, the last the lowest. */
function setFromWord(word) {
  const part = (shift) => {
    const size = (((word >>> shift) & 0x1ff) / 511) * Math.sqrt(0.5);
    return (word >>> shift) & 0x200 ? -size : size;
  };
  setFromLargest(word >>> 30, part(20), part(10), part(0));
  const [x, y, z, w] = turn;
  turn[0] = w;
  turn[1] = x;
  turn[2] = y;
  turn[3] = z;
}
