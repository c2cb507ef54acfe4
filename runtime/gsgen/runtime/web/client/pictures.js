/**
 * Pictures that a generator computes its Gaussians from, as the contract feeds them: cropped to the
 * shape of the input, resampled by a triangle filter, over the input's background.
 */

import { viewOf } from "./camera.js";
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

/** Return the part of a picture that an input shows: pixels per pixel of the input, left and upper edge. */
function partOf({ width, height }, [rows, columns]) {
  const scale = Math.min(width / columns, height / rows);
  return { scale, left: (width - scale * columns) / 2, top: (height - scale * rows) / 2 };
}

/**
 * Return a picture as values of an input, [3, rows, columns].
 * @param {Pixels} pixels
 * @param {number[]} size Rows and columns.
 * @param {{background?: number[], range?: number[]}} spec
 */
export function fittedPicture(pixels, [rows, columns], { background = [0, 0, 0], range = [0, 1] }) {
  const { data, width, height } = pixels;
  const { scale, left, top } = partOf(pixels, [rows, columns]);
  const [across, down] = [triangles(width, columns, scale, left), triangles(height, rows, scale, top)];
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

/** Return the camera of a frame of a transforms.json, whose axes are those of OpenGL. */
function cameraOfFrame({ file_path: name, transform_matrix: m, w, h, ...frame }) {
  const focal = (...axes) => {
    const [length] = axes.flatMap((axis) => {
      const angle = frame[`camera_angle_${axis}`];
      return frame[`fl_${axis}`] ?? (angle ? { x: w, y: h }[axis] / 2 / Math.tan(angle / 2) : []);
    });
    return length;
  };
  const turn = [0, 1, 2].flatMap((axis) => [0, 1, 2].map((row) => (axis ? -1 : 1) * m[row][axis]));
  const view = viewOf(turn, [m[0][3], m[1][3], m[2][3]]);
  const isPinhole = !frame.is_fisheye && !/FISHEYE|EQUIRECTANGULAR/i.test(frame.camera_model ?? "");
  const { cx = w / 2, cy = h / 2 } = frame;
  const kind = isPinhole ? "pinhole" : "fisheye";
  return { name, view, fx: focal("x", "y"), fy: focal("y", "x"), cx, cy, width: w, height: h, kind };
}

/**
 * Return the cameras of pictures, by their names or in order, in the pixels of an input.
 * @param {string} address Of a transforms.json, or of cameras as gsgen writes them.
 * @param {(Blob | string)[]} sources The pictures.
 * @param {Pixels[]} pictures
 * @param {[number, number]} size Rows and columns of the input.
 * @returns {Promise<{image_view: number[], image_intrinsics: number[]}>}
 */
export async function pictureCameras(address, sources, pictures, size) {
  const fail = failing(address, "Give a transforms.json, or cameras as gsgen writes them.");
  const document = await new Response(await download(address)).json().catch((error) => fail(`is no JSON: ${error.message}`));
  const [{ width: w, height: h }] = pictures;
  const read = () => document.frames?.map((frame) => cameraOfFrame({ w, h, ...document, ...frame })) ?? [document].flat();
  /** @type {any[]} */
  let cameras = [];
  try { cameras = read(); } catch { fail("has a frame without a transform_matrix"); }
  const stem = (name) => decodeURIComponent(String(name).split(/[?#]/)[0].replace(/^.*\//, "")).replace(/\.[^.]*$/, "");
  const byName = new Map(cameras.map((camera, i) => [stem(camera.name ?? i), camera]));
  const named = sources.map((source) => byName.get(stem(source instanceof File ? source.name : source)));
  if (named.every(Boolean)) cameras = named;
  if (cameras.length !== sources.length) fail(`has ${cameras.length} cameras for ${sources.length} pictures of other names`);
  const result = { image_view: [], image_intrinsics: [] };
  cameras.forEach(({ view, fx, fy, cx, cy, width, height, kind = "pinhole" }, i) => {
    const [picture, matrix] = [pictures[i], [view].flat(2)];
    const { scale, left, top } = partOf(picture, size);
    const [across, down] = [picture.width / width, picture.height / height];
    const lens = [(fx * across) / scale, 0, (cx * across - left) / scale, 0, (fy * down) / scale, (cy * down - top) / scale, 0, 0, 1];
    if (matrix.length !== 16 || ![...matrix, ...lens].every(Number.isFinite)) fail(`has no lens or view for picture ${i}`);
    if (kind !== "pinhole") fail(`has a ${kind} camera for picture ${i}, expected one with perspective`);
    if (Math.abs(width * picture.height - height * picture.width) > Math.max(width, height)) {
      fail(`has a camera of ${width}×${height} pixels, but picture ${i} has ${picture.width}×${picture.height}`);
    }
    result.image_view.push(...matrix);
    result.image_intrinsics.push(...lens);
  });
  return result;
}

/** Read the pictures of an input. @param {any} spec @param {number} count @param {(Blob | string)[]} sources */
export async function readPictures(spec, count, sources) {
  if (sources.length !== count) {
    throw new GsgenError(`has ${sources.length} pictures, expected ${count}`, { where: `input ${spec.name}` });
  }
  return Promise.all(sources.map(pixelsOf));
}
