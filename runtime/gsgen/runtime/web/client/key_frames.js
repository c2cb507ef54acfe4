/** Key frames: numbers that go from one value to the next, as scene files say when. */

import { GsgenError } from "./errors.js";
import { hintAmong } from "./words.js";

const INDICES = ["frame_index", "appearance_id"]; // roles of whole numbers

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

/** Return the values of inputs with key frames at a time, and those of the others. */
export function inputsAt(inputs, seconds, { inputs: specs }) {
  const [keyed, fixed] = [{}, {}];
  for (const [name, value] of Object.entries(inputs)) {
    if (!isKeyed(value)) fixed[name] = value;
    else {
      const numbers = valueAt(value.keys, seconds);
      const spec = specs.find((each) => each.name === name) ?? specs.find((each) => each.role === name);
      keyed[spec.name] = INDICES.includes(spec.role) ? numbers.map(Math.round) : numbers;
    }
  }
  return [keyed, fixed];
}

/** Return the names of values that no input has, each with what helps. */
export function unknownInputs(inputs, specs) {
  const known = specs.flatMap(({ name, role }) => [name, role]).filter(Boolean);
  const unknown = Object.keys(inputs).filter((name) => !known.includes(name));
  return unknown.map((name) => ({ name, hint: hintAmong(name, known) }));
}

/** Refuse values of inputs that a model lacks. */
export function checkInputs(inputs, { inputs: specs }, where) {
  for (const { name, hint } of unknownInputs(inputs, specs)) {
    throw new GsgenError("is no input of the model", { where: `${where}.inputs.${name}`, hint });
  }
}
