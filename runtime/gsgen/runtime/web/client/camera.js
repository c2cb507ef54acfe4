/** Cameras in the OpenCV convention: +x right, +y down, +z forward. */

import { cross, linearPart, normalized, plus, times, transposed } from "./matrices.js";

/**
 * @typedef {object} Camera
 * @property {number[]} view World → camera, 4×4 row by row.
 * @property {number} fx Focal length in pixels; of a panorama pixels per radian.
 * @property {number} fy
 * @property {number} cx Principal point, in pixels.
 * @property {number} cy
 * @property {number} width
 * @property {number} height
 * @property {number} near
 * @property {"pinhole" | "orthographic" | "panorama"} [kind]
 */

export const DEFAULT_NEAR = 0.01;

/** Return the camera centre −Rᵀt. @param {Camera} camera */
export function eyeOf(camera) {
  const { view } = camera;
  return times(transposed(linearPart(view)), [view[3], view[7], view[11]]).map((x) => -x);
}

/** Return the matrix world → camera of a rotation (3×3) and a camera centre. */
export function viewOf(turn, eye) {
  const [x, y, z] = times(turn, eye);
  const [a, b, c, d, e, f, g, h, i] = turn;
  return [a, b, c, -x, d, e, f, -y, g, h, i, -z, 0, 0, 0, 1];
}

/** Return the rotation world → camera of a camera that looks along `forward`. */
export function turnTowards(forward, up) {
  const ahead = normalized(forward);
  let right = cross(ahead, [...up]);
  if (Math.hypot(...right) <= 1e-9 * Math.hypot(...up)) {
    const sizes = ahead.map(Math.abs);
    const least = sizes.indexOf(Math.min(...sizes));
    right = cross(ahead, [0, 1, 2].map((index) => Number(index === least)));
  }
  right = normalized(right);
  return [...right, ...cross(ahead, right), ...ahead];
}

/** Return the world position at a pixel and a depth of a pinhole image. @param {Camera} camera */
export function unproject(camera, x, y, depth) {
  const [across, down] = [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy];
  const local = [across * depth, down * depth, depth];
  return plus(eyeOf(camera), 1, times(transposed(linearPart(camera.view)), local));
}
