// A validator of Gaussian Generators, written from the specification alone.
//
//     node second_reader.mjs [--target NAME] [--ort FOLDER] MODEL.onnx …
//     node second_reader.mjs [--ort FOLDER] KIT/index.json
//
// It prints one JSON object for each model: the verdict, and what was found. With --ort, a folder of
// ONNX Runtime Web, models are run at the probes that the kit gives (level `values`).

import fs from 'node:fs';
import path from 'node:path';
import {Graph} from './graph.mjs';
import {readModel, Unreadable} from './onnx_file.mjs';
import {readManifest, rules as manifestRules} from './static_manifest.mjs';
import {rules as graphRules} from './static_graph.mjs';
import {startRuntime, rules as valueRules} from './values.mjs';

// A rule stands behind those that it needs.
const STATIC = graphRules.merged(manifestRules);

/** Validate one file; `probes` are the inputs of its runs, `runtime` runs it. */
async function validate(file, {target = 'core', probes, runtime}) {
  const bytes = fs.readFileSync(file);
  let model;
  try {
    model = readModel(bytes);
  } catch (error) {
    if (!(error instanceof Unreadable)) throw error;
    return {verdict: 'unreadable', level: 'static', findings: [{message: error.message}]}; // V21
  }
  const read = readManifest(model);
  const opset = model.opsets.find(({domain}) => !domain || domain === 'ai.onnx')?.version;
  const subject = {file, folder: path.dirname(file), size: bytes.length, bytes, target, model, read, opset,
    manifest: read.manifest, graph: new Graph(model), probes, runtime};
  const report = {findings: [], blocked: new Set()};
  const level = runtime && probes ? 'values' : 'static';
  try {
    await STATIC.run(subject, report);
    if (level === 'values') await valueRules.run(subject, report);
  } catch (error) { // V14: nothing is said of the model
    return {verdict: 'internal-error', level, findings: [], error: error.stack};
  }
  const invalid = report.findings.some((finding) => // V14
    finding.severity === 'error' && finding.certainty === 'confirmed');
  return {verdict: invalid ? 'invalid' : 'conforms', level, findings: report.findings};
}

const options = {};
const files = [];
for (let words = process.argv.slice(2); words.length;) {
  const word = words.shift();
  if (word.startsWith('--')) options[word.slice(2)] = words.shift();
  else files.push(word);
}
const runtime = options.ort && await startRuntime(options.ort);
for (const file of files) {
  const folder = path.dirname(file);
  const entries = file.endsWith('.json') ? JSON.parse(fs.readFileSync(file, 'utf8')).models
    : [{model: path.basename(file), target: options.target}];
  for (const {model, target, probes} of entries) {
    const inputs = probes && JSON.parse(fs.readFileSync(path.resolve(folder, probes), 'utf8'));
    const result = await validate(path.join(folder, model), {target, probes: inputs, runtime});
    console.log(JSON.stringify({model, ...result}));
  }
}
process.exit(); // ONNX Runtime Web keeps threads
