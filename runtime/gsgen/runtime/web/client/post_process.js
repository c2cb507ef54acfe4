/**
 * Post-process models: networks that change the colours of a drawn frame, in GPU memory.
 *
 * A network sees sRGB colours that are not multiplied by alpha, in its own range. One of a fixed
 * size runs tile by tile, and the results are blended, as Python does it.
 */

import { failing } from "./errors.js";
import { inspectedModel } from "./findings.js";
import { readBuffer, storageBuffer, uniformBuffer } from "./gpu_buffers.js";
import { encodePass } from "./host.js";
import { checkInputs, inputsAt } from "./key_frames.js";
import { ModelSession } from "./model_session.js";
import { download } from "./download.js";
import { UniformWriter } from "./uniforms.js";

const PIXEL = 16; // bytes
const MOST_GROUPS = 65535; // of a dispatch along an axis

/** An image in GPU memory. @typedef {{image: GPUBuffer, isLinear: boolean, backgroundAlpha: number}} Picture */
/**
 * What a picture goes through.
 * @typedef {object} Post
 * @property {string} address
 * @property {string} where It is named, for messages.
 * @property {Record<string, any>} inputs Values of its inputs, or key frames.
 */

/** Round to the nearest whole number, and halves to the even one, as Python does. */
function rounded(number) {
  const nearest = Math.round(number);
  return nearest - number === 0.5 && nearest % 2 ? nearest - 1 : nearest;
}

/** Return the first pixel of each tile along an axis, and the weights of its pixels, which sum to 1. */
export function tilesAlong(length, size, overlap) {
  const room = Math.max(length - size, 0);
  const count = 1 + Math.ceil(room / (size - overlap));
  const starts = Array.from({ length: count }, (_, i) => (count > 1 ? rounded((i * room) / (count - 1)) : 0));
  const ramp = Array.from({ length: size }, (_, i) => Math.min(Math.min(i + 1, size - i) / (overlap + 1), 1));
  const total = new Float64Array(length + size);
  for (const start of starts) ramp.forEach((weight, i) => (total[start + i] += weight));
  return starts.map((start) => ({ start, weights: ramp.map((weight, i) => weight / total[start + i]) }));
}

/** A post-process model, with a session for images of the last size. */
class PostProcess {
  static async open(kernels, /** @type {Post} */ { address, where, inputs }, target, signal) {
    const bytes = new Uint8Array(await download(address, undefined, signal));
    const inspected = inspectedModel(bytes, where, target, "post-process");
    checkInputs(inputs, inspected.manifest, where);
    return new PostProcess(kernels, bytes, inspected, inputs, where);
  }

  constructor(kernels, bytes, inspected, values, where) {
    const { manifest } = inspected;
    this._kernels = kernels;
    this._bytes = bytes;
    this._inspected = inspected;
    this._manifest = manifest;
    this._values = values;
    this._where = where;
    this._image = manifest.inputs.find(({ role }) => role === "image").name;
    this.inputs = manifest.inputs.filter(({ name }) => name !== this._image);
    this._dims = inspected.inputs.find(({ name }) => name === this._image).dims;
    this._size = "";
    /** @type {ModelSession | null} */
    this._session = null;
    /** @type {Record<string, GPUBuffer>} */
    this._own = {};
  }

  /** Open a session for images of a size, unless it is open. */
  async _open(width, height) {
    const { _kernels: kernels, _dims: [, , ...sides] } = this;
    const size = sides.every(Number.isInteger) ? "any" : `${width}×${height}`;
    if (size === this._size) return;
    this.destroy();
    const sizes = Object.fromEntries([height, width].flatMap((side, i) => (Number.isInteger(sides[i]) ? [] : [[sides[i], side]])));
    this._session = await ModelSession.open(kernels, this._bytes, this._inspected, this._where, sizes);
    this._size = size;
    const { device, plans } = kernels;
    const [, , rows, columns] = this._session.inputs.shape(this._image);
    this._own = {
      region: uniformBuffer(device, "region", plans.uniforms.region.size),
      weights: storageBuffer(device, "weights of a tile", 4 * (rows + columns)),
      faults: storageBuffer(device, "faults", 4),
    };
  }

  /**
   * Run on a picture, and make an image of the result.
   * @param {Picture} seen
   * @param {GPUBuffer} image
   * @param {Record<string, any>} values By name or role.
   * @param {number} seconds Of the timeline that key frames follow.
   * @returns {Promise<Picture>}
   */
  async run(seen, width, height, image, values, seconds) {
    await this._open(width, height);
    const session = /** @type {ModelSession} */ (this._session);
    const { _kernels: kernels, _own: { region, weights, faults }, _manifest: manifest, _image: input } = this;
    const { device, plans } = kernels;
    const { name, range: [black, white] = [0, 1], color_space: space } = manifest.outputs.image;
    const { type, dims: [, channels, rows, columns], gpuBuffer: tensor } = session.inputs.feeds[input];
    const tile = [columns, rows];
    const [keyed, fixed] = inputsAt(this._values, seconds, this);
    session.inputs.update({ ...keyed, ...values, ...fixed });
    const [low, high] = manifest.image_range ?? [0, 1];
    const shared = { size: [width, height], tile, is_linear: Number(seen.isLinear), background_alpha: seen.backgroundAlpha };
    const describe = (fields) => {
      const uniform = new UniformWriter(plans.uniforms.region);
      uniform.write({ ...shared, ...fields });
      device.queue.writeBuffer(region, 0, uniform.bytes);
    };
    const submit = (step) => {
      const encoder = device.createCommandEncoder({ label: "post-process" });
      encodePass(encoder, "post-process", [step]);
      device.queue.submit([encoder.finish()]);
    };
    const bound = (...buffers) => buffers.map((buffer) => ({ buffer }));
    const encoder = device.createCommandEncoder({ label: "post-process" });
    for (const buffer of [image, faults]) encoder.clearBuffer(buffer);
    device.queue.submit([encoder.finish()]);
    const words = (channels * rows * columns) / (type === "float16" ? 2 : 1);
    const groups = Math.ceil(words / plans.posts.threads);
    const counts = { groups, rows: Math.ceil(groups / MOST_GROUPS) };
    const fill = await kernels.step(plans.posts.kernels[type].fill, counts, bound(region, seen.image, tensor));
    const overlap = Math.min(plans.posts.overlap, Math.floor((Math.min(...tile) - 1) / 2));
    const [across, down] = [width, height].map((length, axis) => tilesAlong(length, tile[axis], overlap));
    let result, kinds;
    for (const row of down) {
      for (const column of across) {
        const corner = [column.start, row.start];
        device.queue.writeBuffer(weights, 0, Float32Array.from([...column.weights, ...row.weights]));
        describe({ corner, channels, low, high });
        submit(fill);
        result = (await session.run())[name];
        const [one, outputs, ...sides] = result.dims;
        if (one !== 1 || ![3, 4].includes(outputs) || sides.join() !== [rows, columns].join()) {
          failing(this._where)(`returned [${result.dims}], expected [1, 3 or 4, ${rows}, ${columns}]`);
        }
        describe({ corner, channels: outputs, low: black, high: white });
        kinds = plans.posts.kernels[result.type];
        submit(await kernels.step(kinds.add, { width: columns, height: rows }, bound(region, image, result.gpuBuffer, weights, faults)));
      }
    }
    const own = bound(region, image, result.gpuBuffer, weights, faults);
    submit(await kernels.step(kinds.finish, { width, height }, own, bound(seen.image)));
    const [count] = await readBuffer(device, faults, Uint32Array, 1);
    if (count) failing(this._where)(`returned ${count} numbers that are not finite`);
    return { image, isLinear: space === "linear", backgroundAlpha: 0 };
  }

  destroy() {
    this._session?.destroy();
    for (const buffer of Object.values(this._own)) buffer.destroy();
    [this._session, this._size, this._own] = [null, "", {}];
  }
}

/** The post-process models that pictures go through, in order. */
export class Posts {
  /** @param {Post[]} posts @param {string} target Whose limits rules check. @param {AbortSignal} signal */
  static async open(kernels, posts, target, signal) {
    return new Posts(kernels.device, await Promise.all(posts.map((post) => PostProcess.open(kernels, post, target, signal))));
  }

  /** @param {GPUDevice} device @param {PostProcess[]} models */
  constructor(device, models) {
    this._device = device;
    this._models = models;
    /** @type {(GPUBuffer | null)[]} One is seen while the other is made. */
    this._images = [null, null];
  }

  get inputs() {
    return this._models.flatMap(({ inputs }) => inputs);
  }

  /** Return what comes of a picture; see `PostProcess.run`. @param {Picture} picture @returns {Promise<Picture>} */
  async run(picture, width, height, values, seconds) {
    for (const [index, model] of this._models.entries()) {
      const image = this._imageOf(index % 2, PIXEL * width * height);
      picture = await model.run(picture, width, height, image, values, seconds);
    }
    return picture;
  }

  _imageOf(index, bytes) {
    const known = this._images[index];
    if (known && known.size >= bytes) return known;
    known?.destroy();
    return (this._images[index] = storageBuffer(this._device, `processed image ${index}`, bytes));
  }

  destroy() {
    for (const model of this._models) model.destroy();
    for (const image of this._images) image?.destroy();
  }
}
