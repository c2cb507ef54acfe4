/** Gaussians for PlayCanvas 2.23: fills its `GSplatContainer` with frames of a model. */

import { Ellipsoids, requireCalls } from "./ellipsoids.js";

const STREAMS = { centers: "gsgenCenter", scales: "gsgenScale", rotations: "gsgenRotation", colors: "gsgenColor" };
const READ_GLSL = `
vec3 getCenter() { return loadGsgenCenter().xyz; }
vec4 getColor() { return loadGsgenColor(); }
vec3 getScale() { return loadGsgenScale().xyz; }
vec4 getRotation() { return loadGsgenRotation().wxyz; }
`;
const READ_WGSL = `
fn getCenter() -> vec3f { return loadGsgenCenter().xyz; }
fn getColor() -> vec4f { return loadGsgenColor(); }
fn getScale() -> vec3f { return loadGsgenScale().xyz; }
fn getRotation() -> vec4f { return loadGsgenRotation().wxyz; }
`;

/** An entity of PlayCanvas that shows frames of a model. */
export class PlayCanvasGaussians {
  /**
   * Return the settings of an application's `scene.gsplat` that draw a model's Gaussians as it was
   * trained; they are those of all splats in its scene.
   * @param {Pick<import("../frames.js").Frames, "antialias">} frames
   */
  static settings({ antialias }) {
    return { antiAlias: antialias === "mip" };
  }

  /**
   * @param {any} pc The module `playcanvas`.
   * @param {any} device The application's `graphicsDevice`; it has a `gsplat` component system.
   * @param {import("./ellipsoids.js").Format} frames The model.
   * @throws {import("../errors.js").GsgenError} The module is older than its `GSplatContainer`.
   */
  constructor(pc, device, frames) {
    requireCalls("playcanvas", pc.version, "2.23", "WORKBUFFER_UPDATE_ALWAYS" in pc && "GSplatContainer" in pc);
    this._ellipsoids = new Ellipsoids(frames);
    /** Whether frames are filled again when the camera moves. */
    this.needsCamera = this._ellipsoids.needsCamera;
    const streams = Object.values(STREAMS).map((name) => ({ name, format: pc.PIXELFORMAT_RGBA32F }));
    const format = new pc.GSplatFormat(device, streams, { readGLSL: READ_GLSL, readWGSL: READ_WGSL });
    /** The engine's own object, for components of other entities. */
    this.container = new pc.GSplatContainer(device, frames.capacity, format);
    this._point = new pc.Vec3();
    this._inverse = new pc.Mat4();
    /** What scenes hold; its axes are the model's. */
    this.entity = new pc.Entity("gsgen");
    this.entity.addComponent("gsplat", { resource: this.container });
    // Otherwise rows are copied only when an entity moves or a sort ends, and an older frame shows.
    this.entity.gsplat.workBufferUpdate = pc.WORKBUFFER_UPDATE_ALWAYS;
  }

  /**
   * Show a frame.
   * @param {import("../frames.js").Frame} frame
   * @param {any} [camera] The entity of the camera, of which colours of models with `needsCamera`
   *     depend: they are filled again when it moves.
   */
  fill(frame, camera = null) {
    const { container, _ellipsoids: ellipsoids } = this;
    const textures = Object.values(STREAMS).map((name) => container.getTexture(name));
    const [centers, scales, rotations, colors] = textures.map((texture) => texture.lock());
    let eye = null;
    if (camera && this.needsCamera) {
      this._inverse.copy(this.entity.getWorldTransform()).invert().transformPoint(camera.getPosition(), this._point);
      eye = [this._point.x, this._point.y, this._point.z];
    }
    ellipsoids.write(frame, { centers, scales, rotations, colors }, eye);
    for (const texture of textures) texture.unlock();
    // The processor's sort reads centres of its own.
    const sorted = container.centers;
    for (let row = 0; row < ellipsoids.capacity; row++) {
      for (let axis = 0; axis < 3; axis++) sorted[3 * row + axis] = centers[4 * row + axis];
    }
    const { low, high } = ellipsoids;
    const { center, halfExtents } = container.aabb;
    center.set(...low.map((part, axis) => (part + high[axis]) / 2));
    halfExtents.set(...low.map((part, axis) => (high[axis] - part) / 2));
    // The number stays: rows of another number would be drawn only once they are sorted.
    container.update();
  }

  /** Remove its entity, and release its GPU memory. */
  destroy() {
    this.entity.destroy();
    this.container.destroy();
  }
}
