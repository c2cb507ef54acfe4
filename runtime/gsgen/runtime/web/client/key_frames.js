/** Key frames: numbers that go from one value to the next, as scene files say when. */

/** How far a value is between two key frames, of how much of the time has passed. */
export const EASINGS = {
  linear: (share) => share,
  "ease-in": (share) => share ** 2,
  "ease-out": (share) => 1 - (1 - share) ** 2,
  "ease-in-out": (share) => share ** 2 * (3 - 2 * share),
  hold: () => 0,
};

/**
 * @typedef {{at: number, value: number[], easing: keyof typeof EASINGS}} KeyFrame
 *     `at` is in seconds; the easing is that of the way to the next one.
 */

/** Return whether a value has key frames, and is no list. */
export const isKeyed = (value) => Array.isArray(value?.keys);

/** Return the numbers at a time; before the first and after the last key frame they stand still. */
export function valueAt(/** @type {KeyFrame[]} */ keys, /** @type {number} */ seconds) {
  const next = keys.findIndex(({ at }) => at > seconds);
  if (next <= 0) return keys[next === 0 ? 0 : keys.length - 1].value;
  const [from, to] = [keys[next - 1], keys[next]];
  const share = EASINGS[from.easing]((seconds - from.at) / (to.at - from.at));
  return from.value.map((number, i) => number + (to.value[i] - number) * share);
}
