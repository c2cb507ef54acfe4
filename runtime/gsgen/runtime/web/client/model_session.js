/**
 * Runs a model: in a captured graph where that is right, its constant outputs once.
 *
 * ONNX Runtime folds what depends on no input, and a captured graph does not write it. Such outputs
 * (most often the colours and the count) come from one run that is not captured.
 */

import { GsgenError, failing } from "./errors.js";
import { GeneratorInputs, gpuTensors } from "./generator_inputs.js";
import { storageBuffer } from "./gpu_buffers.js";
import { onnxRuntime, openSession, runInTurn } from "./onnx_runtime.js";

/** @typedef {{type: string, dims: readonly number[], gpuBuffer: GPUBuffer}} GpuTensor */

const BYTES = { float32: 4, float16: 2, int32: 4, uint32: 4, int64: 8 };

export class ModelSession {
  /**
   * @param {any} kernels Whose device it runs on.
   * @param {any} inspected What rules say of the model; see `Inspected` of findings.js.
   * @param {Record<string, number>} [sizes] Of open dimensions.
   */
  static async open({ device }, bytes, inspected, name, sizes) {
    const { manifest, outputs: all } = /** @type {import("./findings.js").Inspected} */ (inspected);
    const ort = await onnxRuntime();
    const constant = all.filter(({ varies }) => !varies).map((output) => output.name);
    const open = (capture) => openSession(ort, device, bytes, name, capture, sizes);
    const isStill = constant.length === all.length;
    // A buffer copy is not recorded: its output is stale in all frames but the first.
    const isStale = all.some(({ varies, isCopied }) => varies && isCopied);
    const captured = isStill || isStale ? null : await open(true);
    const plain = captured && !constant.length ? null : await open(false);
    if ((await ort.env.webgpu.device) !== device) {
      throw new GsgenError("ONNX Runtime Web took another device than the page's", { where: name });
    }
    const inputs = new GeneratorInputs(captured ?? plain, manifest, gpuTensors(ort, device));
    const runs = { isCaptured: Boolean(captured), isStill };
    const session = new ModelSession(device, captured ?? plain, inputs, name, runs);
    if (plain && (captured || isStill)) {
      const outputs = await session._run(plain);
      for (const output of constant) session._keep(output, outputs[output]);
      for (const tensor of Object.values(outputs)) tensor.dispose();
      plain.release();
    }
    return session;
  }

  constructor(device, session, inputs, name, { isCaptured, isStill }) {
    this._device = device;
    this._session = session;
    this.inputs = inputs;
    this.isCaptured = isCaptured;
    this._isStill = isStill;
    this._name = name;
    /** @type {Record<string, GpuTensor>} */
    this._constants = {};
    this._outputs = null;
    this._lacksHalf = false; // of a session that failed once, later runs fail in other words
  }

  /** Run a frame; return its outputs by name. @returns {Promise<Record<string, GpuTensor>>} */
  async run() {
    if (this._isStill) return this._constants;
    const last = this._outputs;
    this._outputs = await this._run(this._session);
    // A captured graph writes the same buffers in every frame, any other session new ones.
    if (last && !this.isCaptured) for (const tensor of Object.values(last)) tensor.dispose();
    return { ...this._outputs, ...this._constants };
  }

  async _run(session) {
    try {
      return await runInTurn(() => session.run(this.inputs.feeds));
    } catch (error) {
      this._lacksHalf ||= /requires f16|float16/.test(error.message) && !this._device.features.has("shader-f16");
      if (this._lacksHalf) failing(this._name)("computes in float16, which this graphics device does not", "Export it with --dtype float32.");
      const hint = "See what is wrong: gsgen validate MODEL --target webgpu";
      throw new GsgenError(`the model fails: ${error.message}`, { where: this._name, hint });
    }
  }

  /** Copy an output into a buffer of its own. */
  _keep(output, { type, dims, gpuBuffer }) {
    const numbers = dims.reduce((a, b) => a * b, 1);
    const buffer = storageBuffer(this._device, `constant ${output}`, numbers * BYTES[type]);
    const encoder = this._device.createCommandEncoder({ label: "constants" });
    encoder.copyBufferToBuffer(gpuBuffer, 0, buffer, 0, Math.min(buffer.size, gpuBuffer.size));
    this._device.queue.submit([encoder.finish()]);
    this._constants[output] = { type, dims, gpuBuffer: buffer };
  }

  destroy() {
    for (const { gpuBuffer } of Object.values(this._constants)) gpuBuffer.destroy();
    this.inputs.destroy();
    if (!this._isStill) this._session.release();
  }
}
