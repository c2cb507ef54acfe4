/** Reads SPLAT files (antimatter15/splat): 32 bytes per splat, no header, degree 0. */

import { failing } from "./errors.js";
import { BYTE_COLORS, BYTE_LOGITS, RowWriter, setUnit, turn } from "./row_writer.js";

export const ROW_BYTES = 32;
const SAMPLED_ROWS = 256;

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readSplat(source, { sink }) {
  const bytes = source.size ? null : await source.rest();
  const size = bytes?.length ?? source.size;
  if (size % ROW_BYTES) failing(source.name, "Download it again.")(`has ${size} bytes, expected a multiple of ${ROW_BYTES}`);
  const writer = new RowWriter(sink, source.name, { count: size / ROW_BYTES });
  for await (const [first, rows] of writer.batches()) {
    const batch = bytes
      ? bytes.slice(first * ROW_BYTES, (first + rows) * ROW_BYTES)
      : await source.need(rows * ROW_BYTES, "its rows");
    const floats = new Float32Array(batch.buffer);
    for (let row = 0; row < rows; row++) {
      const [f, b] = [8 * row, 32 * row];
      setUnit((batch[b + 28] - 128) / 128, (batch[b + 29] - 128) / 128, (batch[b + 30] - 128) / 128, (batch[b + 31] - 128) / 128, 0);
      const base = writer.place(
        floats[f], floats[f + 1], floats[f + 2], turn[0], turn[1], turn[2], turn[3],
        Math.log(floats[f + 3]), Math.log(floats[f + 4]), Math.log(floats[f + 5]), BYTE_LOGITS[batch[b + 27]],
      );
      for (let c = 0; c < 3; c++) writer.appearance[base + c] = BYTE_COLORS[batch[b + 24 + c]];
      writer.keep();
    }
  }
  writer.end();
}

/** Return whether a file can be a SPLAT file, by its size, 0 where nobody knows it, and its first rows. */
export function looksLikeSplat(head, size) {
  if (size % ROW_BYTES || head.length < ROW_BYTES) return false;
  const view = new DataView(head.buffer, head.byteOffset, head.length);
  for (let first = 0; first + ROW_BYTES <= Math.min(head.length, SAMPLED_ROWS * ROW_BYTES); first += ROW_BYTES) {
    const numbers = [0, 4, 8, 12, 16, 20].map((offset) => view.getFloat32(first + offset, true));
    const length = Math.hypot(...Array.from(head.subarray(first + 28, first + ROW_BYTES), (byte) => (byte - 128) / 128));
    const isPlausible = numbers.every(Number.isFinite) && numbers.slice(3).every((scale) => scale >= 0);
    if (!isPlausible || !(length > 0.9 && length < 1.1)) return false;
  }
  return true;
}
