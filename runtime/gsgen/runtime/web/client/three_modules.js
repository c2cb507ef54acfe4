/** Loads modules of three.js, an optional peer, and places its cameras as the client's stand. */

import { GsgenError } from "./errors.js";
import { composed, transposed4 } from "./matrices.js";

/** The first and the last revision of three.js whose private buffers are known here. */
export const THREE_REVISIONS = Object.freeze([187, 187]);

/**
 * How modules of three.js are loaded, if not by the page's import map.
 * @type {{load: ((name: string) => Promise<any>) | null}} A function of a name that imports it, for
 *     bundlers: `{ "three/webgpu": () => import("three/webgpu") }[name]()`.
 */
export const threeSettings = { load: null };

const RADIANS = Math.PI / 180;
const FAR_RATIO = 1e5; // of the far plane's distance to the near plane's
// three.js looks along −z with y up; the client's cameras look along +z with y down.
export const CAMERA_AXES = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1];

/**
 * Load three.js and addons of it.
 * @param {string[]} addons Such as `loaders/GLTFLoader.js`.
 * @returns {Promise<any[]>} The module of three.js, and those of the addons.
 */
export async function importThree(...addons) {
  const [first, last] = THREE_REVISIONS;
  const hint = `Name three.js r${last} in the page's import map: three, three/webgpu, three/tsl and three/addons/.`;
  const load = threeSettings.load ?? ((name) => import(/* @vite-ignore */ /* webpackIgnore: true */ name));
  let modules;
  try {
    modules = await Promise.all(["three/webgpu", ...addons.map((name) => `three/addons/${name}`)].map((name) => load(name)));
  } catch (error) {
    throw new GsgenError(`three.js cannot be loaded: ${error.message}`, { hint });
  }
  const { REVISION } = modules[0];
  const revision = Number.parseInt(REVISION, 10);
  if (!(revision >= first && revision <= last)) {
    throw new GsgenError(`three.js is r${REVISION}, expected r${first} to r${last}`, { hint });
  }
  return modules;
}

/** Give a perspective camera of three.js the view and the lens of one of the client. */
export function placeEye(eye, { view, fx, fy, width, height, near }) {
  eye.matrixAutoUpdate = false;
  eye.fov = (2 * Math.atan(height / (2 * fy))) / RADIANS;
  eye.aspect = (width / fx) * (fy / height);
  [eye.near, eye.far] = [near, FAR_RATIO * near];
  eye.updateProjectionMatrix();
  eye.matrix.fromArray(transposed4(composed(CAMERA_AXES, view))).invert();
  eye.matrixWorldNeedsUpdate = true;
}
