/** What draws the elements of a page: WebGPU, or three.js on WebGL 2 where a browser lacks it. */

import { WebGpuMissing } from "./device.js";
import { GsgenError } from "./errors.js";
import { openModel } from "./model.js";
import { sharedKernels } from "./shared.js";
import { ShownModel } from "./shown_model.js";

/**
 * How an element is told of a file.
 * @typedef {object} Telling
 * @property {(shown: ShownModel) => void} onBegin Its rows begin to arrive, and may be drawn. If
 *     the promise is rejected, what was told is destroyed.
 * @property {(loss: {message: string, reason: string}) => void} onLost The graphics device is lost.
 */
/** @typedef {import("./model.js").Options & Telling} ShowOptions */

/** @param {import("./source_files.js").SourceFile} file @param {ShowOptions} options */
async function showByWebGpu(kernels, file, name, options) {
  /** @type {ShownModel | null} */
  let shown = null;
  const onBegin = (model) => {
    shown = new ShownModel(model.kernels, model, file, options.onChange);
    options.onBegin(shown);
  };
  try {
    const model = await openModel(kernels, file, name, { ...options, onBegin });
    const count = model.missingPictures ?? 0;
    if (count) {
      model.destroy();
      throw new GsgenError(`is computed from ${count} ${count === 1 ? "picture" : "pictures"}, expected as many`, {
        where: name, hint: 'Set the attribute images="a.png b.png", or drop files on it.',
      });
    }
    return shown ?? new ShownModel(await kernels, model, file, options.onChange);
  } catch (error) {
    /** @type {ShownModel | null} */ (shown)?.destroy();
    throw error;
  }
}

/**
 * Show a file; the promise resolves when all of it can be drawn.
 * @param {import("./source_files.js").SourceFile} file
 * @param {string} name For messages.
 * @param {ShowOptions} options
 * @returns {Promise<any>} A `ShownModel`, or what three.js shows.
 */
export async function show(file, name, options) {
  const kernels = sharedKernels();
  kernels.then(({ device }) => device.lost).then(options.onLost, () => {});
  try {
    return await showByWebGpu(kernels, file, name, options);
  } catch (error) {
    if (!(error instanceof WebGpuMissing)) throw error;
    const { showByThree } = await import("./without_webgpu.js");
    return showByThree(error, file, name, options);
  }
}
