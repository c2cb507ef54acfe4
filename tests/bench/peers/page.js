// What the pages of all engines share: the first picture, moves of the camera, and pictures of them.

/**
 * Show a splat file by an engine, as its guide says, and let `window.bench` drive it.
 *
 * `engine.open(canvas, address, camera, onFrame)` calls `onFrame` after each frame that it renders,
 * and returns `look(camera)`, which moves the camera, and `isSorted()`: whether the last frame was
 * drawn in the order of its camera. An engine that rests returns `lastPicture()` in place of it.
 */
export async function run(engine) {
  const { src, camera } = JSON.parse(decodeURIComponent(location.hash.slice(1)));
  const canvas = document.querySelector("canvas");
  let seen = () => {};
  const frame = () => new Promise((resolve) => (seen = resolve));
  const opened = engine.open(canvas, src, camera, () => seen());
  // Pixels are read in the task of the frame: a canvas keeps them no longer.
  const picture = () => (engine.canvas?.() ?? canvas).toDataURL();
  const framePicture = () => new Promise((resolve) => (seen = () => resolve(picture())));
  const settled = async () => {
    const { isSorted, lastPicture } = await opened;
    if (lastPicture) return lastPicture();
    return new Promise((resolve) => (seen = () => isSorted() && resolve(picture())));
  };
  const looked = async (next) => {
    (await opened).look(next);
    return framePicture();
  };
  const moved = async (cameras) => {
    const { look } = await opened;
    for (const next of cameras.slice(0, -1)) {
      look(next);
      await frame();
    }
    return looked(cameras.at(-1));
  };
  return { settled, looked, moved };
}

/** Return where a camera is, a point in front of it, and which way is up. */
export function placeOf({ view }) {
  const row = (index) => view.slice(4 * index, 4 * index + 3);
  const shift = [3, 7, 11].map((index) => view[index]);
  const eye = [0, 1, 2].map((axis) => -(row(0)[axis] * shift[0] + row(1)[axis] * shift[1] + row(2)[axis] * shift[2]));
  return { eye, target: eye.map((part, axis) => part + row(2)[axis]), up: row(1).map((part) => -part) };
}

/** Return the vertical field of view of a camera, in degrees. */
export const fieldOfView = ({ fy, height }) => (2 * Math.atan(height / (2 * fy)) * 180) / Math.PI;

/** Give a camera of three.js the place and the lens of a camera. */
export function placeThree(own, camera) {
  const { eye, target, up } = placeOf(camera);
  own.position.fromArray(eye);
  own.up.fromArray(up);
  own.lookAt(...target);
  own.fov = fieldOfView(camera);
  own.updateProjectionMatrix();
}
