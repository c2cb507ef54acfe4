/**
 * Composites Gaussians with a three.js scene, by depth in both directions.
 *
 * three.js renders on gsgen's device into textures: what is opaque, then what is translucent. Both
 * become image layers, among which the Gaussians are blended front to back, in one picture.
 */

import * as THREE from "three/webgpu";

import { download } from "gsgen/download.js";
import { storageBuffer } from "gsgen/gpu_buffers.js";
import { encodePass } from "gsgen/host.js";
import { composed, transposed4 } from "gsgen/matrices.js";
import { openModel } from "gsgen/model.js";
import { evaluate } from "gsgen/plan.js";
import { Presenter } from "gsgen/present.js";
import { Renderer } from "gsgen/renderer.js";
import { sharedKernels } from "gsgen/shared.js";
import { UniformWriter } from "gsgen/uniforms.js";

const COPY_ALIGNMENT = 256; // bytes of a copied texture's rows, as WebGPU demands
const [COLOR_BYTES, DEPTH_BYTES] = [8, 4]; // of a pixel: rgba16float, depth32float
// three.js looks along −z with y up; gsgen's cameras look along +z with y down.
const CAMERA_AXES = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1];

/** Gaussians in a three.js scene: a splat file, or a generator whose inputs are `values`. */
export class GsgenObject extends THREE.Object3D {
  /** @param {string} source Address of the model. */
  static async load(source) {
    const kernels = await sharedKernels();
    return new GsgenObject(await openModel(kernels, await download(source), source));
  }

  constructor(model) {
    super();
    this.model = model;
    this.values = {};
    // three.js has y up; many splat files have −y, and tilesets z.
    const [, y, z] = model.up;
    if (y < 0) this.rotation.x = Math.PI;
    else if (z > 0) this.rotation.x = -Math.PI / 2;
  }
}

/** Renders a three.js scene with the Gaussians in it onto a canvas. */
export class GsgenCompositor {
  /** @param {HTMLCanvasElement} canvas */
  static async create(canvas) {
    const kernels = await sharedKernels();
    const three = new THREE.WebGPURenderer({ device: kernels.device });
    await three.init();
    const presenter = new Presenter(kernels, canvas);
    await presenter.prepare();
    const { pipeline } = kernels.plans.layers;
    return new GsgenCompositor(kernels, canvas, three, presenter, await kernels.pipeline(pipeline));
  }

  constructor(kernels, canvas, three, presenter, importing) {
    this._kernels = kernels;
    this._canvas = canvas;
    this._presenter = presenter;
    this._importing = importing;
    /** The renderer of three.js, for shadow maps and other settings. */
    this.three = three;
    /** The renderer of the Gaussians; its image holds the whole picture. */
    this.gaussians = new Renderer(kernels);
    this._sets = "";
    /** @type {any[]} Translucent surfaces, then opaque ones: front to back. */
    this._layers = [];
  }

  /**
   * Draw a frame.
   * @param {THREE.Scene} scene
   * @param {THREE.PerspectiveCamera} camera
   */
  async render(scene, camera) {
    const { width, height } = this._canvas;
    this._resize(width, height);
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    this._renderLayer(this._layers[0], scene, camera, { isTranslucent: true });
    this._renderLayer(this._layers[1], scene, camera, { isTranslucent: false });
    const view = gsgenCamera(camera, width, height);
    await this._place(scene, view);
    await this.gaussians.drawWhole(view, {
      layers: this._layers.length,
      encodeLayers: (encoder, host) => this._encodeLayers(encoder, host, camera),
    });
    this._presenter.show(this.gaussians.host.image("color"), view);
  }

  /** Make the textures that three.js renders into, and the buffers that they are copied to. */
  _resize(width, height) {
    if (this._layers[0]?.target.width === width && this._layers[0].target.height === height) return;
    this._releaseLayers();
    const { device, plans } = this._kernels;
    const rows = (bytes) => Math.ceil((bytes * width) / COPY_ALIGNMENT) * COPY_ALIGNMENT;
    const [colorRow, depthRow] = [rows(COLOR_BYTES), rows(DEPTH_BYTES)];
    this._layers = Array.from({ length: plans.layers.count }, (_, index) => {
      const depthTexture = new THREE.DepthTexture(width, height, THREE.FloatType);
      const options = { type: THREE.HalfFloatType, depthTexture };
      const usage = GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST;
      return {
        index, colorRow, depthRow,
        target: new THREE.RenderTarget(width, height, options),
        uniform: device.createBuffer({ label: "picture", size: plans.uniforms.picture.size, usage }),
        colors: storageBuffer(device, "copied colors", colorRow * height),
        depths: storageBuffer(device, "copied depths", depthRow * height),
        groups: null,
        bound: null,
      };
    });
  }

  /** Render the opaque or the translucent surfaces of a scene into a layer's textures. */
  _renderLayer({ target }, scene, camera, { isTranslucent }) {
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
      this.three.setClearColor(0x000000, 0);
      this.three.setRenderTarget(target);
      this.three.render(scene, camera);
    } finally {
      this.three.setRenderTarget(null);
      scene.background = background;
      for (const restore of changes.reverse()) restore();
    }
  }

  /** Give the renderer the Gaussians of a scene at their present places. */
  async _place(scene, view) {
    const objects = [];
    scene.traverseVisible((object) => object instanceof GsgenObject && objects.push(object));
    // A generator that follows the camera sees it from the model's own space.
    const changed = await Promise.all(
      objects.map(({ model, values, matrixWorld }) => {
        const local = composed(view.view, transposed4(matrixWorld.elements));
        return model.update(values, { ...view, view: local });
      }),
    );
    const sets = objects.flatMap(({ model, matrixWorld }) => {
      const world = transposed4(matrixWorld.elements);
      return model.sets.map((set) => ({ ...set, transform: composed(world, set.transform) }));
    });
    const key = objects.map(({ uuid, matrixWorld }) => [uuid, ...matrixWorld.elements]).join();
    if (key !== this._sets || changed.some(Boolean)) this.gaussians.setScene(sets);
    this._sets = key;
  }

  /** Copy three's textures into the layers of the frame plan. */
  _encodeLayers(encoder, host, { projectionMatrix, reversedDepth = false }) {
    const { device, plans } = this._kernels;
    const [colors, depths] = [host.input("layer colors"), host.input("layer depths")];
    const { elements } = projectionMatrix;
    for (const layer of this._layers) {
      const { width, height } = layer.target;
      const picture = new UniformWriter(plans.uniforms.picture);
      picture.set("size", [width, height]);
      picture.set("color_row", layer.colorRow / COLOR_BYTES);
      picture.set("depth_row", layer.depthRow / DEPTH_BYTES);
      picture.set("first", layer.index * width * height);
      picture.set("empty", reversedDepth ? 0 : 1);
      picture.set("slope", elements[10]);
      picture.set("offset", elements[14]);
      device.queue.writeBuffer(layer.uniform, 0, picture.bytes);
      // Handles of textures are private in three.js, so tests pin the versions that have them here.
      const texture = (each) => this.three.backend.get(each).texture;
      const size = [width, height];
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
    const steps = this._layers.map(({ groups }) => ({ pipeline: this._importing, groups, counts }));
    encodePass(encoder, "layers", steps);
  }

  _bind(layer, colors, depths) {
    const { device, plans } = this._kernels;
    const { groups } = plans.pipelines[plans.layers.pipeline];
    const resources = [[layer.uniform, layer.colors, layer.depths, colors], [depths]];
    layer.groups = resources.map((buffers, group) => {
      const entries = buffers.map((buffer, binding) => ({ binding, resource: { buffer } }));
      return device.createBindGroup({ layout: this._kernels.layout(groups[group]), entries });
    });
    layer.bound = colors;
  }

  _releaseLayers() {
    for (const { target, uniform, colors, depths } of this._layers) {
      target.dispose();
      for (const buffer of [uniform, colors, depths]) buffer.destroy();
    }
    this._layers = [];
  }

  /** Release all GPU objects. */
  destroy() {
    this._releaseLayers();
    this.gaussians.destroy();
    this._presenter.destroy();
    this.three.dispose();
  }
}

/** Return gsgen's camera for a perspective camera of three.js. */
function gsgenCamera({ matrixWorldInverse, projectionMatrix, near }, width, height) {
  const { elements } = projectionMatrix;
  return {
    view: composed(CAMERA_AXES, transposed4(matrixWorldInverse.elements)),
    fx: (elements[0] * width) / 2,
    fy: (elements[5] * height) / 2,
    cx: ((1 - elements[8]) * width) / 2,
    cy: ((1 + elements[9]) * height) / 2,
    width,
    height,
    near,
    kind: /** @type {const} */ ("pinhole"),
  };
}
