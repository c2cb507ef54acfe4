/**
 * Frames of a model as arrays, for renderers of other engines: `open(address)`, then `run(values)`.
 *
 * Generators run by ONNX Runtime Web, on the GPU or by WebAssembly in one thread; a splat file is
 * one frame. Rows are the contract's: x y z opacity xx xy xz yy yz zz, ten float32 numbers each.
 */

import { GsgenError, failing } from "./errors.js";
import { GeneratorInputs, pageTensors, timeOf, upOf } from "./generator_inputs.js";
import { readParts } from "./file_reader.js";
import { IDENTITY } from "./matrices.js";
import { createSession, onnxRuntime, runInTurn } from "./onnx_runtime.js";
import { sourceFile } from "./source_files.js";

/**
 * The Gaussians of one moment; the next run may write the same arrays.
 * @typedef {object} Frame
 * @property {Float32Array} rows Ten numbers of each of `capacity` rows.
 * @property {Float32Array} appearance SH by coefficient, or RGB: `channels` numbers of each row.
 *     The same array as before has the same numbers.
 * @property {number} live Number of rows that are drawn, which are the first.
 */
/**
 * @typedef {object} Frames
 * @property {number} capacity Most rows of a frame.
 * @property {number} channels
 * @property {"sh" | "rgb"} space
 * @property {"srgb" | "linear"} colorSpace
 * @property {"classic" | "mip"} antialias
 * @property {any[]} inputs As the manifest declares them.
 * @property {ReturnType<typeof timeOf>} time The input that is the model's time.
 * @property {readonly number[]} transform From the axes of the rows to the world, 4×4 row by row.
 * @property {number[]} up
 * @property {boolean} followsCamera
 * @property {any} manifest Null of splat files.
 * @property {any[]} findings
 * @property {(values?: Record<string, any>, camera?: import("./camera.js").Camera) => Promise<Frame>} run
 *     Computes a frame of values by name or role; inputs without a value keep their last one.
 * @property {() => void} destroy
 */

const PROVIDERS = ["webgpu", "wasm"];

/**
 * Open a model from its address.
 * @param {string} address
 * @param {{provider?: "webgpu" | "wasm"}} [options] What computes frames of generators.
 * @returns {Promise<Frames>}
 */
export async function open(address, options) {
  return framesOf(sourceFile(address).request(address), options);
}

/**
 * Open a model.
 * @param {import("./splat_files.js").Request} request
 * @param {{provider?: "webgpu" | "wasm", onProgress?: (loaded: number, total: number) => void, signal?: AbortSignal}} [options]
 * @returns {Promise<Frames>}
 */
export async function framesOf(request, { provider = "webgpu", onProgress, signal } = {}) {
  if (!PROVIDERS.includes(provider)) failing("provider")(`is ${provider}, expected ${PROVIDERS.join(" or ")}`);
  const { name } = request;
  const fail = failing(name, "Draw it by <gsgen-model> in a browser with WebGPU.");
  const { parts, ...content } = await readParts(request, onProgress, signal);
  if (content.kind === "onnx") return generatorFrames(content, name, provider);
  if (content.kind !== "splats") fail("is a tileset or a scene, expected a generator or splats");
  if (parts.length > 1) fail("holds several parts, expected one");
  return stillFrames(parts[0]);
}

/** Return the one frame of a splat file, a part of `readParts`. @returns {Frames} */
function stillFrames({ rows, appearance, count: live, channels, space, antialias, colorSpace, transform }) {
  const frame = { rows, appearance, live };
  return {
    capacity: rows.length / 10, channels, space, transform, antialias, colorSpace,
    inputs: [], time: null, up: [0, -1, 0], followsCamera: false, manifest: null, findings: [],
    run: async () => frame,
    destroy() {},
  };
}

/** @param {import("./splat_files.js").FileContent} content @returns {Promise<Frames>} */
export async function generatorFrames({ bytes, inspected }, name, provider) {
  const { manifest, findings, outputs: declared } = /** @type {import("./findings.js").Inspected} */ (inspected);
  const { gaussians, appearance, count } = manifest.outputs;
  if (manifest.blend === "wsr") {
    failing(name, "Draw it by <gsgen-model> in a browser with WebGPU.")("is a weighted sum, expected sorted Gaussians");
  }
  const ort = await onnxRuntime();
  const session = await createSession(ort, bytes, name, { executionProviders: [provider] });
  const inputs = new GeneratorInputs(session, manifest, pageTensors(ort));
  const names = [gaussians, appearance, count].filter(Boolean).map((output) => output.name);
  const run = async (values = {}, camera = null) => {
    try {
      return frameOf(await runInTurn(() => {
        inputs.update(values, camera);
        return session.run(inputs.feeds, constant ? names.filter((output) => output !== appearance.name) : names);
      }));
    } catch (error) {
      if (error instanceof GsgenError) throw error;
      throw new GsgenError(`the model fails: ${error.message}`, { where: name, hint: "See what is wrong: gsgen validate MODEL" });
    }
  };
  const isConstant = declared.some((output) => output.name === appearance.name && !output.varies);
  /** @type {Float32Array | null} Colours that depend on no input: they are computed once. */
  let constant = null;
  const frameOf = (outputs) => {
    const [rows, colors, live] = names.map((output) => outputs[output]?.data);
    const shown = constant ?? float32Of(colors);
    if (isConstant) constant = shown;
    const drawn = live ? Math.min(Math.max(Number(live[0]), 0), gaussians.capacity) : gaussians.capacity;
    return { rows: float32Of(rows), appearance: shown, live: drawn };
  };
  const { outputMetadata } = session;
  const [, channels] = outputMetadata.find((output) => output.name === appearance.name).shape;
  return {
    capacity: gaussians.capacity,
    channels: Number(channels),
    space: appearance.space,
    colorSpace: appearance.color_space ?? "srgb",
    antialias: manifest.antialias ?? "classic",
    inputs: manifest.inputs,
    time: timeOf(manifest.inputs),
    transform: IDENTITY,
    up: upOf(manifest),
    followsCamera: inputs.followsCamera,
    manifest, findings, run,
    destroy() {
      inputs.destroy();
      session.release();
    },
  };
}

/** Return numbers as float32. @param {any} numbers Float32, or float16 as numbers or as their bits. */
function float32Of(numbers) {
  if (numbers instanceof Float32Array) return numbers;
  return new Float32Array(new Float16Array(numbers.buffer, numbers.byteOffset, numbers.length));
}
