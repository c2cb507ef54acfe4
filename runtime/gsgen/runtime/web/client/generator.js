/**
 * Generators: ONNX models that compute Gaussians in every frame, in the buffers that are drawn.
 *
 * A captured session writes the same buffers in every frame. Pages bind them as they are, or a
 * kernel copies rows that no page can bind, such as three float32 numbers.
 */

import { failing } from "./errors.js";
import { surveyedExtent, timeOf, upOf } from "./generator_inputs.js";
import { ModelSession } from "./model_session.js";
import { readBuffer, storageBuffer } from "./gpu_buffers.js";
import { encodePass } from "./host.js";
import { IDENTITY } from "./matrices.js";
import { fittedPicture, pictureCameras, readPictures } from "./pictures.js";
import { appearanceKind, degreeOf, pagesOf } from "./splat_buffers.js";

/** The outputs of a session as pages. */
class GeneratorBuffers {
  /** @param {import("./host.js").KernelCache} kernels @param {Record<string, any>} manifest */
  constructor(kernels, manifest) {
    this._kernels = kernels;
    this._manifest = manifest;
    this.pages = [];
    this.capacity = this.count = manifest.outputs.gaussians.capacity;
    this.antialias = manifest.antialias ?? "classic";
    this.isLinear = manifest.outputs.appearance.color_space === "linear";
    this.degree = null;
    const { cells } = manifest.outputs;
    /** Weights of sums cell by cell; null if Gaussians are sorted. */
    this.weighted =
      cells && manifest.blend === "wsr" ? { ...manifest.weighted_sum, perCell: cells.per_cell } : null;
    /** @type {GPUBuffer | null} */
    this.liveCounts = null;
    this._commands = [];
    this._own = [];
    this._bound = "";
  }

  /**
   * Bind the outputs of a run; return whether the pages are others than before.
   * @param {Record<string, any>} outputs Tensors by name.
   */
  async bind(outputs) {
    const { gaussians, appearance, count, cells } = this._manifest.outputs;
    const specs = [gaussians, appearance, count, this.weighted && cells];
    const tensors = specs.map((spec) => spec && outputs[spec.name]);
    const buffers = tensors.map((tensor) => tensor?.gpuBuffer);
    if (this._last?.every((buffer, i) => buffer === buffers[i])) return false;
    this.destroy();
    const [rows, colors, live, cellRows] = tensors;
    const { plans } = this._kernels;
    const channels = colors.dims[1];
    this.degree = degreeOf(channels, appearance.space);
    const storage = appearanceKind(plans, channels, colors.type);
    const bound = await Promise.all([this._bindable("rows", rows), this._bindable("appearance", colors)]);
    this.pages = pagesOf(plans, storage, bound[0], bound[1], this.capacity);
    if (cellRows) {
      const own = { cells: await this._bindable("rows", cellRows), setCells: cellRows.dims[0] };
      for (const page of this.pages) Object.assign(page, own);
    }
    if (live) await this._countLive(live);
    this._last = buffers;
    return true;
  }

  /** Return a tensor's buffer, or one that a kernel fills with its rows in every frame. */
  async _bindable(target, { type, dims, gpuBuffer }) {
    const { plans, device } = this._kernels;
    const entry = plans.generators.repacks.find(
      (row) => row.target === target && row.dtype === type && row.columns === dims[1],
    );
    if (!entry) return gpuBuffer;
    const buffer = storageBuffer(device, `repacked ${target}`, 4 * entry.words * dims[0]);
    this._own.push(buffer);
    const bytes = Math.ceil((dims[0] * dims[1] * (type === "float16" ? 2 : 4)) / 4) * 4;
    await this._add(entry, dims[0], { buffer: gpuBuffer, size: bytes }, { buffer });
    return buffer;
  }

  async _countLive(tensor) {
    const { plans, device } = this._kernels;
    this.liveCounts = storageBuffer(device, "live rows", 4 * this.pages.length);
    this._own.push(this.liveCounts);
    const source = { buffer: tensor.gpuBuffer, size: 4 };
    await this._add(plans.generators.live_counts, 1, source, { buffer: this.liveCounts });
  }

  async _add(kernel, capacity, ...resources) {
    this._commands.push(await this._kernels.step(kernel, { capacity }, resources));
  }

  /** Encode the copies of a frame. @param {GPUCommandEncoder} encoder */
  encode(encoder) {
    if (this._commands.length) encodePass(encoder, "outputs of a generator", this._commands);
  }

  destroy() {
    for (const buffer of this._own) buffer.destroy();
    [this._own, this._commands, this.liveCounts, this._last] = [[], [], null, null];
  }
}

/** A generator in a page. */
export class GeneratorModel {
  /**
   * @param {any} kernels
   * @param {import("./splat_files.js").FileContent} content
   * @param {string} name
   * @param {{pictures?: (Blob | string)[], imageCameras?: string}} [options]
   */
  static async open(kernels, content, name, { pictures = [], imageCameras = "" } = {}) {
    if (kernels.openGenerator) return kernels.openGenerator(content, name); // without WebGPU
    const { bytes, inspected } = content;
    if (!inspected) return failing(name)("was not checked");
    const session = await ModelSession.open(kernels, bytes, inspected, name);
    const model = new GeneratorModel(kernels, session, inspected.manifest);
    model.findings = inspected.findings;
    if (pictures.length) await model._takePictures(pictures, imageCameras, name);
    model.extent = await surveyedExtent(model, () => model._liveRows());
    return model;
  }

  constructor(kernels, session, manifest) {
    this._kernels = kernels;
    this._session = session;
    this.manifest = manifest;
    this.isCaptured = session.isCaptured;
    this._inputs = session.inputs;
    this.buffers = new GeneratorBuffers(kernels, manifest);
    this.sets = [{ buffers: this.buffers, transform: IDENTITY }];
    this.inputs = manifest.inputs;
    this.followsCamera = this._inputs.followsCamera;
    this.up = upOf(manifest);
    this.time = timeOf(manifest.inputs);
    this.findings = [];
    this.extent = { center: [0, 0, 0], half: [1, 1, 1], reach: 1 };
    this._hasRun = false;
    this.hasPictures = false;
  }

  /** Compute the Gaussians of a frame; return whether the pages are others than before. */
  async update(values, camera) {
    const isChanged = this._inputs.update(values, camera);
    if (!isChanged && this._hasRun) return false;
    return this._run();
  }

  /** Compute from pictures, from now on, and their cameras. @param {(Blob | string)[]} sources Files or addresses. */
  async _takePictures(sources, cameras, where) {
    const spec = this.inputs.find(({ role }) => role === "image");
    if (!spec) failing(where)("is not computed from pictures", "Leave out the attribute images.");
    const [count, , rows, columns] = this._inputs.shape(spec.name);
    const pictures = await readPictures(spec, count, sources);
    const values = new Float32Array(count * 3 * rows * columns);
    pictures.forEach((pixels, i) => values.set(fittedPicture(pixels, [rows, columns], spec), i * 3 * rows * columns));
    this._inputs.write(spec.name, values);
    if (cameras) {
      if (!this.inputs.some(({ role }) => role === "image_view")) failing(where)("assumes cameras of its own", "Leave out the attribute image-cameras.");
      this._inputs.update(await pictureCameras(cameras, sources, pictures, [rows, columns]));
    }
    this.hasPictures = true;
  }

  /** How many pictures the model needs before it can be shown; 0 with them, or without such inputs. */
  get missingPictures() {
    const spec = this.inputs.find(({ role }) => role === "image");
    return spec && !this.hasPictures ? this._inputs.shape(spec.name)[0] : 0;
  }

  async _run() {
    this._outputs = await this._session.run();
    this._hasRun = true;
    return this.buffers.bind(this._outputs);
  }

  /** Read the live rows back; only before the first picture. */
  async _liveRows() {
    const { gaussians, count } = this.manifest.outputs;
    const tensor = this._outputs[gaussians.name];
    /** @type {(output: any, Numbers: any, size: number) => Promise<any>} */
    const read = (output, Numbers, size) => readBuffer(this._kernels.device, output.gpuBuffer, Numbers, size);
    const live = count ? (await read(this._outputs[count.name], Int32Array, 1))[0] : tensor.dims[0];
    const Numbers = tensor.type === "float16" ? Float16Array : Float32Array;
    return { rows: await read(tensor, Numbers, 10 * tensor.dims[0]), count: Math.max(live, 0) };
  }

  destroy() {
    this.buffers.destroy();
    this._session.destroy();
  }
}
