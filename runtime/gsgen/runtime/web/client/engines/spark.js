/** Gaussians for Spark 2.2: fills its `ExtSplats` with frames of a model, in scenes of three.js. */

import { Ellipsoids, requireCalls } from "./ellipsoids.js";

const LEAST_SCALE = 1e-9; // whose logarithm is a half float

/** A `SplatMesh` of Spark that shows frames of a model. */
export class SparkGaussians {
  /**
   * Return the settings of a `SparkRenderer` that draw a model's Gaussians as it was trained; they
   * are those of all splats in its scene.
   * @param {Pick<import("../frames.js").Frames, "antialias">} frames
   */
  static settings({ antialias }) {
    return antialias === "mip" ? { preBlurAmount: 0, blurAmount: 0.3 } : { preBlurAmount: 0.3, blurAmount: 0 };
  }

  /**
   * @param {any} spark The module `@sparkjsdev/spark`.
   * @param {import("./ellipsoids.js").Format} frames The model.
   * @throws {import("../errors.js").GsgenError} The module is older than its calls.
   */
  constructor(spark, frames) {
    requireCalls("@sparkjsdev/spark", "older", "2.2", "ExtSplats" in spark && !!spark.utils?.encodeExtSplat);
    const { capacity } = frames;
    this._ellipsoids = new Ellipsoids(frames);
    /** @type {{low: number[], high: number[]}} Box of three standard deviations around the frame. */
    this.bounds = this._ellipsoids;
    /** Whether frames are filled again when the camera moves. */
    this.needsCamera = this._ellipsoids.needsCamera;
    this._target = this._ellipsoids.target();
    this._encode = spark.utils.encodeExtSplat;
    const { maxSplats } = spark.utils.getTextureSize(capacity);
    this._splats = new spark.ExtSplats({ extArrays: [0, 1].map(() => new Uint32Array(4 * maxSplats)), numSplats: capacity });
    /** What scenes of three.js hold; its axes are the model's. */
    this.object = new spark.SplatMesh({ extSplats: this._splats, editable: false });
  }

  /**
   * Show a frame.
   * @param {import("../frames.js").Frame} frame
   * @param {any} [camera] Of three.js, of which colours of models with `needsCamera` depend: they
   *     are filled again when it moves.
   */
  fill(frame, camera = null) {
    const { object, _splats: splats, _encode: encode } = this;
    const eye = camera && this.needsCamera ? object.worldToLocal(camera.getWorldPosition(object.position.clone())).toArray() : null;
    this._ellipsoids.write(frame, this._target, eye);
    const { centers, scales, rotations, colors } = this._target;
    for (let row = 0; row < this._ellipsoids.capacity; row++) {
      const [x, y, z, w] = [4 * row, 4 * row + 1, 4 * row + 2, 4 * row + 3];
      encode(
        splats.extArrays, row, centers[x], centers[y], centers[z],
        Math.max(scales[x], LEAST_SCALE), Math.max(scales[y], LEAST_SCALE), Math.max(scales[z], LEAST_SCALE),
        rotations[x], rotations[y], rotations[z], rotations[w], colors[w], colors[x], colors[y], colors[z],
      );
    }
    for (const texture of splats.textures) texture.needsUpdate = true;
    // The number stays: rows of another number would be drawn only once they are sorted.
    object.updateVersion();
  }

  /** Remove its object, and release its GPU memory. */
  destroy() {
    this.object.removeFromParent();
    this.object.dispose();
  }
}
