/** Reads compressed PLY files (PlayCanvas): packed words relative to boxes of 256 splats. */

import { ByteSource } from "./byte_source.js";
import { failing } from "./errors.js";
import { columnsOf, skipElement } from "./ply_header.js";
import { MOST_COEFFICIENTS, RowWriter, SHARE_LOGITS, SH_C0, setFromLargest, turn } from "./row_writer.js";

const BOX_ROWS = 256;
const WORDS = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
const ENDS = (names) => ["min", "max"].flatMap((end) => names.map((name) => `${end}_${name}`));
const BOX = [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]].flatMap(ENDS);
const HARMONICS = Float32Array.from({ length: 256 }, (_, byte) => {
  return ((byte === 0 ? 0 : byte === 255 ? 1 : (byte + 0.5) / 256) - 0.5) * 8;
});

/** @param {import("./byte_source.js").ByteSource} source @param {import("./ply_header.js").Header} header */
export async function readCompressed(source, header, sink) {
  const fail = failing(source.name, "Write the file again, or convert it: gsgen convert FILE model.spz");
  const of = (name) => header.elements.find((element) => element.name === name);
  const [vertex, chunk, sh] = [of("vertex"), of("chunk"), of("sh")];
  if (!vertex || !chunk) return fail("has no elements chunk and vertex");
  if (chunk.count * BOX_ROWS < vertex.count) fail(`has ${chunk.count} boxes of 256 splats for ${vertex.count}`);
  const higher = sh?.properties.length ?? 0; // gsplat declares the element at degree 0, too
  if (![0, 9, 24, 45, 72].includes(higher)) fail(`has ${higher} harmonics, expected 0, 9, 24, 45 or 72`);
  if (higher && sh?.count !== vertex.count) fail(`has ${sh?.count} rows of harmonics for ${vertex.count} splats`);
  const boxes = chunk.properties.some(({ name }) => name === "max_b") ? BOX : BOX.slice(0, 12);
  const harmonics = Array.from({ length: higher }, (_, i) => `f_rest_${i}`);
  for (const [element, names, type] of /** @type {[any, string[], string][]} */ ([[vertex, WORDS, "Uint32"], [chunk, boxes, "Float32"], [sh, harmonics, "Uint8"]])) {
    const wrong = names.filter((name) => !element.properties.some((own) => own.name === name && own.type === type && !own.countType));
    if (wrong.length) fail(`has no ${wrong.join(", ")} of the type ${type}`);
  }
  const writer = new RowWriter(sink, source.name, {
    count: vertex.count, coefficients: 1 + higher / 3, antialias: header.isMip, up: header.up,
  });
  const kept = higher ? { slots: new Int32Array(vertex.count), constants: new Float32Array(3 * vertex.count) } : null;
  let bounds = null;
  let early = null; // rows that come before their boxes
  for (const element of header.elements) {
    if (element === chunk) {
      bounds = new Float32Array(boxes.length * chunk.count);
      let first = 0;
      for await (const table of columnsOf(source, header, chunk, boxes, 1 << 12)) {
        bounds.set(table, first);
        first += table.length;
      }
      if (early) await writeRows(ByteSource.of(early, source.name), header, vertex, writer, bounds, boxes.length, kept);
    } else if (element === vertex && bounds) {
      await writeRows(source, header, vertex, writer, bounds, boxes.length, kept);
    } else if (element === vertex && header.encoding !== "ascii") {
      early = await source.need(vertex.count * vertex.rowBytes, "element vertex");
    } else if (element === sh && higher && kept && writer.sent) {
      await writeHarmonics(source, header, sh, harmonics, writer, kept);
    } else if (element === vertex || (element === sh && higher)) {
      fail(`has the element ${element.name} before the element chunk`);
    } else await skipElement(source, header, element);
  }
  writer.end();
}

/** Return a field of a word as a fraction of its maximum. */
const share = (word, shift, bits) => ((word >>> shift) & (2 ** bits - 1)) / (2 ** bits - 1);

async function writeRows(source, header, vertex, writer, bounds, width, kept) {
  let row = 0;
  const within = (box, first, axis, part) => {
    return bounds[box + first + axis] * (1 - part) + bounds[box + first + 3 + axis] * part;
  };
  for await (const words of columnsOf(source, header, vertex, WORDS, writer.batch)) {
    for (let i = 0; i < words.length; i += 4, row++) {
      const box = width * Math.floor(row / BOX_ROWS);
      const [position, rotation, scale, color] = [words[i], words[i + 1], words[i + 2], words[i + 3]];
      const small = (shift) => (share(rotation, shift, 10) - 0.5) * Math.SQRT2;
      setFromLargest(rotation >>> 30, small(20), small(10), small(0));
      const base = writer.place(
        within(box, 0, 0, share(position, 21, 11)), within(box, 0, 1, share(position, 11, 10)), within(box, 0, 2, share(position, 0, 11)),
        turn[0], turn[1], turn[2], turn[3],
        within(box, 6, 0, share(scale, 21, 11)), within(box, 6, 1, share(scale, 11, 10)), within(box, 6, 2, share(scale, 0, 11)),
        SHARE_LOGITS[color & 255],
      );
      for (let c = 0; c < 3; c++) {
        const part = share(color, 24 - 8 * c, 8);
        writer.appearance[base + c] = ((width > 12 ? within(box, 12, c, part) : part) - 0.5) / SH_C0;
        if (kept) kept.constants[3 * row + c] = writer.appearance[base + c];
      }
      const slot = writer.keep();
      if (kept) kept.slots[row] = slot;
    }
    await writer.flush();
  }
}

/** Send the appearance again, now that the harmonics are there: all of red, then green, then blue. */
async function writeHarmonics(source, header, sh, names, writer, { slots, constants }) {
  const stored = names.length / 3;
  const drawn = Math.min(stored, MOST_COEFFICIENTS - 1);
  let row = 0;
  for await (const bytes of columnsOf(source, header, sh, names, writer.batch)) {
    const appearance = new Float32Array((writer.stride * bytes.length) / names.length);
    let [first, used] = [-1, 0];
    for (let i = 0; i < bytes.length; i += names.length, row++) {
      if (slots[row] < 0) continue;
      if (first < 0) first = slots[row];
      const base = writer.stride * used++;
      for (let c = 0; c < 3; c++) {
        appearance[base + c] = constants[3 * row + c];
        for (let k = 0; k < drawn; k++) appearance[base + 3 + 3 * k + c] = HARMONICS[bytes[i + c * stored + k]];
      }
    }
    if (used) await writer.repeat(first, appearance.subarray(0, writer.stride * used));
  }
}
