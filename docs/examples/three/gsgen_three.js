/**
 * Composites Gaussians with a three.js scene, by depth in both directions.
 *
 * three.js renders on gsgen's device into textures: what is opaque, then what is translucent. Both
 * become image layers, among which the Gaussians are blended front to back, in one picture.
 */

import * as THREE from "three/webgpu";

import { storageBuffer, uniformBuffer } from "gsgen/gpu_buffers.js";
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
const SHADOW_SIDE = 256; // pixels: the side of a shadow's images, a multiple of 16
const SHADOW_OUTPUTS = ["color", "depth"];

/** Gaussians in a three.js scene: a splat file, or a generator whose inputs are `values`. */
export class GsgenObject extends THREE.Object3D {
  /** @param {string} source Address of the model. */
  static async load(source) {
    const kernels = await sharedKernels();
    return new GsgenObject(await openModel(kernels, source, source));
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

/** The shadow of all Gaussians of a scene in a directional light: two images from the light. */
export class GsgenShadow {
  constructor(kernels, three, light) {
    this._three = three;
    this._light = light;
    this._gaussians = new Renderer(kernels);
    const pixels = new Float32Array(4 * SHADOW_SIDE ** 2);
    this._textures = SHADOW_OUTPUTS.map(() => {
      return new THREE.DataTexture(pixels, SHADOW_SIDE, SHADOW_SIDE, THREE.RGBAFormat, THREE.FloatType);
    });
    for (const texture of this._textures) texture.needsUpdate = true;
    /** How dark the shadow is: 0 to 1. */
    this.strength = sharedUniform(1);
  }

  /** Let the shadow fall on node materials, whose meshes receive shadows of the light. */
  fallOn(...materials) {
    const { positionWorld, texture, vec2, vec4 } = THREE.TSL;
    const { matrix, camera } = this._light.shadow;
    const place = sharedUniform(matrix).mul(vec4(positionWorld, 1));
    const distance = sharedUniform(camera.matrixWorldInverse).mul(vec4(positionWorld, 1)).z.negate();
    const [colors, depths] = this._textures.map((map) => texture(map, vec2(place.x, place.y.oneMinus())));
    // Half of the light ends before the median depth; surfaces nearer to the light are lit.
    const isBehind = distance.greaterThan(depths.y).toFloat();
    const lit = colors.a.mul(isBehind).mul(this.strength).oneMinus();
    for (const material of materials) material.receivedShadowNode = (shadow) => shadow.mul(lit);
  }

  /** Draw sets of Gaussians from the light. */
  async draw(sets, isChanged) {
    const { shadow } = this._light;
    shadow.updateMatrices(this._light);
    if (isChanged) this._gaussians.setScene(sets);
    const view = gsgenCamera(shadow.camera, SHADOW_SIDE, SHADOW_SIDE);
    await this._gaussians.drawWhole(view, { outputs: SHADOW_OUTPUTS });
    const { host, device } = this._gaussians;
    const encoder = device.createCommandEncoder({ label: "shadow" });
    this._textures.forEach((texture, index) => {
      this._three.initTexture(texture);
      const source = { buffer: host.image(SHADOW_OUTPUTS[index]), bytesPerRow: 16 * SHADOW_SIDE };
      const target = { texture: this._three.backend.get(texture).texture };
      encoder.copyBufferToTexture(source, target, [SHADOW_SIDE, SHADOW_SIDE]);
    });
    device.queue.submit([encoder.finish()]);
  }

  destroy() {
    for (const texture of this._textures) texture.dispose();
    this._gaussians.destroy();
  }
}

/** Renders a three.js scene with the Gaussians in it onto a canvas. */
export class GsgenCompositor {
  /** @param {HTMLCanvasElement} canvas */
  static async create(canvas) {
    const kernels = await sharedKernels();
    const three = new THREE.WebGPURenderer({ device: kernels.device });
    await three.init();
    const presenter = new Presenter(kernels, canvas, await kernels.presenting);
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
    /** @type {GsgenShadow[]} */
    this._shadows = [];
  }

  /**
   * Return the shadow that the Gaussians cast in a light.
   * @param {THREE.DirectionalLight} light Its shadow camera says how far the shadow reaches.
   */
  addShadow(light) {
    this._shadows.push(new GsgenShadow(this._kernels, this.three, light));
    return this._shadows[this._shadows.length - 1];
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
    const view = gsgenCamera(camera, width, height);
    await this._place(scene, view);
    this._renderLayer(this._layers[0], scene, camera, { isTranslucent: true });
    this._renderLayer(this._layers[1], scene, camera, { isTranslucent: false });
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
      return {
        index, colorRow, depthRow,
        target: new THREE.RenderTarget(width, height, options),
        uniform: uniformBuffer(device, "picture", plans.uniforms.picture.size),
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

  /** Give the renderers the Gaussians of a scene at their present places, and draw the shadows. */
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
    const isChanged = key !== this._sets || changed.some(Boolean);
    if (isChanged) this.gaussians.setScene(sets);
    this._sets = key;
    for (const shadow of this._shadows) await shadow.draw(sets, isChanged);
  }

  /** Copy three's textures into the layers of the frame plan. */
  _encodeLayers(encoder, host, { projectionMatrix, reversedDepth = false }) {
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
        first: layer.index * width * height,
      });
      device.queue.writeBuffer(layer.uniform, 0, picture.bytes);
      // Handles of textures are private in three.js, so tests pin the versions that have them here.
      const texture = (each) => this.three.backend.get(each).texture;
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
    for (const shadow of this._shadows) shadow.destroy();
    this.gaussians.destroy();
    this._presenter.destroy();
    this.three.dispose();
  }
}

/** Return a uniform that is written in every picture, though the objects that read it stand still. */
function sharedUniform(value) {
  return THREE.TSL.uniform(value).setGroup(THREE.TSL.renderGroup);
}

/** Return gsgen's camera for a perspective or an orthographic camera of three.js. */
function gsgenCamera({ matrixWorldInverse, projectionMatrix, near, isOrthographicCamera }, width, height) {
  const e = projectionMatrix.elements;
  // Where the image's centre is: the third column counts depth, the fourth is constant.
  const [right, up] = isOrthographicCamera ? [e[12], e[13]] : [-e[8], -e[9]];
  return {
    view: composed(CAMERA_AXES, transposed4(matrixWorldInverse.elements)),
    fx: (e[0] * width) / 2,
    fy: (e[5] * height) / 2,
    cx: ((1 + right) * width) / 2,
    cy: ((1 - up) * height) / 2,
    width,
    height,
    near,
    kind: /** @type {const} */ (isOrthographicCamera ? "orthographic" : "pinhole"),
  };
}
