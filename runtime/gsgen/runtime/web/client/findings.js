/** Judges a model by the rules of the contract that need neither a run, nor ONNX, nor other files. */

import * as contract from "./contract_rules.js";
import { GsgenError, failing } from "./errors.js";
import { Message } from "./onnx_file.js";

/** @typedef {{rule: string, severity: string, where: string, actual: string, expected: string,
 *     hint: string, certainty: string, limit: string}} PageFinding */

const KIND_HINTS = {
  "gaussian-generator": "Show a generator; models that change pictures go into the attribute posts.",
  "post-process": "Show it by the attribute src; posts are models that change pictures.",
};

/** Return what rules read of a model: its file, graph and manifest. @param {Uint8Array} bytes */
export function inspected(bytes, { name = "model", target = "webgpu" } = {}) {
  const proto = new Message(contract.MESSAGES, "onnx.ModelProto", bytes);
  const file = new contract.ModelFile(name, bytes.length, proto, 0, [], true);
  const graph = contract.readGraph(file);
  const parsed = file.manifest_text === null ? null : contract.parseManifest(file.manifest_text);
  const candidate = parsed ? null : contract.inferManifest(graph, name);
  const known = contract.TARGETS.get(target);
  if (!known) failing(name)(`has no target ${target}`, `One of ${[...contract.TARGETS.keys()].join(", ")}.`);
  return new contract.InspectedModel(file, graph, parsed, candidate, known);
}

/** Return what is wrong with a model, as far as a page checks it. @returns {PageFinding[]} */
export function findingsOf(subject) {
  const { target, kind } = subject;
  const open = subject.graph.outputs.filter(({ dtype, dims }) => !dtype || !dims?.every(Number.isInteger));
  const unknown = open.map(({ name }) => `output ${name}`); // until ONNX infers their shapes
  const [findings, broken] = [[], new Set()];
  for (const { check, id, hint, ...rule } of contract.RULES) {
    const isOfTarget = [target.name, ""].includes(rule.target) && (!rule.limit || target.limits.has(rule.limit));
    if (!isOfTarget || (kind && !rule.kinds.includes(kind))) continue;
    const isBlocked = rule.needs.some((need) => broken.has(need));
    const violations = isBlocked ? [] : [...check(subject)];
    const severity = target.severities.get(id) ?? rule.severity;
    if (isBlocked || violations.length) broken.add(id);
    const known = violations.filter(({ where }) => !unknown.includes(where));
    findings.push(...known.map((violation) => ({ rule: id, severity, hint, limit: rule.limit, ...violation })));
  }
  return findings;
}

/**
 * What is known of a model before it runs.
 * @typedef {object} Inspected
 * @property {any} manifest
 * @property {PageFinding[]} findings
 * @property {{name: string, dtype: string, dims: (number | string)[]}[]} inputs
 * @property {{name: string, varies: boolean, isCopied: boolean}[]} outputs Whether each depends on
 *     an input, and is a buffer copy, which a captured graph does not record.
 */
/**
 * Return what is known of a model; throw where it breaks a rule.
 * @param {Uint8Array} bytes
 * @param {string} [kind] What the model has to be.
 * @returns {Inspected}
 */
export function inspectedModel(bytes, name, target, kind = "gaussian-generator") {
  const fail = failing(name, "Download it again, or see what is wrong: gsgen validate MODEL");
  let subject, findings;
  try {
    subject = inspected(bytes, { name, target });
    findings = findingsOf(subject);
  } catch (error) {
    if (error instanceof RangeError) fail(`is not a whole ONNX file: ${error.message}`);
    throw error;
  }
  // Whether a model exceeds the limits of the target is for the device to say.
  const fatal = findings.find(({ severity, limit }) => severity === "error" && !limit);
  if (fatal) {
    const { rule, where, actual, expected, hint } = fatal;
    const command = "All rules: gsgen validate MODEL";
    throw new GsgenError(`${where}: ${actual}, expected ${expected}`, {
      where: name, hint: `${hint} ${command}`, rule, findings,
    });
  }
  const { extensions_required: required } = subject.manifest;
  if (subject.kind !== kind) fail(`is a ${subject.kind}, expected a ${kind}`, KIND_HINTS[kind]);
  if (required.length) fail(`requires extensions: ${required}`, "Ask its author for a copy without.");
  const { graph, file } = subject;
  const outputs = graph.output_names.map((output) => {
    const { op_type, input } = graph.producers.get(output) ?? {};
    return { name: output, varies: graph.varies(output), isCopied: !op_type || contract.isCopy(op_type, input.length, true) };
  });
  const inputs = graph.inputs.map((input) => ({ name: input.name, dtype: input.dtype, dims: input.dims && [...input.dims] }));
  return { manifest: JSON.parse(file.manifest_text), findings, inputs, outputs };
}
