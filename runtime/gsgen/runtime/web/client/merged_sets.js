/** Several sets of Gaussians as one in the world, coloured for a camera: three.js sorts only within an object. */

import { eyeOf } from "./camera.js";
import { writeColor } from "./harmonics.js";
import { linearPart, placeRow, plus, relativeStretch, solve } from "./matrices.js";
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
    const { transform, buffers, buffers: { stride }, clip, opacityScale = 1, degree = buffers.degree, antialias = buffers.antialias } = set;
    const { rows: own, appearance: colors } = arraysOf(set);
    const linear = linearPart(transform);
    const plane = antialias === "classic" ? wideningPlane(camera, transform) : [0, 0, 0, 0];
    const eye = solve(linear, plus(eyeOf(camera), -1, [3, 7, 11].map((index) => transform[index])));
    const toSh = relativeStretch(linear);
    for (let row = 0; row < buffers.count; row++) {
      const from = 10 * row, x = own[from], y = own[from + 1], z = own[from + 2];
      const opacity = opacityScale * own[from + 3];
      const isInside = !clip || [x, y, z].every((part, axis) => part >= clip.low[axis] && part <= clip.high[axis]);
      if (!(opacity >= LEAST_OPACITY) || !isInside) continue;
      placeRow(transform, own, from, rows, 10 * live);
      const extra = (plane[0] * x + plane[1] * y + plane[2] * z + plane[3]) ** 2;
      rows[10 * live + 3] = opacity;
      for (const square of [4, 7, 9]) rows[10 * live + square] += extra;
      if (degree === null) appearance.set(colors.subarray(stride * row, stride * row + 3), 3 * live);
      else writeColor(toSh, x - eye[0], y - eye[1], z - eye[2], degree, colors, stride * row, appearance, 3 * live);
      live += 1;
    }
  }
  return live;
}
