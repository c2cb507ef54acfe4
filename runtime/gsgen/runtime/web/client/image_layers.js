/**
 * Pictures of three.js as image layers, among which Gaussians are blended by depth.
 *
 * three.js renders on the client's device into textures: what is opaque, then what is translucent.
 */

import { storageBuffer, uniformBuffer } from "./gpu_buffers.js";
import { encodePass } from "./host.js";
import { evaluate } from "./plan.js";
import { UniformWriter } from "./uniforms.js";

const COPY_ALIGNMENT = 256; // bytes of a copied texture's rows, as WebGPU demands
const [COLOR_BYTES, DEPTH_BYTES] = [8, 4]; // of a pixel: rgba16float, depth32float

/** The layers of one canvas. */
export class ImageLayers {
  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {any} three The module of three.js.
   * @param {any} renderer Its `WebGPURenderer`, on the same device.
   */
  constructor(kernels, three, renderer) {
    this._kernels = kernels;
    this._three = three;
    this._renderer = renderer;
    /** @type {any[]} Translucent surfaces, then opaque ones: front to back. */
    this._layers = [];
  }

  /**
   * Return how a renderer of Gaussians draws a scene of three.js, too.
   * @param {any} scene
   * @param {any} camera Of three.js.
   * @param {{isEncoded?: boolean}} [options] Whether the scene's colours are those of the Gaussians,
   *     not linear.
   */
  async drawing(scene, camera, { isEncoded = false } = {}) {
    const { pipeline } = this._kernels.plans.layers;
    const importing = await this._kernels.pipeline(pipeline);
    const encodeLayers = (encoder, host) => {
      this._resize(host.sizes);
      for (const layer of this._layers) this._render(layer, scene, camera);
      this._encode(encoder, host, importing, camera, isEncoded);
    };
    return { layers: this._kernels.plans.layers.count, encodeLayers };
  }

  /** Make the textures that three.js renders into, and the buffers that they are copied to. */
  _resize({ width, height }) {
    if (this._layers[0]?.target.width === width && this._layers[0].target.height === height) return;
    this.destroy();
    const { _kernels: { device, plans }, _three: { DepthTexture, RenderTarget, FloatType, HalfFloatType } } = this;
    const rows = (bytes) => Math.ceil((bytes * width) / COPY_ALIGNMENT) * COPY_ALIGNMENT;
    const [colorRow, depthRow] = [rows(COLOR_BYTES), rows(DEPTH_BYTES)];
    this._layers = Array.from({ length: plans.layers.count }, (_, index) => {
      const depthTexture = new DepthTexture(width, height, FloatType);
      return {
        index, colorRow, depthRow,
        isTranslucent: index === 0,
        target: new RenderTarget(width, height, { type: HalfFloatType, depthTexture }),
        uniform: uniformBuffer(device, "picture", plans.uniforms.picture.size),
        colors: storageBuffer(device, "copied colors", colorRow * height),
        depths: storageBuffer(device, "copied depths", depthRow * height),
        groups: null,
        bound: null,
      };
    });
  }

  /** Render the opaque or the translucent surfaces of a scene into a layer's textures. */
  _render({ target, isTranslucent }, scene, camera) {
    const { _renderer: renderer } = this;
    const { background } = scene;
    const changes = [];
    scene.traverse((object) => {
      for (const material of [object.material ?? []].flat()) {
        const { colorWrite, depthWrite } = material;
        changes.push(() => Object.assign(material, { colorWrite, depthWrite }));
        // Opaque surfaces hide translucent ones behind them, whose own depth is that of the layer.
        if (isTranslucent && material.transparent) material.depthWrite = true;
        else if (isTranslucent) material.colorWrite = false;
        else if (material.transparent) Object.assign(material, { colorWrite: false, depthWrite: false });
      }
    });
    try {
      if (isTranslucent) scene.background = null;
      renderer.setClearColor(0x000000, 0);
      renderer.setRenderTarget(target);
      renderer.render(scene, camera);
    } finally {
      renderer.setRenderTarget(null);
      scene.background = background;
      for (const restore of changes.reverse()) restore();
    }
  }

  /** Copy three's textures into the layers of the frame plan. */
  _encode(encoder, host, importing, { projectionMatrix, reversedDepth = false }, isEncoded) {
    const { device, plans } = this._kernels;
    const [colors, depths] = [host.input("layer colors"), host.input("layer depths")];
    const { elements } = projectionMatrix;
    for (const layer of this._layers) {
      const { width, height } = layer.target;
      const picture = new UniformWriter(plans.uniforms.picture);
      const size = [width, height];
      picture.write({
        size, slope: elements[10], offset: elements[14], empty: reversedDepth ? 0 : 1,
        color_row: layer.colorRow / COLOR_BYTES, depth_row: layer.depthRow / DEPTH_BYTES,
        first: layer.index * width * height, is_encoded: Number(isEncoded),
      });
      device.queue.writeBuffer(layer.uniform, 0, picture.bytes);
      // Handles of textures are private in three.js, so tests pin the versions that have them here.
      const texture = (each) => this._renderer.backend.get(each).texture;
      encoder.copyTextureToBuffer(
        { texture: texture(layer.target.texture) },
        { buffer: layer.colors, bytesPerRow: layer.colorRow }, size,
      );
      encoder.copyTextureToBuffer(
        { texture: texture(layer.target.depthTexture), aspect: "depth-only" },
        { buffer: layer.depths, bytesPerRow: layer.depthRow }, size,
      );
      if (layer.bound !== colors) this._bind(layer, colors, depths);
    }
    const counts = plans.layers.groups.map((count) => evaluate(count, host.sizes));
    encodePass(encoder, "layers", this._layers.map(({ groups }) => ({ pipeline: importing, groups, counts })));
  }

  _bind(layer, colors, depths) {
    const buffers = [[layer.uniform, layer.colors, layer.depths, colors], [depths]];
    const resources = buffers.map((group) => group.map((buffer) => ({ buffer })));
    layer.groups = this._kernels.bound(this._kernels.plans.layers.pipeline, resources);
    layer.bound = colors;
  }

  /** Release all GPU objects. */
  destroy() {
    for (const { target, uniform, colors, depths } of this._layers) {
      target.dispose();
      for (const buffer of [uniform, colors, depths]) buffer.destroy();
    }
    this._layers = [];
  }
}
