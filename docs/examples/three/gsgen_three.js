/**
 * Composites Gaussians with a three.js scene, by depth in both directions.
 *
 * three.js renders on gsgen's device into textures: what is opaque, then what is translucent. Both
 * become image layers, among which the Gaussians are blended front to back, in one picture.
 */

import * as THREE from "three/webgpu";

import { ImageLayers } from "gsgen/image_layers.js";
import { composed, transposed4 } from "gsgen/matrices.js";
import { openModel } from "gsgen/model.js";
import { Presenter } from "gsgen/present.js";
import { Renderer } from "gsgen/renderer.js";
import { sharedKernels } from "gsgen/shared.js";

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
    const presenter = new Presenter(kernels, canvas);
    return new GsgenCompositor(kernels, canvas, three, presenter);
  }

  constructor(kernels, canvas, three, presenter) {
    this._kernels = kernels;
    this._canvas = canvas;
    this._presenter = presenter;
    /** The renderer of three.js, for shadow maps and other settings. */
    this.three = three;
    /** The renderer of the Gaussians; its image holds the whole picture. */
    this.gaussians = new Renderer(kernels);
    this._sets = "";
    this._layers = new ImageLayers(kernels, THREE, three);
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
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    const view = gsgenCamera(camera, width, height);
    await this._place(scene, view);
    await this.gaussians.drawWhole(view, await this._layers.drawing(scene, camera));
    this._presenter.show(this.gaussians.host.image("color"), view);
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

  /** Release all GPU objects. */
  destroy() {
    this._layers.destroy();
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
