/** What draws the elements of a page: WebGPU, or three.js on WebGL 2 where a browser lacks it. */

import { WebGpuMissing } from "./device.js";
import { GsgenError } from "./errors.js";
import { openModel } from "./model.js";
import { sharedKernels } from "./shared.js";
import { ShownModel } from "./shown_model.js";

/**
 * @typedef {object} Backend
 * @property {string} note What is told of it when a model is loaded.
 * @property {Promise<{message: string, reason: string}>} lost Resolved when its device is lost.
 * @property {(bytes: ArrayBuffer, name: string, file: import("./source_files.js").SourceFile,
 *     options: import("./model.js").Options) => Promise<any>} show
 *     Opens a model, as a `ShownModel`.
 */

/** @returns {Promise<Backend>} */
async function webGpu() {
  const kernels = await sharedKernels();
  const pipeline = await kernels.presenting;
  const show = async (bytes, name, file, options) => {
    const model = await openModel(kernels, bytes, name, options);
    const count = model.missingPictures ?? 0;
    if (count) {
      model.destroy();
      throw new GsgenError(`is computed from ${count} ${count === 1 ? "picture" : "pictures"}, expected as many`, {
        where: name, hint: 'Set the attribute images="a.png b.png", or drop files on it.',
      });
    }
    return new ShownModel(kernels, model, pipeline, file, options.onChange);
  };
  return { note: "", lost: /** @type {any} */ (kernels.device.lost), show };
}

/** Return what draws the elements of this page. @returns {Promise<Backend>} */
export async function sharedBackend() {
  try {
    return await webGpu();
  } catch (error) {
    if (!(error instanceof WebGpuMissing)) throw error;
    const { webGl2 } = await import("./without_webgpu.js");
    return webGl2(error);
  }
}
