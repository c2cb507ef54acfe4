/** Models that an element shows: splat files, and generators that compute new ones every frame. */

import { parsedJson } from "./download.js";
import { boxAround } from "./framing.js";
import { linearPart, plus, times } from "./matrices.js";
import { readSplats } from "./splat_files.js";
import { SplatBuffers } from "./splat_buffers.js";

export const FIRST_OF_ONNX = 8; // its first byte, which no other file of a model has: the field ir_version

/**
 * @typedef {object} Model
 * @property {any} buffers Its Gaussians in GPU memory.
 * @property {import("./renderer.js").PlacedSet[]} sets What is drawn of it.
 * @property {{center: number[], half?: number[], reach: number}} extent
 * @property {number[]} up
 * @property {{name: any, low: number, high: number, seconds: number, loop: boolean} | null} time
 * @property {any[]} inputs The inputs that a visitor may set.
 * @property {boolean} followsCamera
 * @property {readonly number[]} [frame] From the axes that a scene file places to those of the sets.
 * @property {(values: Record<string, any>, camera: any) => Promise<boolean>} update Computes a
 *     frame; true if the pages are others than before.
 * @property {() => void} destroy
 * @property {number} [missingPictures] How many pictures the model needs before it can be shown.
 * @property {any} [manifest] Of generators, with the findings of rules.
 * @property {any[]} [findings]
 * @property {number[] | null} [background] Of scenes: red, green, blue and alpha.
 * @property {Partial<import("./orbit_camera.js").Orbit> & {view?: number[]}} [camera] Of scenes: the first one.
 * @property {(seconds: number) => any} [cameraAt] Of scenes: the orbit at a time; null without one.
 */

/**
 * Return the centre of the box around all Gaussians but floaters, half its sides and its diagonal.
 * @param {{rows: Float32Array, count: number}} splats
 */
export function extentOf(splats) {
  const { low, high } = boxAround(splats) ?? { low: [0, 0, 0], high: [0, 0, 0] };
  const half = low.map((least, axis) => (high[axis] - least) / 2);
  return { center: plus(low, 1, half), half, reach: Math.hypot(...half) || 1 };
}

/** Return the extent of several moments. @param {ReturnType<typeof extentOf>[]} boxes */
export function mergedExtent(boxes) {
  const low = [0, 1, 2].map((i) => Math.min(...boxes.map(({ center, half }) => center[i] - half[i])));
  const high = [0, 1, 2].map((i) => Math.max(...boxes.map(({ center, half }) => center[i] + half[i])));
  const half = plus(high, -1, low).map((side) => side / 2);
  return { center: plus(low, 1, half), half, reach: Math.hypot(...half) || 1 };
}

/** Return the model of a splat file. @returns {Model} */
function stillModel({ device, plans }, splats) {
  const buffers = new SplatBuffers(device, plans, splats);
  const sets = [{ buffers, transform: splats.transform }];
  const { center, half, reach } = extentOf(splats); // whose transform mirrors axes, at most
  const extent = { center: times(linearPart(splats.transform), center), half, reach };
  const [update, destroy] = [async () => false, () => buffers.destroy()];
  const still = { time: null, inputs: [], followsCamera: false, update, destroy };
  return { buffers, sets, extent, up: [0, -1, 0], ...still };
}

/** Return whether a JSON object is a scene file, and no tileset. */
const isScene = (document) => ["gsgen_scene", "models", "meshes"].some((name) => name in document);

/**
 * @typedef {object} Options How tilesets are streamed, and generators checked.
 * @property {string} [source] Address of the tileset, to which those of its tiles are relative.
 * @property {number} [maxError] Error in pixels above which tiles are refined.
 * @property {number} [maxSplats] Most Gaussians in GPU memory.
 * @property {(Blob | string)[]} [pictures] Of generators that are computed from pictures.
 * @property {string} [target] Whose limits and quirks rules of generators check.
 * @property {() => void} onChange Called when tiles have arrived.
 * @property {(error: import("./errors.js").GsgenError) => void} onError
 * @property {(where: string, problem: string) => void} [onWarning] Told what a page does not draw.
 * @property {AbortSignal} [signal] Ends downloads.
 */

/**
 * Open a model from its bytes.
 * @param {import("./host.js").KernelCache} kernels
 * @param {string} name Address of the file, for messages.
 * @param {Options} [options]
 * @returns {Promise<Model>}
 */
export async function openModel(kernels, data, name, options = { onChange() {}, onError() {} }) {
  if (new Uint8Array(data)[0] === FIRST_OF_ONNX) {
    const { GeneratorModel } = await import("./generator.js");
    return GeneratorModel.open(kernels, data, name, options);
  }
  const document = parsedJson(data);
  if (document && isScene(document)) {
    const { Stage } = await import("./stage.js");
    return Stage.open(kernels, document, name, options);
  }
  if (document) {
    const { TilesetModel } = await import("./tileset.js");
    return new TilesetModel(kernels, document, name, options);
  }
  return stillModel(kernels, await readSplats(data, name));
}
