/** Reads SOG files, version 2 (PlayCanvas): Gaussians in lossless WebP images, in a zip archive. */

import { parsedJson } from "./download.js";
import { GsgenError, failing } from "./errors.js";
import { RowWriter, inflated, withLargest } from "./splat_files.js";

const [END, END_BYTES, ENTRY_BYTES, HEADER_BYTES] = [0x06054b50, 22, 46, 30]; // of zip archives
const PALETTE_WIDTH = 64; // entries in a row of the image of harmonics
const FIRST_TAG = 252; // alpha of a quaternion whose largest part is the first

/** Return the packed files of a zip archive by name: their bytes, and whether they are deflated. */
function filesOf(data, fail) {
  const view = new DataView(data);
  let end = data.byteLength - END_BYTES;
  while (end >= 0 && view.getUint32(end, true) !== END) end--;
  if (end < 0) fail("is a zip archive without a directory");
  const files = new Map();
  let entry = view.getUint32(end + 16, true);
  for (let index = 0; index < view.getUint16(end + 10, true); index++) {
    const [method, length, ...others] = [10, 28, 30, 32].map((i) => view.getUint16(entry + i, true));
    const [size, local] = [20, 42].map((i) => view.getUint32(entry + i, true));
    const file = new TextDecoder().decode(new Uint8Array(data, entry + ENTRY_BYTES, length));
    const lengths = [26, 28].map((i) => view.getUint16(local + i, true));
    const first = local + HEADER_BYTES + lengths[0] + lengths[1];
    files.set(file, { bytes: data.slice(first, first + size), isDeflated: method === 8 });
    entry += ENTRY_BYTES + length + others[0] + others[1];
  }
  return files;
}

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
  return pixels;
}

/** Return the quaternion w, x, y, z of a pixel, whose alpha names the largest part. */
function quaternionOf(pixels, first) {
  const tag = pixels[first + 3] - FIRST_TAG;
  if (tag < 0) return [1, 0, 0, 0];
  const parts = [0, 1, 2].map((i) => (pixels[first + i] / 127.5 - 1) * Math.SQRT1_2);
  return withLargest(tag, parts);
}

/** @returns {Promise<import("./splat_buffers.js").Splats>} */
export async function readSog(data, name) {
  const fail = failing(name, "Download it again, or convert it: gsgen convert FILE model.spz");
  try {
    return await decoded(data, name, fail);
  } catch (error) {
    if (error instanceof GsgenError) throw error;
    return fail(`cannot be read: ${error.message}`);
  }
}

async function decoded(data, name, fail) {
  const files = filesOf(data, fail);
  const contentOf = (file) => {
    const { bytes, isDeflated } = files.get(file) ?? fail(`has no file ${file}`);
    return isDeflated ? inflated(bytes, name, "deflate-raw") : bytes;
  };
  const meta = parsedJson(await contentOf("meta.json"));
  const { version, count, means, scales, quats, sh0, shN, antialias, model } = meta;
  if (version !== 2) fail(`has version ${version} of SOG, expected 2`);
  const higher = shN ? (shN.bands + 1) ** 2 - 1 : 0;
  const images = [...means.files, ...scales.files, ...quats.files, ...sh0.files, ...(shN?.files ?? [])];
  const [low, high, sizes, turns, colors, palette, labels] = await Promise.all(
    images.map(async (file) => {
      const needed = file === shN?.files[0] ? PALETTE_WIDTH * higher * Math.ceil(shN.count / PALETTE_WIDTH) : count;
      return pixelsOf(await contentOf(file), needed, fail);
    }),
  );
  const writer = new RowWriter(count, 1 + higher);
  for (let row = 0; row < count; row++) {
    const first = 4 * row;
    const center = [0, 1, 2].map((i) => {
      const share = (low[first + i] + 256 * high[first + i]) / 65535;
      const stored = means.mins[i] * (1 - share) + means.maxs[i] * share;
      return Math.sign(stored) * Math.expm1(Math.abs(stored));
    });
    const scale = [0, 1, 2].map((i) => scales.codebook[sizes[first + i]]);
    writer.set(row, center, colors[first + 3] / 255, scale, quaternionOf(turns, first));
    const base = row * writer.channels;
    for (let i = 0; i < 3; i++) writer.appearance[base + i] = sh0.codebook[colors[first + i]];
    if (!higher) continue;
    const label = labels[first] + 256 * labels[first + 1];
    if (label >= shN.count) fail(`has the palette label ${label}, expected 0 to ${shN.count - 1}`);
    for (let i = 3; i < writer.channels; i++) {
      const pixel = label * higher + Math.floor(i / 3) - 1;
      writer.appearance[base + i] = shN.codebook[palette[4 * pixel + (i % 3)]];
    }
  }
  return writer.splats(antialias === true || model === "antialiased" ? "mip" : "classic");
}
