/** Shows an image in GPU memory on a canvas. */

import { uniformBuffer } from "./gpu_buffers.js";
import { showingUniform } from "./uniforms.js";

/** Shows images on one canvas. */
export class Presenter {
  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {HTMLCanvasElement | OffscreenCanvas} canvas
   */
  constructor(kernels, canvas) {
    this.device = kernels.device;
    this.plans = kernels.plans;
    this._pipeline = kernels.presenting;
    this._context = /** @type {GPUCanvasContext} */ (canvas.getContext("webgpu"));
    const { device } = this;
    const format = navigator.gpu.getPreferredCanvasFormat();
    this._context.configure({ device, format, alphaMode: "premultiplied" });
    this._canvas = canvas;
    this._uniform = uniformBuffer(device, "showing", this.plans.uniforms.showing.size);
    /** @type {{image: GPUBuffer, group: GPUBindGroup} | null} */
    this._bound = null;
  }

  /**
   * @param {GPUBuffer} image
   * @param {import("./camera.js").Camera} camera The camera that drew the image.
   * @param {{mode?: string, depths?: [number, number], isLinear?: boolean, backgroundAlpha?: number}} [look]
   */
  show(image, camera, { mode = "color", depths = [0, 1], isLinear = false, backgroundAlpha = 1 } = {}) {
    const { device, plans, _canvas: canvas } = this;
    const number = plans.present.modes[mode === "color" ? mode : `MODE_${mode.toUpperCase()}`];
    const look = { mode: number, depths, isLinear, backgroundAlpha };
    const bytes = showingUniform(plans, camera, [canvas.width, canvas.height], look);
    device.queue.writeBuffer(this._uniform, 0, bytes);
    if (this._bound?.image !== image) {
      const entries = [this._uniform, image].map((buffer, binding) => ({ binding, resource: { buffer } }));
      const layout = this._pipeline.getBindGroupLayout(0);
      this._bound = { image, group: device.createBindGroup({ label: "present", layout, entries }) };
    }
    const encoder = device.createCommandEncoder({ label: "present" });
    const view = this._context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({
      label: "present",
      colorAttachments: [{ view, loadOp: "clear", storeOp: "store", clearValue: [0, 0, 0, 0] }],
    });
    pass.setPipeline(this._pipeline);
    pass.setBindGroup(0, this._bound.group);
    pass.draw(3);
    pass.end();
    device.queue.submit([encoder.finish()]);
  }

  /** Release the canvas and the buffers. */
  destroy() {
    this._context.unconfigure();
    this._uniform.destroy();
    this._bound = null;
  }
}
