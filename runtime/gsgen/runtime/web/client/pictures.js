/**
 * Pictures that a generator computes its Gaussians from, as the contract feeds them: cropped to the
 * shape of the input, resampled by a triangle filter, over the input's background.
 */

import { download } from "./download.js";
import { failing, GsgenError } from "./errors.js";

/**
 * RGB and alpha of pixels, not multiplied by it, from 0 to 255.
 * @typedef {{data: ArrayLike<number>, width: number, height: number}} Pixels
 */

/** Return the share of each source pixel in each target pixel along one axis. */
function triangles(source, target, scale, start) {
  const radius = Math.max(scale, 1);
  return Array.from({ length: target }, (_, pixel) => {
    const center = start + scale * (pixel + 0.5);
    const first = Math.max(Math.floor(center - radius - 0.5), 0);
    const last = Math.min(Math.ceil(center + radius), source - 1);
    const weights = [];
    for (let i = first; i <= last; i++) weights.push(Math.max(0, 1 - Math.abs(i + 0.5 - center) / radius));
    const sum = weights.reduce((a, b) => a + b, 0);
    return { first, weights: weights.map((weight) => weight / sum) };
  });
}

/**
 * Return a picture as values of an input, [3, rows, columns].
 * @param {Pixels} pixels
 * @param {number[]} size Rows and columns.
 * @param {{background?: number[], range?: number[]}} spec
 */
export function fittedPicture({ data, width, height }, [rows, columns], { background = [0, 0, 0], range = [0, 1] }) {
  const scale = Math.min(width / columns, height / rows);
  const across = triangles(width, columns, scale, (width - scale * columns) / 2);
  const down = triangles(height, rows, scale, (height - scale * rows) / 2);
  const [low, high] = range;
  const values = new Float32Array(3 * rows * columns);
  const line = new Float64Array(width);
  for (let channel = 0; channel < 3; channel++) {
    for (let row = 0; row < rows; row++) {
      const { first, weights } = down[row];
      line.fill(0);
      weights.forEach((weight, i) => {
        for (let x = 0, at = 4 * (first + i) * width; x < width; x++, at += 4) {
          const alpha = data[at + 3] / 255;
          line[x] += weight * ((alpha * data[at + channel]) / 255 + (1 - alpha) * background[channel]);
        }
      });
      across.forEach((share, column) => {
        const mean = share.weights.reduce((sum, weight, i) => sum + weight * line[share.first + i], 0);
        values[(channel * rows + row) * columns + column] = low + (high - low) * Math.min(Math.max(mean, 0), 1);
      });
    }
  }
  return values;
}

/** Return the pixels of a picture, upright. @param {Blob | string} source A file or an address. */
async function pixelsOf(source) {
  const name = source instanceof File ? source.name : String(source);
  const blob = source instanceof Blob ? source : new Blob([await download(source)]);
  const options = /** @type {const} */ ({ premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const bitmap = await createImageBitmap(blob, options).catch(() =>
    failing(name)("is no picture that this browser reads", "Save it as PNG or JPEG."),
  );
  const { width, height } = bitmap;
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  if (!context) throw new GsgenError("the browser gives no canvas to read pictures with");
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  return context.getImageData(0, 0, width, height);
}

/**
 * Return the values of an input of pictures.
 * @param {any} spec The input, as its manifest declares it.
 * @param {number[]} shape
 * @param {(Blob | string)[]} sources
 */
export async function pictureValues(spec, shape, sources) {
  const [count, , rows, columns] = shape;
  if (sources.length !== count) {
    throw new GsgenError(`has ${sources.length} pictures, expected ${count}`, { where: `input ${spec.name}` });
  }
  const pictures = await Promise.all(sources.map(pixelsOf));
  const values = new Float32Array(count * 3 * rows * columns);
  pictures.forEach((pixels, i) => values.set(fittedPicture(pixels, [rows, columns], spec), i * 3 * rows * columns));
  return values;
}
