/**
 * Stages: several models with their places in one world, drawn together, with a timeline.
 *
 * A stage is a model as far as an element can tell; all Gaussians of its models are sorted as one.
 */

import { download } from "./download.js";
import { GsgenError } from "./errors.js";
import { checkInputs, inputsAt, isKeyed, valueAt } from "./key_frames.js";
import { IDENTITY, composed, determinant, dot, inverted, linearPart, moved, nearestRotation, solve, times, transposed } from "./matrices.js";
import { eyeOf, viewOf } from "./camera.js";
import { openModel } from "./model.js";
import { valueOfTime } from "./playback.js";
import { orbitOf, readScene } from "./scene_file.js";
import { SegmentedModel } from "./segments.js";
import { SplatBuffers } from "./splat_buffers.js";
import { sourceFile } from "./source_files.js";

/** @type {symbol} */
const CLOCK = Symbol("seconds"); // the name of a stage's time, which no input of a model has

/** Return the transform from the space of a model's sets to the world. */
function worldOf({ model, transform }) {
  return model.frame ? composed(transform, inverted(model.frame)) : transform;
}

/** Return the geometric mean of the scales along the axes of a transform. */
function meanScale(transform) {
  return Math.cbrt(Math.abs(determinant(linearPart(transform))));
}

/** Return a camera as a placed model sees it. A camera neither shears nor mirrors. */
function localCamera(camera, transform) {
  const linear = linearPart(transform);
  const turn = nearestRotation(linear);
  const rotated = [0, 3, 6].flatMap((row) => times(transposed(turn), linearPart(camera.view).slice(row, row + 3)));
  const offset = eyeOf(camera).map((part, axis) => part - transform[4 * axis + 3]);
  const scale = meanScale(transform);
  const zoom = camera.kind === "orthographic" ? scale : 1;
  const view = viewOf(rotated, solve(linear, offset));
  return { ...camera, view, near: camera.near / scale, fx: camera.fx * zoom, fy: camera.fy * zoom };
}

/** A model on a stage. @typedef {import("./scene_file.js").SceneModel & {model: import("./model.js").Model}} Entry */

/** Several models as one. */
export class Stage {
  /**
   * Open a scene file and the files that it names.
   * @param {import("./host.js").KernelCache} kernels
   * @param {Record<string, any>} document
   * @param {string} name Of the file, for messages.
   * @param {import("./model.js").Options} options
   */
  static async open(kernels, document, name, options) {
    const warn = options.onWarning ?? (() => {});
    const scene = readScene(document, name, warn);
    if (kernels.openGenerator && scene.meshes.length) {
      const problem = "are drawn by WebGPU, which this browser lacks";
      if (!scene.models.length) throw new GsgenError(problem, { where: "meshes" });
      warn("meshes", problem);
      scene.meshes = [];
    }
    const base = new URL(options.source ?? name, globalThis.document.baseURI);
    const addressOf = ({ path, where }) => {
      if (path.startsWith("#")) return path;
      if (!URL.canParse(path, base)) throw new GsgenError("is no address", { where: `${where}.path` });
      return new URL(path, base).href;
    };
    const posts = scene.posts.map((post) => ({ ...post, address: addressOf(post) }));
    const { sound } = scene;
    const recording = sound && { ...sound, addresses: [sound.path, sound.captions].map((path) => path && addressOf({ ...sound, path })) };
    const openingMeshes = Promise.all(scene.meshes.map(async (part) => {
      const address = addressOf(part);
      const { openMesh } = await import("./stage_meshes.js");
      const data = await download(address, undefined, options.signal);
      return openMesh(part, data, address.startsWith("#") ? base.href : address, warn);
    }));
    openingMeshes.catch(() => {}); // who waits for the stage gets its error
    const openFile = async (part, signal = options.signal) => {
      const file = sourceFile(addressOf(part));
      const own = { ...options, signal, source: file.address, onProgress: undefined, onBegin: undefined };
      const model = await openModel(kernels, file, part.path, own);
      if (!(model instanceof Stage)) return model;
      model.destroy();
      throw new GsgenError("is a scene file, expected a splat file or a generator", { where: `${part.where}.path` });
    };
    const opening = scene.models.map(async (part) => {
      return { ...part, model: await (part.segments.length ? SegmentedModel.open(part, openFile) : openFile(part)) };
    });
    /** @type {import("./stage_meshes.js").StageMeshes | null} */
    let drawn = null;
    try {
      const entries = await Promise.all(opening);
      const meshes = await openingMeshes;
      const isLinear = entries.some(({ model }) => model.buffers.isLinear);
      if (meshes.length) drawn = await (await import("./stage_meshes.js")).StageMeshes.open(kernels, meshes, isLinear);
      return new Stage(kernels, entries, drawn, { ...scene, posts, recording }, document);
    } catch (error) {
      drawn?.destroy();
      for (const entry of opening) entry.then(({ model }) => model.destroy(), () => {});
      throw error;
    }
  }

  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {Entry[]} entries
   * @param {import("./stage_meshes.js").StageMeshes | null} meshes
   * @param {Omit<ReturnType<typeof readScene>, "posts"> & {posts: import("./post_process.js").Post[], recording: any}} scene
   * @param {Record<string, any>} document What the scene was read from.
   */
  constructor({ device, plans }, entries, meshes, scene, document) {
    this.entries = entries;
    this._meshes = meshes;
    /** Meshes, whose transform, opacity and visibility may be set, too. */
    this.meshes = meshes?.entries ?? [];
    this.surfaces = meshes ? async (camera, output) => (output === "normal" ? {} : meshes.drawing(camera)) : undefined;
    this._none = new SplatBuffers(device, plans, { count: 1, channels: 3, space: "rgb" }); // frame plans have rows
    this._scene = scene;
    this._document = document;
    const spaces = new Set(entries.map(({ model }) => model.buffers.isLinear));
    if (spaces.size > 1) throw new GsgenError("the models have colours in sRGB and in linear light: they do not blend");
    if (meshes && entries.some(({ model, isSorted }) => !isSorted && model.sets.some(({ weighted, buffers }) => weighted ?? buffers.weighted))) {
      throw new GsgenError("meshes are not drawn among weighted sums in pages", { where: "meshes", hint: 'Give these models "blend": "alpha".' });
    }
    for (const { inputs, model, where } of entries) checkInputs(inputs, model, where);
    this.annotations = scene.annotations;
    this.background = scene.background;
    this.posts = scene.posts;
    this.sound = scene.recording;
    this.up = scene.up;
    this.inputs = entries.flatMap(({ model }) => model.inputs);
    this.findings = entries.flatMap(({ model }) => model.findings ?? []);
    this.buffers = {
      isLinear: spaces.has(true),
      get count() {
        return entries.reduce((sum, { model }) => sum + model.buffers.count, 0);
      },
    };
    const first = entries.find(({ isVisible }) => isVisible) ?? (meshes ? null : entries[0]);
    this.extent = first ? extentOf(first) : /** @type {NonNullable<typeof meshes>} */ (meshes).extent;
    const clocks = entries.flatMap(({ model, isVisible }) => (isVisible && model.time) || []);
    const seconds = scene.seconds || Math.max(meshes?.seconds ?? 0, ...clocks.map((clock) => clock.seconds));
    const loop = scene.seconds ? scene.loop : clocks.every((clock) => clock.loop);
    /** Seconds of the timeline. @type {any} */
    this.time = seconds ? { name: CLOCK, low: 0, high: seconds, seconds, loop } : null;
    /** @type {import("./renderer.js").PlacedSet[]} */
    this.sets = [];
    this._place();
  }

  /** Where the camera is at first; what is absent shows the whole scene. */
  get camera() {
    const { camera, fieldOfView } = this._scene;
    const place = isKeyed(camera) ? this.cameraAt(0) : camera;
    return { ...(fieldOfView ? { fieldOfView } : {}), ...place };
  }

  /** Whether a model of the present time does. */
  get followsCamera() {
    return this.entries.some(({ model }) => model.followsCamera);
  }

  /** The sums of those of its tilesets; null without. */
  get statistics() {
    const all = this.entries.flatMap(({ model }) => model.statistics ?? []);
    const sums = Object.keys(all[0] ?? {}).map((key) => [key, all.reduce((sum, own) => sum + own[key], 0)]);
    return all.length ? /** @type {any} */ (Object.fromEntries(sums)) : null;
  }

  /** Return the orbit at a time of a timeline with cameras; null without. */
  cameraAt(seconds) {
    const { camera, up } = this._scene;
    return isKeyed(camera) ? orbitOf(valueAt(camera.keys, seconds), up) : null;
  }

  /**
   * Compute the Gaussians of a frame; return whether the pages are others than before.
   * @param {Record<string | symbol, any>} given By name or role, and the seconds of the timeline.
   * @param {import("./camera.js").Camera} camera
   * @param {((seconds: number) => any) | null} [path] The camera in some seconds, if it is known.
   * @returns {Promise<boolean>}
   */
  async update(given, camera, path = null) {
    const { [CLOCK]: seconds = 0, ...values } = given;
    let isChanged = false;
    this._meshes?.moveTo(seconds);
    for (const { model, isVisible } of this.entries) if (!isVisible) model.hide?.();
    for (const entry of this.entries.filter(({ isVisible }) => isVisible)) {
      const { model, inputs } = entry;
      const [keyed, fixed] = inputsAt(inputs, seconds, model);
      const all = { ...this._ownTime(model, seconds), ...keyed, ...values, ...fixed };
      const local = (each) => each && localCamera(each, worldOf(entry));
      const own = path && ((seconds) => local(path(seconds)));
      isChanged = (await model.update(all, local(camera), own)) || isChanged;
    }
    return this._place() || isChanged;
  }

  /** Give back what only frames need, until the next one. */
  hide() {
    for (const { model } of this.entries) model.hide?.();
    this._place();
  }

  /** Return the time of a model: it goes through its range once. */
  _ownTime({ time }, seconds) {
    return time && this.time ? { [time.name]: valueOfTime(time, seconds / this.time.seconds) } : {};
  }

  /** Give all sets their places; return whether there are others than before. */
  _place() {
    const visible = this.entries.filter(({ isVisible }) => isVisible);
    const sets = visible.flatMap((entry) => entry.model.sets.map((set) => [set, placed(set, entry)]));
    if (!sets.length) sets.push([null, { buffers: this._none, transform: IDENTITY }]);
    const isSame = sets.length === this.sets.length && sets.every(([, { buffers }], i) => buffers === this.sets[i].buffers);
    // The renderer reads the sets of a scene in every frame; others need another plan.
    if (isSame) sets.forEach(([, set], i) => Object.assign(this.sets[i], set));
    else this.sets = sets.map(([, set]) => set);
    return !isSame;
  }

  /**
   * Return the scene file of the stage as it stands.
   * @param {import("./camera.js").Camera} [camera] Replaces that of the file.
   * @param {import("./orbit_camera.js").Orbit} [orbit] Where the camera looks.
   * @returns {Record<string, any>}
   */
  toJSON(camera, orbit) {
    const [models, meshes] = [this.entries, this.meshes].map((entries) => entries.map(({ fields, path, transform, opacity, isVisible }) => {
      const { translate, rotate, scale, visible, ...rest } = fields;
      const rows = [0, 4, 8, 12].map((first) => transform.slice(first, first + 4));
      return { ...rest, path, transform: rows, opacity_scale: opacity, ...(isVisible ? {} : { visible: false }) };
    }));
    const place = camera && orbit && !isKeyed(this._document.camera) ? { camera: `look-at:${[...eyeOf(camera), ...orbit.target]}`, fov: orbit.fieldOfView } : {};
    return { gsgen_scene: "1.0", ...this._document, models, ...(meshes.length ? { meshes } : {}), ...place };
  }

  destroy() {
    this._none.destroy();
    this._meshes?.destroy();
    for (const { model } of this.entries) model.destroy();
  }
}

/** Return a set of a model at its place on the stage. */
function placed(set, entry) {
  const { opacity, degree, antialias, clip, isSorted } = entry;
  const own = set.degree ?? set.buffers.degree ?? null;
  return {
    ...set,
    transform: composed(worldOf(entry), set.transform),
    opacityScale: opacity * (set.opacityScale ?? 1),
    ...(degree !== null && own !== null ? { degree: Math.min(own, degree) } : {}),
    ...(antialias ? { antialias } : {}),
    ...(clip ? { clip: mirrored(clip, set.transform) } : {}),
    ...(isSorted ? { weighted: null } : {}),
  };
}

/** Return a box in the axes of a file, whose transform mirrors axes at most. */
function mirrored({ low, high }, transform) {
  const sides = [0, 1, 2].map((axis) => [low[axis], high[axis]].map((part) => part * transform[5 * axis]).sort((a, b) => a - b));
  return { low: sides.map(([side]) => side), high: sides.map(([, side]) => side) };
}

/** Return the extent of a placed model in the world. */
function extentOf(entry) {
  const transform = worldOf(entry);
  const { center, half = [0, 0, 0], reach } = entry.model.extent;
  const linear = linearPart(transform);
  return {
    center: moved(transform, center),
    half: [0, 3, 6].map((row) => dot(linear.slice(row, row + 3).map(Math.abs), half)),
    reach: reach * meanScale(transform),
  };
}
