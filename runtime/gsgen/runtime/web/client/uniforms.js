/**
 * The uniforms of a frame and of its pages, computed in float64 as Python computes them.
 *
 * Offsets and types of the fields come from the plans' document.
 */

import { eyeOf } from "./camera.js";
import { determinant, linearPart, product, relativeStretch, solve, times, transposed } from "./matrices.js";

const INFINITE_BOX = { low: [-Infinity, -Infinity, -Infinity], high: [Infinity, Infinity, Infinity] };

/**
 * A set of Gaussians as it is drawn.
 * @typedef {object} SplatSet
 * @property {readonly number[]} transform Local → world, 4×4 row by row.
 * @property {number | null} degree SH degree to draw; null for RGB.
 * @property {number} [opacityScale]
 * @property {"classic" | "mip"} [antialias]
 * @property {{low: number[], high: number[]} | null} [clip]
 * @property {{perCell: number, opacity_divisor: number, background: number,
 *     depth_range?: number | null} | null} [weighted] Weights of sums cell by cell.
 */
/**
 * @typedef {{set: SplatSet, base: number, capacity: number, count: number, firstRow?: number,
 *     firstGaussian?: number}} PlacedPage
 */

/** Writes fields of a uniform by their name. */
export class UniformWriter {
  constructor(structure, count = 1) {
    this.bytes = new ArrayBuffer(structure.size * count);
    this._view = new DataView(this.bytes);
    this._structure = structure;
  }

  /** @param {Record<string, number | readonly number[]>} fields @param {number} [index] */
  write(fields, index = 0) {
    for (const [name, values] of Object.entries(fields)) {
      const [type, , offset] = this._structure.fields[name];
      const first = index * this._structure.size + offset;
      [values].flat().forEach((value, i) => {
        if (type === "f4") this._view.setFloat32(first + 4 * i, value, true);
        else this._view.setUint32(first + 4 * i, value, true);
      });
    }
  }
}

/**
 * Return the bytes of the uniform `Frame`.
 * @param {import("./camera.js").Camera} camera
 * @param {readonly number[]} background Red, green, blue, multiplied by alpha.
 */
export function frameUniform(plans, camera, background) {
  const { JACOBIAN_MARGIN } = plans.constants;
  const uniform = new UniformWriter(plans.uniforms.frame);
  const { fx, fy, cx, cy, width, height } = camera;
  const [focal, center, size] = [[fx, fy], [cx, cy], [width, height]];
  const both = (formula) => [0, 1].map(formula);
  const margin = both((i) => (JACOBIAN_MARGIN * size[i]) / 2);
  const origin = both((i) => Math.min(Math.max(Math.floor(center[i]), 0), size[i]));
  uniform.write({
    focal, origin, size, near: camera.near, background: background.slice(0, 3),
    center: both((i) => center[i] - origin[i]),
    slope_low: both((i) => -(center[i] + margin[i]) / focal[i]),
    slope_high: both((i) => (size[i] - center[i] + margin[i]) / focal[i]),
    period: camera.kind === "panorama" ? 2 * Math.PI * camera.fx : 0,
  });
  return uniform.bytes;
}

/** Return the nine numbers of a 3×3 matrix as the columns of a WGSL matrix. */
function columns(matrix) {
  const m = transposed(matrix);
  return [m[0], m[1], m[2], 0, m[3], m[4], m[5], 0, m[6], m[7], m[8], 0];
}

const rest = (numbers) => numbers.map((number) => number - Math.fround(number));

/**
 * Return the bytes of the uniforms `Page` of all pages.
 * @param {PlacedPage[]} pages
 * @param {import("./camera.js").Camera} camera
 */
export function pageUniforms(plans, pages, camera) {
  const uniform = new UniformWriter(plans.uniforms.page, pages.length);
  const turn = linearPart(camera.view);
  const worldEye = eyeOf(camera);
  pages.forEach(({ set, base, capacity, count, firstRow = 0, firstGaussian = 0 }, index) => {
    const { transform } = set;
    const linear = linearPart(transform);
    const turned = product(turn, linear);
    const eye = solve(linear, worldEye.map((x, i) => x - transform[4 * i + 3]));
    const eyeRest = rest(eye);
    const eyeAt = times(turned, eyeRest).map((x) => -x);
    const { low, high } = set.clip ?? INFINITE_BOX;
    const fields = {
      linear: columns(turned),
      linear_rest: rest(columns(turned)),
      local_to_sh: columns(relativeStretch(linear)),
      eye, eye_rest: eyeRest, eye_at: eyeAt, eye_at_rest: rest(eyeAt),
      clip_low: low, clip_high: high, base, capacity, count,
      opacity_scale: set.opacityScale ?? 1,
      mip: Number(set.antialias === "mip"),
      degree: set.degree ?? plans.constants.NO_HARMONICS,
    };
    uniform.write(fields, index);
    if (camera.kind === "orthographic") uniform.write({ forward: solve(linear, turn.slice(6)) }, index);
    if (!set.weighted) return;
    const { perCell, opacity_divisor: divisor, background, depth_range: range } = set.weighted;
    // The depth range is a length of the set's own space.
    const inverse_range = range ? 1 / (range * Math.cbrt(Math.abs(determinant(linear)))) : 0;
    const first = { first_row: firstRow, first_gaussian: firstGaussian };
    const weights = { per_cell: perCell, inverse_range, inverse_divisor: 1 / divisor, behind: background };
    uniform.write({ ...first, ...weights }, index);
  });
  return uniform.bytes;
}

/**
 * Return the bytes of the uniform that shows an image on a canvas.
 * @param {import("./camera.js").Camera} camera
 * @param {[number, number]} surface Width and height of the canvas, in pixels.
 * @param {{mode: number, depths: [number, number], isLinear: boolean, backgroundAlpha: number}} look
 */
export function showingUniform(plans, camera, surface, look) {
  const uniform = new UniformWriter(plans.uniforms.showing);
  const [a, b, c, d, e, f, g, h, i] = linearPart(camera.view);
  const { mode, depths: [near, far] } = look;
  uniform.write({
    turn: [a, b, c, 0, d, e, f, 0, g, h, i, 0], // rows of world → camera
    size: [camera.width, camera.height],
    scale: [camera.width / surface[0], camera.height / surface[1]],
    row: camera.width, mode, near, far, is_linear: Number(look.isLinear),
    background_alpha: look.backgroundAlpha,
  });
  return uniform.bytes;
}
