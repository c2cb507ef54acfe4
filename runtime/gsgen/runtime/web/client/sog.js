/** Reads SOG files, versions 1 and 2 (PlayCanvas): Gaussians in lossless WebP images, zipped or beside each other. */

import { parsedJson } from "./download.js";
import { GsgenError, failing } from "./errors.js";
import { remembered } from "./once.js";
import { RowWriter, SHARE_LOGITS, setFromLargest, turn } from "./row_writer.js";

const PALETTE_WIDTH = 64; // entries in a row of the image of harmonics
const FIRST_TAG = 252; // alpha of a quaternion whose largest part is the first
const AGAIN = "Download it again, or convert it: gsgen convert FILE model.spz";

/** The images of files of which parts are read. @type {Map<string, Promise<any>>} */
const decoded = new Map();
const MOST_DECODED = 5;

/** @type {WebGL2RenderingContext | null} */
let context = null;

/**
 * Return the pixels of a WebP image, as they were stored: red, green, blue, alpha.
 *
 * A 2D canvas and ImageDecoder multiply colours by alpha, which loses bits; WebGL does not.
 */
async function pixelsOf(data, needed, fail) {
  const exact = /** @type {const} */ ({ premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const bitmap = await createImageBitmap(new Blob([data]), exact);
  const { width, height } = bitmap;
  if (width * height < needed) fail(`has an image of ${width} × ${height} pixels, expected ${needed}`);
  const gl = (context ??= new OffscreenCanvas(1, 1).getContext("webgl2") ?? fail("needs WebGL 2"));
  const [texture, framebuffer] = [gl.createTexture(), gl.createFramebuffer()];
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  gl.deleteTexture(texture);
  gl.deleteFramebuffer(framebuffer);
  bitmap.close();
  return { pixels, width, height };
}

/** Read a zipped SOG, whose archive may hold the name of its folder, too. */
export async function readSog(files, name, context) {
  const meta = [...files.keys()].filter((file) => file.split("/").pop() === "meta.json");
  const folder = meta.reduce((best, file) => (file.length < best.length ? file : best)).slice(0, -"meta.json".length);
  const fetchBytes = (file) => {
    const entry = files.get(folder + file) ?? failing(name, AGAIN)(`has no file ${file}`);
    return entry.open().rest();
  };
  await writeSog(parsedJson(await fetchBytes("meta.json")), fetchBytes, name, context);
}

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readSogMeta(source, context) {
  await writeSog(parsedJson(await source.rest()), context.beside, source.name, context);
}

async function writeSog(meta, fetchBytes, name, /** @type {import("./splat_files.js").Context} */ { sink, range }) {
  const fail = failing(name, AGAIN);
  const read = () => imagesOf(meta, fetchBytes, fail);
  try {
    await decode(meta, await (range ? remembered(decoded, name, read, MOST_DECODED) : read()), name, sink, range, fail);
  } catch (error) {
    decoded.delete(name);
    if (error instanceof GsgenError || error.name === "AbortError") throw error;
    fail(`cannot be read: ${error.message}`);
  }
}

/** Return the numbers that bytes of each channel stand for: of a codebook, or in version 1 of a range. */
function booksOf({ codebook, mins, maxs }, channels) {
  if (codebook) return Array.from({ length: channels }, () => Float32Array.from(codebook));
  const [low, high] = [[mins].flat(), [maxs].flat()];
  return low.map((least, i) => Float32Array.from({ length: 256 }, (_, byte) => least + (high[i] - least) * (byte / 255)));
}

const countOf = ({ version = 1, means, count }) => (version === 1 ? means.shape[0] : count);

/** Return the pixels of all images. */
async function imagesOf(meta, fetchBytes, fail) {
  const { version = 1, means, scales, quats, sh0, shN } = meta;
  if (version !== 1 && version !== 2) fail(`has version ${version} of SOG, expected 1 or 2`);
  const count = countOf(meta);
  const read = ({ files }, needed = count) => Promise.all(files.map(async (file) => pixelsOf(await fetchBytes(file), needed, fail)));
  // One image after the other: their pixels take more memory than their files.
  const [[low, high], [sizes], [turns], [colors]] = [await read(means), await read(scales), await read(quats), await read(sh0)].map(
    (images) => images.map(({ pixels }) => pixels),
  );
  const [palette, labels] = shN ? await read(shN, 1) : [];
  return { low, high, sizes, turns, colors, palette, labels };
}

/** Write the rows of a file, or of a part of it: from a row on, so many. */
async function decode(meta, { low, high, sizes, turns, colors, palette, labels }, name, sink, range, fail) {
  const { version = 1, means, scales, sh0, shN, antialias, model } = meta;
  const count = countOf(meta);
  // The width of a palette says its degree; version 2 repeats it.
  const higher = palette ? palette.width / PALETTE_WIDTH : 0;
  const entries = version === 1 ? PALETTE_WIDTH * (palette?.height ?? 0) : shN?.count;
  const isWhole = !shN || ([3, 8, 15].includes(higher) && higher === (shN.bands ? (shN.bands + 1) ** 2 - 1 : higher));
  const isLarge = !shN || (palette.height * PALETTE_WIDTH >= entries && labels.width * labels.height >= count);
  if (!isWhole || !isLarge) fail(`has a palette of ${palette.width} × ${palette.height} pixels for ${entries} entries`);
  const [sizeBooks, colorBooks, [harmonics]] = [booksOf(scales, 3), booksOf(sh0, 4), shN ? booksOf(shN, 1) : []];
  const logits = version === 1 ? colorBooks[3] : SHARE_LOGITS;
  const { mins, maxs } = means;
  const isMip = antialias === true || model === "antialiased";
  const [start, rows] = range ?? [0, count];
  if (start + rows > count) fail(`has ${count} splats, and a tree lists splat ${start + rows - 1}`);
  const writer = new RowWriter(sink, name, { count: rows, coefficients: 1 + higher, antialias: isMip });
  const place = (first, axis) => {
    const share = (low[first + axis] | (high[first + axis] << 8)) / 65535;
    const stored = mins[axis] * (1 - share) + maxs[axis] * share;
    return Math.sign(stored) * Math.expm1(Math.abs(stored));
  };
  const writeRow = (row) => {
    const first = 4 * row;
    const tag = turns[first + 3] - FIRST_TAG;
    const small = (i) => (turns[first + i] / 127.5 - 1) * Math.sqrt(0.5);
    if (tag < 0) turn.set([1, 0, 0, 0]);
    else setFromLargest(tag, small(0), small(1), small(2));
    const base = writer.place(
      place(first, 0), place(first, 1), place(first, 2), turn[0], turn[1], turn[2], turn[3],
      sizeBooks[0][sizes[first]], sizeBooks[1][sizes[first + 1]], sizeBooks[2][sizes[first + 2]], logits[colors[first + 3]],
    );
    for (let i = 0; i < 3; i++) writer.appearance[base + i] = colorBooks[i][colors[first + i]];
    if (higher) {
      const label = labels.pixels[first] + 256 * labels.pixels[first + 1];
      if (label >= entries) fail(`has the palette label ${label}, expected 0 to ${entries - 1}`);
      for (let k = 0; k < higher; k++) {
        const pixel = 4 * (label * higher + k);
        for (let i = 0; i < 3; i++) writer.appearance[base + 3 + 3 * k + i] = harmonics[palette.pixels[pixel + i]];
      }
    }
    writer.keep();
  };
  for (let row = start; row < start + rows; row++) {
    writeRow(row);
    if (writer.used === writer.batch) await writer.flush();
  }
  await writer.flush();
  writer.end();
}
