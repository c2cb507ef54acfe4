/**
 * Frame plans as data: evaluates their formulas, and chooses the plan of an image.
 *
 * The document `plans.json` is recorded from the renderer in Python. It holds all buffers, kernels,
 * bind groups and dispatches of a frame; this client knows none of them by name.
 */

import { download, parsedJson } from "./download.js";
import { failing } from "./errors.js";

/** @typedef {number | string | [string, ...any[]]} Formula */
/** @typedef {Record<string, number>} Sizes Name of a size → its value. */
/**
 * @typedef {object} Plan
 * @property {string[]} outputs The images that it draws.
 * @property {boolean} panorama
 * @property {boolean} deep Whether depths are sorted by two keys.
 * @property {boolean} weighted Whether Gaussians are summed cell by cell.
 * @property {number} layers Image layers among the Gaussians.
 * @property {Formula[]} guards Conditions under which the plan has these steps.
 * @property {[number, number, number | null][]} clears Buffer, offset and size of cleared bytes.
 * @property {Record<string, (number | Record<string, number>)[]>} stages
 * @property {Record<string, number>} images Buffer of each output.
 * @property {Record<string, number>} inputs Buffer of each uniform, and of the counts.
 */
/** @typedef {Record<string, any> & {plans: Plan[]}} PlanDocument */

const OPERATORS = {
  add: (a, b) => a + b,
  sub: (a, b) => a - b,
  mul: (a, b) => a * b,
  floor_div: (a, b) => Math.floor(a / b),
  ceil_div: (a, b) => Math.ceil(a / b),
  abs: (a) => Math.abs(a),
  bits: (a) => (a === 0 ? 0 : Math.abs(a).toString(2).length),
  le: (a, b) => a <= b,
};

/** Return the value of a formula; conditions are 0 or 1. @param {Formula} formula @returns {number} */
export function evaluate(formula, sizes) {
  if (typeof formula === "number") return formula;
  if (typeof formula === "string") {
    if (!(formula in sizes)) throw new Error(`the size ${formula} is not known`);
    return sizes[formula];
  }
  const [name, ...operands] = formula;
  const [a, b] = operands.map((operand) => evaluate(operand, sizes));
  return Number(OPERATORS[name](a, b));
}

/**
 * Return the first plan of a shape whose guards hold for the sizes.
 * @param {Pick<Plan, "outputs" | "panorama" | "deep" | "weighted" | "layers">} shape
 * @returns {Plan}
 */
export function choosePlan(plans, shape, sizes) {
  const outputs = shape.outputs.join();
  const plan = plans.plans.find(
    (plan) =>
      plan.outputs.join() === outputs &&
      ["panorama", "deep", "weighted", "layers"].every((name) => plan[name] === shape[name]) &&
      plan.guards.every((guard) => evaluate(guard, sizes)),
  );
  return plan ?? failing("image", "Show a smaller element.")(`no frame plan draws ${outputs} at ${sizes.width}×${sizes.height}`);
}

/** Load the plans that lie beside this module. @returns {Promise<PlanDocument>} */
export async function loadPlans(address = new URL("./plans.json", import.meta.url)) {
  return parsedJson(await download(String(address)));
}
