/** Several sets of Gaussians as one in the world, coloured for a camera: three.js sorts only within an object. */

import { eyeOf } from "./camera.js";
import { harmonics } from "./harmonics.js";
import { linearPart, normalized, plus, relativeStretch, solve, times } from "./matrices.js";
import { numbersOf } from "./memory_device.js";
import { wideningPlane } from "./three_adapter.js";

const LEAST_OPACITY = 1 / 255; // that is drawn

/** Return the rows and the appearance of a set. */
export function arraysOf({ buffers: { pages: [page] } }) {
  return { rows: numbersOf(page.rows), appearance: numbersOf(page.appearance) };
}

/**
 * Write what a camera sees of sets as rows of the world and colours.
 * @param {import("./renderer.js").PlacedSet[]} sets
 * @param {import("./camera.js").Camera} camera
 * @param {{rows: Float32Array, appearance: Float32Array}} target Ten and three numbers a row.
 * @returns {number} How many rows were written.
 */
export function mergeSets(sets, camera, { rows, appearance }) {
  let live = 0;
  for (const set of sets) {
    const { transform, buffers, clip, opacityScale = 1 } = set;
    const { rows: own, appearance: colors } = arraysOf(set);
    const { stride } = buffers;
    const linear = linearPart(transform);
    const plane = (set.antialias ?? buffers.antialias) === "classic" ? wideningPlane(camera, transform) : [0, 0, 0, 0];
    const eye = solve(linear, plus(eyeOf(camera), -1, [3, 7, 11].map((index) => transform[index])));
    const toSh = relativeStretch(linear);
    const degree = set.degree !== undefined ? set.degree : buffers.degree;
    const [a, b, c, d, e, f, g, h, i] = linear;
    for (let row = 0; row < buffers.count; row++) {
      const from = 10 * row;
      const [x, y, z] = [own[from], own[from + 1], own[from + 2]];
      const opacity = opacityScale * own[from + 3];
      const isInside = !clip || [x, y, z].every((part, axis) => part >= clip.low[axis] && part <= clip.high[axis]);
      if (!(opacity >= LEAST_OPACITY) || !isInside) continue;
      const [xx, xy, xz, yy, yz, zz] = [own[from + 4], own[from + 5], own[from + 6], own[from + 7], own[from + 8], own[from + 9]];
      // The covariance in the world, A Σ Aᵀ, widened.
      const [p, q, r] = [a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz];
      const [s, t, u] = [d * xx + e * xy + f * xz, d * xy + e * yy + f * yz, d * xz + e * yz + f * zz];
      const [v, w, k] = [g * xx + h * xy + i * xz, g * xy + h * yy + i * yz, g * xz + h * yz + i * zz];
      const extra = (plane[0] * x + plane[1] * y + plane[2] * z + plane[3]) ** 2;
      const to = 10 * live;
      rows[to] = a * x + b * y + c * z + transform[3];
      rows[to + 1] = d * x + e * y + f * z + transform[7];
      rows[to + 2] = g * x + h * y + i * z + transform[11];
      rows[to + 3] = opacity;
      rows[to + 4] = p * a + q * b + r * c + extra;
      rows[to + 5] = p * d + q * e + r * f;
      rows[to + 6] = p * g + q * h + r * i;
      rows[to + 7] = s * d + t * e + u * f + extra;
      rows[to + 8] = s * g + t * h + u * i;
      rows[to + 9] = v * g + w * h + k * i + extra;
      if (degree === null) appearance.set(colors.subarray(stride * row, stride * row + 3), 3 * live);
      else {
        const weights = harmonics(normalized(times(toSh, [x - eye[0], y - eye[1], z - eye[2]])));
        for (let part = 0; part < 3; part++) {
          let sum = 0.5;
          for (let index = 0; index < (degree + 1) ** 2; index++) sum += weights[index] * colors[stride * row + 3 * index + part];
          appearance[3 * live + part] = sum;
        }
      }
      live += 1;
    }
  }
  return live;
}
