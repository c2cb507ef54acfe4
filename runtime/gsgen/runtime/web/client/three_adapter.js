/**
 * Gaussians for three.js: fills its `GaussianSplat` with frames of a model, on WebGPU or WebGL 2.
 *
 * three.js has no call for changing splats yet, so private buffers are written. The range of
 * versions whose buffers are these is tested.
 */

import { composed, transposed4 } from "./matrices.js";
import { importThree } from "./three_modules.js";

export { THREE_REVISIONS, threeSettings } from "./three_modules.js";

const KERNEL = 0.3; // pixels² by which three.js widens Gaussians
const C0 = 0.28209479177387814; // of the constant spherical harmonic
const BAND_NUMBERS = [0, 9, 15, 21]; // coefficients of a band, of three colours
const BAND_BYTES = [0, 12, 16, 24]; // in whole words

/** Load three.js. @returns {Promise<{three: any, GaussianSplat: any}>} */
export async function loadThree() {
  const [three, { GaussianSplat }] = await importThree("objects/GaussianSplat.js");
  return { three, GaussianSplat };
}

/**
 * Return the plane of a camera whose square is what covariances in its view are widened by.
 *
 * three.js widens by 0.3 pixels² and takes opacity for it, by which the light of a Gaussian stays
 * √det Σ (Yu et al. 2023, "Mip-Splatting"). Elsewhere it is √det (Σ + 0.3): widened beforehand,
 * a Gaussian has this light.
 * @param {import("./camera.js").Camera} camera
 * @param {readonly number[]} transform From the axes of the rows to the world.
 */
export function wideningPlane({ view, fx, fy }, transform) {
  const pixel = Math.sqrt(KERNEL / (fx * fy)); // at depth 1, in world units
  return composed(view, transform).slice(8, 12).map((part) => pixel * part);
}

/** A `GaussianSplat` of three.js that shows frames of a model. */
export class ThreeGaussians {
  /**
   * @param {{three: any, GaussianSplat: any}} modules As `loadThree` returns them.
   * @param {Pick<import("./frames.js").Frames, "capacity" | "channels" | "space" | "transform" | "antialias"> &
   *     {stride?: number}} frames The model; the stride is how many numbers of appearance a row has.
   */
  constructor({ three, GaussianSplat }, { capacity, channels, space, transform, antialias, stride = channels }) {
    this._transform = transform;
    /** Whether frames are filled again when the camera moves. */
    this.needsCamera = antialias === "classic";
    this._isSh = space === "sh";
    this._stride = stride;
    this._degree = this._isSh ? Math.min(Math.sqrt(channels / 3) - 1, 3) : 0;
    const geometry = new three.BufferGeometry();
    const add = (name, array, size) => geometry.setAttribute(name, new three.BufferAttribute(array, size));
    add("position", new Float32Array(3 * capacity), 3);
    add("covariance", new Float32Array(6 * capacity), 6);
    add("color", new Uint8ClampedArray(4 * capacity), 4);
    for (let band = 1; band <= this._degree; band++) {
      const words = BAND_BYTES[band] / 4;
      add(`sphericalHarmonics${band}`, new Uint32Array(words * capacity), words);
    }
    /** What scenes of three.js hold; its matrix maps the rows' axes to the world. */
    this.object = new GaussianSplat(geometry);
    this.object.applyMatrix4(new three.Matrix4().fromArray(transposed4([...transform])));
    this.object.boundingSphere = new three.Sphere();
    /** @type {Float32Array | null} The appearance that is stored, of how many rows. */
    this._appearance = null;
    this._colored = 0;
  }

  /**
   * Show a frame.
   * @param {import("./frames.js").Frame} frame
   * @param {import("./camera.js").Camera | null} [camera] With one, models that are not of
   *     Mip-Splatting keep their opacity. Their frames have to be filled again when it moves.
   */
  fill({ rows, appearance, live }, camera = null) {
    const widened = camera && this.needsCamera ? wideningPlane(camera, this._transform) : [0, 0, 0, 0];
    const { _buffers: buffers, splatGeometry } = this.object;
    // three.js replaces arrays when it first draws them by WebGL.
    const attributes = ["centerRead", "covarianceARead", "covarianceBRead", "colorRead"].map((name) => buffers[name].value);
    const [centers, first, second, words] = attributes.map(({ array }) => array);
    const colors = new Uint8ClampedArray(words.buffer, words.byteOffset, words.byteLength);
    const positions = splatGeometry.getAttribute("position").array;
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    const { _stride: stride, _isSh: isSh } = this;
    const [scale, offset] = isSh ? [255 * C0, 127.5] : [255, 0];
    let [widest, allFinite] = [0, true];
    const isColored = appearance === this._appearance && live <= this._colored;
    for (let row = 0; row < live; row++) {
      const [from, to, color] = [10 * row, 4 * row, stride * row];
      let isFinite = true;
      for (let number = 0; number < 10; number++) isFinite &&= Math.abs(rows[from + number]) < Infinity;
      if (!isFinite) {
        allFinite = false;
        centers.fill(0, to, to + 3);
        positions.fill(0, 3 * row, 3 * row + 3);
        colors[to + 3] = 0;
        continue;
      }
      for (let axis = 0; axis < 3; axis++) {
        const center = rows[from + axis];
        centers[to + axis] = positions[3 * row + axis] = center;
        if (center < low[axis]) low[axis] = center;
        if (center > high[axis]) high[axis] = center;
        if (!isColored) colors[to + axis] = scale * appearance[color + axis] + offset;
      }
      colors[to + 3] = 255 * rows[from + 3];
      const root = widened[0] * rows[from] + widened[1] * rows[from + 1] + widened[2] * rows[from + 2] + widened[3];
      const extra = root * root;
      first[to] = rows[from + 4] + extra;
      first[to + 1] = rows[from + 5];
      first[to + 2] = rows[from + 6];
      first[to + 3] = rows[from + 7] + extra;
      second[to] = rows[from + 8];
      second[to + 1] = rows[from + 9] + extra;
      widest = Math.max(widest, rows[from + 4], rows[from + 7], rows[from + 9]);
    }
    for (let row = live; row < positions.length / 3; row++) colors[4 * row + 3] = 0;
    if (!isColored) {
      for (let band = 1; band <= this._degree; band++) attributes.push(this._fillBand(band, appearance, live));
      [this._appearance, this._colored] = [appearance, allFinite ? live : 0];
    }
    this.object._sphericalHarmonicsInitialized = false; // of three.js, which depend on the centres, too
    for (const attribute of attributes) {
      attribute.needsUpdate = true;
      if (attribute.pbo) attribute.pbo.needsUpdate = true;
    }
    if (low[0] <= high[0]) {
      const half = high.map((side, axis) => (side - low[axis]) / 2);
      this.object.boundingSphere.center.fromArray(low.map((side, axis) => side + half[axis]));
      this.object.boundingSphere.radius = Math.hypot(...half) + 2 * Math.sqrt(widest);
    }
    this.sort();
  }

  /** Write the harmonics of a band as bytes. */
  _fillBand(band, appearance, live) {
    const attribute = this.object._buffers[`sphericalHarmonics${band}Attribute`];
    const { buffer, byteOffset, byteLength } = attribute.array;
    const bytes = new Uint8ClampedArray(buffer, byteOffset, byteLength);
    for (let row = 0; row < live; row++) {
      const [from, to] = [this._stride * row + 3 * band * band, BAND_BYTES[band] * row];
      for (let index = 0; index < BAND_NUMBERS[band]; index++) bytes[to + index] = 128 * appearance[from + index] + 128;
    }
    return attribute;
  }

  /** Return nodes: the centre of a vertex's Gaussian, and the eye that sees its colours, in the rows' axes. */
  nodes({ instanceIndex }) {
    const { _buffers: buffers, _sort: sort, _localCameraPosition: eye } = this.object;
    return { center: buffers.centerRead.element(sort.orderRead.element(instanceIndex)).xyz, eye };
  }

  /** Sort in the next picture, however little the camera has turned. */
  sort() {
    this.object._sortInitialized = false;
  }

  /** Release its GPU memory. */
  destroy() {
    this.object.removeFromParent();
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}
