/** Reads KSPLAT files, version 0.1, of all three compression levels (mkkellogg/GaussianSplats3D). */

import { failing } from "./errors.js";
import { BYTE_COLORS, BYTE_LOGITS, RowWriter, setUnit, turn } from "./row_writer.js";

const [HEADER, SECTION] = [4096, 1024]; // bytes
const SH_RANGE = 1.5;
const SCALE_RANGE = 32767;
const HIGHER = [0, 9, 24]; // harmonics above degree 0

const { fround } = Math;

/** Return whether a file starts like a KSPLAT file. @param {Uint8Array} head */
export function looksLikeKsplat(head, size) {
  if (head.length < HEADER) return false;
  const view = new DataView(head.buffer, head.byteOffset, head.length);
  const isKnown = view.getUint32(0, true) === 0x100 && view.getUint16(20, true) <= 2;
  const sections = view.getUint32(4, true);
  return isKnown && sections > 0 && (!size || HEADER + SECTION * sections <= size);
}

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readKsplat(source, { sink }) {
  const fail = failing(source.name, "Write the file again, or convert it: gsgen convert FILE model.spz");
  const header = new DataView((await source.need(HEADER, "its header")).buffer);
  const level = header.getUint16(20, true);
  const low = fround(header.getFloat32(36, true) || -SH_RANGE);
  const span = fround((header.getFloat32(40, true) || SH_RANGE) - low);
  const sections = [];
  for (let left = header.getUint32(4, true); left > 0; left--) {
    sections.push(sectionOf(new DataView((await source.need(SECTION, "a section's header")).buffer), level, fail));
  }
  const count = sections.reduce((sum, section) => sum + section.count, 0);
  if (!count) fail("has 0 splats");
  const degree = Math.max(...sections.filter((section) => section.count).map((section) => section.degree));
  const writer = new RowWriter(sink, source.name, { count, coefficients: (degree + 1) ** 2 });
  for (const section of sections) await writeSection(source, section, level, low, span, writer, fail);
  writer.end();
}

function sectionOf(view, level, fail) {
  const [count, most, bucketSize, buckets] = [0, 4, 8, 12].map((offset) => view.getUint32(offset, true));
  const [block, storage, range] = [view.getFloat32(16, true), view.getUint16(20, true), view.getUint32(24, true)];
  const [full, partial, degree] = [view.getUint32(32, true), view.getUint32(36, true), view.getUint16(40, true)];
  if (degree > 2) fail(`has SH of degree ${degree}, expected 0 to 2`);
  if (count > most) fail(`has ${count} splats in a section for ${most}`);
  const isRoomy = count <= (full + partial) * bucketSize && full + partial <= buckets && storage >= 12 && Number.isFinite(block);
  if (level && count && !isRoomy) fail(`has a section of ${count} splats in ${buckets} buckets of ${bucketSize}`);
  return { count, most, bucketSize, buckets, block, storage, range: range || SCALE_RANGE, full, partial, degree };
}

async function writeSection(source, section, level, low, span, writer, fail) {
  const { count, most, bucketSize, buckets, block, storage, range, full, partial, degree } = section;
  const lengths = new Uint32Array((await source.need(4 * partial, "its buckets")).buffer);
  const centers = new DataView((await source.need(storage * buckets, "its buckets")).buffer);
  if (lengths.some((length) => length > bucketSize)) fail(`has a bucket of more than ${bucketSize} splats`);
  const higher = HIGHER[degree];
  const [isPlain, isByte] = [level === 0, level === 2];
  const number = isPlain ? 4 : 2;
  const [scaleAt, turnAt] = isPlain ? [12, 24] : [6, 12];
  const colorAt = turnAt + 4 * number;
  const rowBytes = colorAt + 4 + higher * (isByte ? 1 : number);
  const step = block / 2 / range;
  let [bucket, left] = [-1, 0]; // splats that remain in the bucket
  for (let first = 0; first < count; first += writer.batch) {
    const rows = Math.min(writer.batch, count - first);
    const bytes = await source.need(rows * rowBytes, "its rows");
    const view = new DataView(bytes.buffer);
    const read = (offset) => (isPlain ? view.getFloat32(offset, true) : view.getFloat16(offset, true));
    for (let row = 0; row < rows; row++) {
      const start = row * rowBytes;
      for (; !isPlain && !left; left = bucket < full ? bucketSize : lengths[bucket - full]) {
        if (++bucket >= full + partial) fail("has splats outside of its buckets");
      }
      left -= 1;
      const place = (axis) => {
        if (isPlain) return view.getFloat32(start + 4 * axis, true);
        return (view.getUint16(start + 2 * axis, true) - range) * step + centers.getFloat32(bucket * storage + 4 * axis, true);
      };
      const turnStart = start + turnAt;
      setUnit(read(turnStart), read(turnStart + number), read(turnStart + 2 * number), read(turnStart + 3 * number), 0);
      const scale = (axis) => Math.log(read(start + scaleAt + number * axis));
      const color = start + colorAt;
      const base = writer.place(
        place(0), place(1), place(2), turn[0], turn[1], turn[2], turn[3],
        scale(0), scale(1), scale(2), BYTE_LOGITS[bytes[color + 3]],
      );
      for (let c = 0; c < 3; c++) writer.appearance[base + c] = BYTE_COLORS[bytes[color + c]];
      for (let i = 0; i < higher; i++) {
        // Degree by degree: all of red, then green, then blue.
        const [at, own] = i < 9 ? [1, 3] : [4, 5];
        const within = i < 9 ? i : i - 9;
        const target = base + 3 * (at + (within % own)) + Math.floor(within / own);
        writer.appearance[target] = isByte
          ? low + fround(fround(bytes[color + 4 + i] / 255) * span)
          : read(color + 4 + number * i);
      }
      writer.keep();
    }
    await writer.flush();
  }
  await source.skip((most - count) * rowBytes);
}
