/** The meshes of a stage: three.js draws them into image layers among the Gaussians. */

import { GsgenError } from "./errors.js";
import { ImageLayers } from "./image_layers.js";
import { composed, transposed4 } from "./matrices.js";
import { readMeshFile } from "./mesh_files.js";
import { remembered } from "./once.js";
import { placeEye } from "./three_modules.js";
import { hintAmong } from "./words.js";

const GREY = 0.7; // of meshes without colours
const AMBIENT = 0.2; // share of the light of a headlight that faces get from all sides
const AXES_OF_Y_UP = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]; // to x right, y down, z forward

/** The renderer of three.js on each device. @type {WeakMap<GPUDevice, Promise<any>>} */
const renderers = new WeakMap();

async function newRenderer(three, device) {
  const renderer = new three.WebGPURenderer({ device, reversedDepthBuffer: true });
  renderer.highPrecision = true; // products of matrices in float64
  await renderer.init();
  return renderer;
}

/** A mesh on a stage. @typedef {import("./scene_file.js").SceneMesh & {file: import("./mesh_files.js").MeshFile}} MeshEntry */

/** Read the file of a mesh. @returns {Promise<MeshEntry>} */
export async function openMesh(part, bytes, base, warn) {
  return { ...part, file: await readMeshFile(bytes, part.path, base, warn) };
}

/** Meshes with their places, which may be changed between frames. */
export class StageMeshes {
  /** @param {import("./host.js").KernelCache} kernels @param {MeshEntry[]} entries */
  static async open(kernels, entries, isLinear) {
    const [{ file: { three } }] = entries;
    const renderer = await remembered(renderers, kernels.device, () => newRenderer(three, kernels.device));
    return new StageMeshes(kernels, three, renderer, entries, isLinear);
  }

  constructor(kernels, three, renderer, entries, isLinear) {
    this.entries = entries;
    this._scene = new three.Scene();
    this._eye = new three.PerspectiveCamera();
    this._layers = new ImageLayers(kernels, three, renderer);
    this._parts = entries.map((entry) => {
      const { root, clips, surfaces } = entry.file;
      const place = new three.Group();
      place.matrixAutoUpdate = false;
      this._scene.add(place.add(root));
      const opacity = three.TSL.uniform(entry.opacity);
      const materials = surfaces.map((surface) => shaded(three, surface, entry.shading, opacity, isLinear));
      return { entry, place, opacity, materials, clip: clipOf(entry, clips), mixer: new three.AnimationMixer(root) };
    });
    for (const { clip, mixer } of this._parts) if (clip) mixer.clipAction(clip).play();
    this._three = three;
  }

  /** Seconds of the longest animation. */
  get seconds() {
    return Math.max(0, ...this._parts.map(({ clip }) => clip?.duration ?? 0));
  }

  /** Move animated meshes to a time; animations begin again at their end. */
  moveTo(seconds) {
    for (const { clip, mixer } of this._parts) if (clip) mixer.setTime(seconds);
  }

  /** The box around the first mesh that is visible. */
  get extent() {
    this._place();
    const { place } = this._parts.find(({ entry }) => entry.isVisible) ?? this._parts[0];
    place.updateMatrixWorld(true);
    const box = new this._three.Box3().setFromObject(place, true);
    const [center, half] = [box.getCenter(new this._three.Vector3()).toArray(), box.getSize(new this._three.Vector3()).toArray().map((side) => side / 2)];
    return { center, half, reach: Math.hypot(...half) || 1 };
  }

  _place() {
    for (const { entry, place, opacity, materials } of this._parts) {
      const { transform, file, isVisible } = entry;
      place.matrix.fromArray(transposed4(file.isYUp ? composed(transform, AXES_OF_Y_UP) : [...transform]));
      place.matrixWorldNeedsUpdate = true;
      place.visible = isVisible;
      opacity.value = entry.opacity;
      for (const material of materials) material.transparent = entry.opacity < 1;
    }
  }

  /** Return how a renderer of Gaussians draws the meshes, too. @param {import("./camera.js").Camera} camera */
  async drawing(camera) {
    this._place();
    placeEye(this._eye, camera);
    return this._layers.drawing(this._scene, this._eye, { isEncoded: true });
  }

  /** Release all GPU memory. */
  destroy() {
    this._layers.destroy();
    for (const { materials, entry } of this._parts) {
      for (const each of [...materials, ...entry.file.surfaces.flatMap(({ mesh, map }) => [mesh.geometry, map ?? []].flat())]) each.dispose();
    }
  }
}

/** Return the clip that a mesh plays; null if it stands still. */
function clipOf({ animation, where, path }, clips) {
  if (animation === null) return null;
  const clip = typeof animation === "number" ? clips[animation] : clips.find(({ name }) => name === animation);
  if (clip) return clip;
  const hint = hintAmong(String(animation), clips.map(({ name }) => name));
  throw new GsgenError(`is no animation of ${path}`, { where: `${where}.animation`, hint });
}

/**
 * Give a surface its material: its colours as they are, or darker where a face is seen from the side.
 * @param {import("./mesh_files.js").Surface} surface
 * @param {boolean} isLinear Whether Gaussians have linear colours.
 */
function shaded(three, surface, shading, opacity, isLinear) {
  const { mesh, slot, color, map, isLinear: isLight, isColored } = surface;
  const { float, texture, vec3, vec4, vertexColor, positionView, normalFlat, sRGBTransferEOTF, sRGBTransferOETF } = three.TSL;
  let shown = isColored ? vec3(...color) : vec3(GREY);
  if (mesh.geometry.attributes.color) shown = shown.mul(vertexColor().rgb);
  // What is multiplied with a texture is encoded as its texels are.
  if (isColored && isLight && (map || !isLinear)) shown = sRGBTransferOETF(shown);
  if (map) shown = shown.mul(texture(map).rgb);
  if (isLinear && !(isColored && isLight && !map)) shown = sRGBTransferEOTF(shown);
  if ((shading ?? (isColored ? "unlit" : "headlight")) === "headlight") {
    const facing = normalFlat.dot(positionView.normalize()).abs();
    shown = shown.mul(facing.mul(1 - AMBIENT).add(AMBIENT));
  }
  const material = new three.NodeMaterial();
  // Of several translucent surfaces the nearest is drawn, in whichever order they are.
  material.fragmentNode = vec4(shown.mul(opacity), float(opacity));
  Object.assign(material, { blending: three.NoBlending, side: three.DoubleSide });
  if (Array.isArray(mesh.material)) mesh.material[slot] = material;
  else mesh.material = material;
  if (mesh.isSkinnedMesh) mesh.frustumCulled = false; // the box is that of the rest pose
  return material;
}
