/** Gaussians for Babylon.js 9.35: gives its `GaussianSplattingMesh` frames of a model. */

import { Ellipsoids, requireCalls } from "./ellipsoids.js";

const ROW_BYTES = 32; // centre, scales, colour, rotation: the rows of SPLAT files
const LEAST_SCALE = 1e-9; // the engine divides by the largest number of a covariance
const DEPTHS = 2 ** 17; // that are told apart

/** A mesh of Babylon.js that shows frames of a model. */
export class BabylonGaussians {
  /**
   * Return the settings of a mesh's material that draw a model's Gaussians as it was trained.
   * @param {Pick<import("../frames.js").Frames, "antialias">} frames
   */
  static settings({ antialias }) {
    return { compensation: antialias === "mip" };
  }

  /**
   * @param {any} babylon `BABYLON`, or the module `@babylonjs/core`.
   * @param {any} scene
   * @param {import("./ellipsoids.js").Format & Pick<import("../frames.js").Frames, "antialias">} frames The model.
   * @throws {import("../errors.js").GsgenError} The module is older than its calls.
   */
  constructor(babylon, scene, frames) {
    const { GaussianSplattingMesh: Mesh, Engine } = babylon;
    requireCalls("babylonjs", Engine.Version, "9.35", !!Mesh && "updateData" in Mesh.prototype && "disableDepthSort" in Mesh.prototype);
    this._babylon = babylon;
    this._ellipsoids = new Ellipsoids(frames);
    /** @type {{low: number[], high: number[]}} Box of three standard deviations around the frame. */
    this.bounds = this._ellipsoids;
    /** Whether frames are filled again when the camera moves: their rows are in its order. */
    this.needsCamera = true;
    this._target = this._ellipsoids.target();
    this._rows = new ArrayBuffer(ROW_BYTES * frames.capacity);
    this._depths = new Float64Array(frames.capacity);
    this._places = new Uint32Array(DEPTHS + 1); // of each depth the next one, once depths are counted
    this._order = new Uint32Array(frames.capacity);
    /** What scenes hold; its axes are the model's, mirrored where the scene is left-handed. */
    this.mesh = new Mesh("gsgen", null, scene);
    if (!scene.useRightHandedSystem) this.mesh.scaling.z = -1;
    // The engine's sort ends some frames later, and an older frame is shown until then.
    this.mesh.disableDepthSort = true;
    Object.assign(this.mesh.material, BabylonGaussians.settings(frames));
  }

  /**
   * Show a frame.
   * @param {import("../frames.js").Frame} frame
   * @param {any} camera Of which its colours and its order are.
   */
  fill(frame, camera) {
    const { centers, scales, rotations, colors } = this._target;
    const world = this.mesh.computeWorldMatrix(true);
    const toView = world.multiply(camera.getViewMatrix(true)).m;
    const eye = this._babylon.Vector3.TransformCoordinates(camera.globalPosition, world.clone().invert());
    this._ellipsoids.write(frame, this._target, eye.asArray());
    this._sort(toView);
    const floats = new Float32Array(this._rows);
    const bytes = new Uint8ClampedArray(this._rows);
    for (let place = 0; place < this._order.length; place++) {
      const row = 4 * this._order[place];
      const [to, byte] = [8 * place, ROW_BYTES * place + 24];
      for (let axis = 0; axis < 3; axis++) {
        floats[to + axis] = centers[row + axis];
        floats[to + 3 + axis] = Math.max(scales[row + axis], LEAST_SCALE);
        bytes[byte + axis] = 255 * colors[row + axis];
        bytes[byte + 5 + axis] = 127.5 * rotations[row + axis] + 127.5;
      }
      bytes[byte + 3] = 255 * colors[row + 3];
      bytes[byte + 4] = 127.5 * rotations[row + 3] + 127.5;
    }
    this.mesh.updateData(this._rows, undefined, { flipY: false });
  }

  /**
   * Order the rows, farthest first, by counting those of each depth.
   * @param {Float32Array} toView From the rows' axes to the camera's, as the engine stores matrices.
   */
  _sort(toView) {
    const { _depths: depths, _places: places, _order: order } = this;
    const { centers } = this._target;
    const ahead = this.mesh.getScene().useRightHandedSystem ? -1 : 1;
    const [x, y, z] = [2, 6, 10].map((index) => ahead * toView[index]);
    let [nearest, farthest] = [Infinity, -Infinity];
    for (let row = 0; row < depths.length; row++) {
      const depth = x * centers[4 * row] + y * centers[4 * row + 1] + z * centers[4 * row + 2];
      depths[row] = depth;
      if (depth < nearest) nearest = depth;
      if (depth > farthest) farthest = depth;
    }
    const steps = (DEPTHS - 1) / (farthest - nearest || 1);
    places.fill(0);
    for (let row = 0; row < depths.length; row++) {
      depths[row] = Math.floor(steps * (farthest - depths[row]));
      places[depths[row] + 1] += 1;
    }
    for (let depth = 1; depth < DEPTHS; depth++) places[depth] += places[depth - 1];
    for (let row = 0; row < depths.length; row++) order[places[depths[row]]++] = row;
  }

  /** Remove its mesh, and release its GPU memory. */
  destroy() {
    this.mesh.dispose();
  }
}
