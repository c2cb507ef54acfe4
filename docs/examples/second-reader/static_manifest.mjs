// Level `static`: the manifest, its inputs, and the files beside the model.

import {createHash} from 'node:crypto';
import fs from 'node:fs';
import path from 'node:path';
import {DTYPE, DTYPE_BYTES, DTYPE_NAME} from './onnx_file.mjs';
import {breach, readDocument} from './json_text.mjs';
import {PORTABLE_1} from './operators.mjs';
import {ALL, Rules} from './rules.mjs';

const KEYS = ['gsgen.manifest', 'gaussian-generator.manifest']; // I11, I12
const SCHEMAS = new URL('../../spec/schemas/', import.meta.url);
export const rules = new Rules('static');
const rule = rules.add.bind(rules);

/** Read the manifest of `model` as I13 and M74 say; the result has `manifest` or `error`. */
export function readManifest(model) {
  const entries = model.metadata.filter((entry) => KEYS.includes(entry.key));
  const stored = (key) => entries.findLast((entry) => entry.key === key)?.value;
  const value = stored(KEYS[0]) ?? stored(KEYS[1]);
  if (!value) return {};
  try {
    const text = new TextDecoder('utf-8', {fatal: true, ignoreBOM: true}).decode(value);
    const document = readDocument(text);
    const words = /^([0-9]{1,5})\.([0-9]{1,5})$/.exec(document.contract); // M74.1
    if (typeof document.contract !== 'string' || !words) return {version: `contract ${document.contract}`};
    const [major, minor] = [Number(words[1]), Number(words[2])];
    if (major !== 1) return {version: `contract ${document.contract}`};
    const schema = ALL.includes(document.kind) && JSON.parse(
      fs.readFileSync(new URL(`${document.kind}-1.0.schema.json`, SCHEMAS), 'utf8'));
    const error = schema ? breach(document, schema, schema, 'manifest', minor > 2)
      : `kind is ${document.kind}`;
    return {manifest: error ? undefined : document, error, minor};
  } catch (problem) {
    return {error: problem.message};
  }
}

/** Why `name` is not a file of the model's folder (I10), or undefined. */
export function outside(folder, name) {
  if (!name) return 'a file without a name';
  const parts = name.split('/');
  if (name.startsWith('/') || name.includes('\\') || /^[A-Za-z]:/.test(name) || parts.includes('..')) {
    return `${name} is not a relative path below the model's folder`; // I10.2, I10.3
  }
  const file = path.join(folder, name);
  const real = fs.existsSync(file) ? fs.realpathSync(file) : undefined;
  if (!real || !fs.statSync(real).isFile()) return `${name} is not there`;
  if (path.relative(fs.realpathSync(folder), real).startsWith('..')) return `${name} leads out of the folder`;
  return fs.statSync(real).nlink > 1 ? `${name} has a second name` : undefined; // I10.4
}

export function digest(file) {
  const hash = createHash('sha256');
  const block = Buffer.alloc(1 << 22);
  const handle = fs.openSync(file);
  for (let size = 1; size > 0;) {
    size = fs.readSync(handle, block);
    hash.update(block.subarray(0, size));
  }
  fs.closeSync(handle);
  return hash.digest('hex');
}

const first = (list, check) => {
  for (const item of list) {
    const message = check(item);
    if (message) return message;
  }
  return undefined;
};
/** The outputs of the manifest, without extension fields (M72). */
export const declaredOutputs = (m) => Object.entries(m.manifest.outputs)
  .filter(([part]) => !part.startsWith('x-')).map(([, output]) => output);
const inputs = (m, check) => first(m.manifest.inputs ?? [], check);

// ---- the document

rule('GM001', 'error', {kinds: null}, (m) => { // I15
  const stored = m.model.metadata.some((entry) => KEYS.includes(entry.key));
  return stored ? undefined : `no metadata under ${KEYS[0]}`;
});
rule('GM035', 'error', {kinds: null, needs: ['GM001']}, (m) => { // I13.1
  const texts = KEYS.map((key) => m.model.metadata.findLast((entry) => entry.key === key)?.value);
  const differ = texts[0] && texts[1] && Buffer.compare(texts[0], texts[1]) !== 0;
  return differ ? 'the two manifests differ' : undefined;
});
rule('GM003', 'error', {kinds: null, needs: ['GM001']}, (m) => m.read.version); // M74
rule('GM002', 'error', {kinds: null, needs: ['GM001', 'GM003']}, (m) => { // M1, M4, M5, M73
  const twice = KEYS.find((key) => m.model.metadata.filter((entry) => entry.key === key).length > 1);
  return twice ? `${twice} is stored twice` : m.read.error;
});
rule('GM014', 'warning', {kinds: null, needs: ['GM001']}, (m) => { // I13.3
  const {values, inputs: fed, outputs} = m.model.graph;
  const found = [...values, ...fed, ...outputs].flatMap((value) => value.metadata)
    .find(({key}) => key.startsWith('gsgen.'));
  return found && `${found.key} is in the metadata of a value`;
});
rule('GM015', 'warning', {kinds: ALL}, (m) => (m.read.minor > 2 ? `version 1.${m.read.minor}` : undefined));
rule('GM018', 'info', {kinds: ALL}, (m) => // M76
  ([1, 2].includes(m.read.minor) ? `version 1.${m.read.minor} was not released` : undefined));

rule('GM004', 'error', {kinds: ALL}, (m) => { // I16, M35.3
  const named = {
    inputs: (m.manifest.inputs ?? []).map((input) => input.name),
    outputs: declaredOutputs(m).map((output) => output.name),
  };
  const present = {inputs: m.graph.inputs, outputs: new Set(m.graph.outputs.map((value) => value.name))};
  return first(['inputs', 'outputs'], (side) => first(named[side], (name) => {
    if (!present[side].has(name)) return `${name} is none of the graph's ${side}`;
    return named[side].filter((other) => other === name).length > 1 ? `${name} is named twice` : undefined;
  }));
});

const FLOATS = [DTYPE.float32, DTYPE.float16];
const SH_CHANNELS = [3, 12, 27, 48]; // L10

rule('GM005', 'error', {kinds: ALL, needs: ['GM004']}, (m) => { // M19, M37, M42
  const {gaussians, appearance, cells} = m.manifest.outputs;
  for (const output of [gaussians, cells].filter(Boolean)) {
    const {dtype, shape} = m.graph.output(output.name);
    const declared = output.dtype ?? 'float32';
    // Other dtypes are GO008's.
    if (FLOATS.includes(dtype) && dtype !== DTYPE[declared]) return `${output.name} is not ${declared}`;
    const rows = shape?.length === 2 ? shape[0] : null;
    if (output.capacity && rows && rows !== output.capacity) return `${output.name} has ${rows} rows`;
  }
  if (appearance?.space === 'sh') { // M39.2
    const channels = m.graph.output(appearance.name).shape?.[1];
    if (appearance.degree === undefined) return 'sh without a degree';
    if (SH_CHANNELS.includes(channels) && channels !== SH_CHANNELS[appearance.degree]) {
      return `degree ${appearance.degree}, but ${channels} channels`;
    }
  }
  return inputs(m, (input) => {
    const shape = m.graph.inputs.get(input.name).shape;
    const fits = !input.shape || !shape || (shape.length === input.shape.length
      && shape.every((size, i) => size === null || size === input.shape[i]));
    return fits ? undefined : `${input.name} is [${shape}], not [${input.shape}]`;
  });
});
rule('GM006', 'warning', {}, (m) => (m.manifest.space ? undefined : 'no space')); // M3
rule('GM007', 'error', {}, (m) => { // M39.2
  const {appearance} = m.manifest.outputs;
  return appearance?.space === 'rgb' && appearance.degree !== undefined ? 'a degree of rgb' : undefined;
});
rule('GM008', 'info', {}, (m) => { // L18.3
  const {appearance} = m.manifest.outputs;
  return appearance && !appearance.color_space ? 'no color_space' : undefined;
});
rule('GM009', 'warning', {}, (m) => (m.manifest.bounds ? undefined : 'no bounds')); // M3
rule('GM010', 'warning', {needs: ['GM004']}, (m) => inputs(m, (input) => // R8
  (input.role === 'time' && (!input.range || input.range[0] === input.range[1])
    ? `${input.name} has no duration` : undefined)));
rule('GM013', 'info', {kinds: ALL}, (m) => { // M11, M12
  const {license, tool} = m.manifest.producer ?? {};
  const id = '\\(*[A-Za-z0-9][A-Za-z0-9.:+-]*\\)*';
  const spdx = new RegExp(`^${id}( (AND|OR|WITH) ${id})*$`);
  if (license !== undefined && !spdx.test(license)) return `license: ${license}`;
  return tool !== undefined && !/\d/.test(tool) ? `tool without a version: ${tool}` : undefined;
});
rule('GM016', 'error', {}, (m) => { // M45, M72
  const known = new Set((m.manifest.inputs ?? []).flatMap((input) => [input.name, input.role]));
  const keys = Object.keys(m.manifest.depends_on ?? {}).filter((name) => !known.has(name));
  if (!keys.length) return undefined;
  // M45.5: a role that no input has is a remainder.
  const isPossible = keys.every((name) => rolesOf(m.manifest.kind).includes(name));
  return {message: `depends_on: ${keys[0]} is no input`, certainty: isPossible ? 'possible' : 'confirmed'};
});
rule('GM017', 'error', {}, (m) => { // W1, M35, M44
  const parts = [m.manifest.blend === 'wsr', !!m.manifest.weighted_sum, !!m.manifest.outputs.cells];
  return new Set(parts).size > 1 ? 'blend, weighted_sum and cells do not go together' : undefined;
});
rule('GM019', 'error', {}, (m) => { // M10
  const {min, max} = m.manifest.bounds ?? {};
  if (!min) return undefined;
  if (!min.every((low, i) => low <= max[i])) return 'a corner of min is above that of max';
  const point = min.every((low, i) => low === max[i]) && m.manifest.outputs.gaussians?.capacity > 1;
  return point ? 'the bounds are a point' : undefined;
});
rule('GM036', 'error', {kinds: ALL}, (m) => { // M8.4
  const {unit, metres_per_unit: length = 1} = m.manifest.space ?? {};
  return unit === 'metre' && length !== 1 ? `a metre of ${length} metres` : undefined;
});
rule('GM039', 'error', {kinds: ['post-process']}, (m) => { // M58.4
  const ranges = [m.manifest.image_range, m.manifest.outputs.image.range].filter(Boolean);
  return ranges.every(([black, white]) => black < white) ? undefined : 'black is not below white';
});

rule('GM030', 'error', {kinds: ALL}, (m) => { // E2.3
  const used = m.manifest.extensions_used ?? [];
  const alone = (m.manifest.extensions_required ?? []).find((name) => !used.includes(name));
  return alone && `${alone} is required, but not used`;
});
rule('GM031', 'error', {kinds: ALL, needs: ['GM030']}, (m) => { // E3.3, E4: none is registered
  const required = m.manifest.extensions_required ?? [];
  return required.length ? `${required[0]} is not registered` : undefined;
});
rule('GM038', 'error', {kinds: ALL}, (m) => { // E2.2
  const fields = new Set();
  JSON.stringify(m.manifest, (key, value) => { fields.add(key); return value; });
  const absent = (m.manifest.extensions_used ?? []).find((name) => !fields.has(name));
  return absent && `${absent} is no field of the manifest`;
});
rule('GM032', 'error', {kinds: ALL, needs: ['GG019']}, (m) => { // M17
  const profile = m.manifest.operator_profile;
  if (profile === undefined) return undefined;
  if (profile !== 'portable-1') return `there is no profile ${profile}`;
  if (m.opset < 13 || m.opset > 20) return `operator set ${m.opset}`;
  const other = m.graph.nodes.find((node) => node.domain || !PORTABLE_1.has(node.op));
  return other && `${other.op} is not in ${profile}`;
});
rule('GM034', 'error', {needs: ['GM005']}, (m) => { // M16.1
  const {gaussians, appearance} = m.manifest.outputs;
  const rows = [gaussians, appearance].filter(Boolean)
    .reduce((sum, output) => sum + outputBytes(m, output.name), 0);
  return first(m.manifest.cost ?? [], ({bytes}) => (bytes < rows ? `${bytes} of ${rows} bytes` : undefined));
});

/** The bytes of one frame of an output, as far as its shape is declared. */
export function outputBytes(m, name) {
  const {dtype, shape} = m.graph.output(name) ?? {};
  return shape?.every((n) => n > 0) ? shape.reduce((x, y) => x * y, DTYPE_BYTES[dtype]) : 0;
}

// ---- inputs

const I32 = ['frame_index', 'appearance_id'];
// R3, R44, R47: the shapes of each role; a letter is any size, * any shape.
const SHAPES = {view: ['4 4'], projection: ['4 4'], time: ['1'], frame_index: ['1'],
  camera_position: ['3'], viewport: ['2'], pose: ['J 3', 'J 4'], shape: ['B'], root_translation: ['3'],
  root_rotation: ['3', '3 3'], expression: ['E'], appearance_id: ['1'], audio: ['S', 'W M'],
  condition: ['*'], control: ['*'], image: ['V 3 H W'], image_view: ['V 4 4'],
  image_intrinsics: ['V 3 3'], timestep: ['1'], conditioning: ['1 L D', '1 D'], camera_history: ['T S']};
const KINDS = {'post-process': ['control', 'image', 'timestep', 'conditioning'],
  'trajectory-predictor': ['camera_history']};
const NEEDS_RANGE = ['frame_index', 'shape', 'expression', 'appearance_id', 'condition', 'control', 'timestep'];
const CAMERA = ['view', 'projection', 'camera_position', 'viewport'];

const rolesOf = (kind) => KINDS[kind]
  ?? Object.keys(SHAPES).filter((role) => !['timestep', 'conditioning', 'camera_history'].includes(role));

/** The sizes of an input: the graph's; in a post-process model the manifest may fill open ones (M19). */
export function shapeOf(m, input) {
  const shape = m.graph.inputs.get(input.name)?.shape;
  if (m.manifest.kind !== 'post-process') return shape;
  return shape?.map((size, i) => size ?? input.shape?.[i] ?? null);
}

for (const [id, role, shape] of [['GI001', 'view', '4 4'], ['GI002', 'projection', '4 4'], ['GI003', 'time', '1']]) {
  rule(id, 'error', {needs: ['GM004']}, (m) => inputs(m, (input) => // R3
    (input.role === role && m.graph.inputs.get(input.name).shape?.join(' ') !== shape
      ? `${input.name} is not [${shape}]` : undefined)));
}
rule('GI004', 'error', {kinds: ALL, needs: ['GM004']}, (m) => inputs(m, ({name, role}) => { // R3, R5
  const allowed = I32.includes(role) ? [DTYPE.int32]
    : ['condition', 'timestep'].includes(role) ? [DTYPE.float32, DTYPE.int32]
      : ['image', 'conditioning'].includes(role) ? FLOATS : [DTYPE.float32];
  const {dtype} = m.graph.inputs.get(name);
  return allowed.includes(dtype) ? undefined : `${name} is ${DTYPE_NAME[dtype]}`;
}));
rule('GI005', 'error', {kinds: ALL, needs: ['GM004']}, (m) => { // I17, R1, R2, M18, M20.7
  const declared = new Set((m.manifest.inputs ?? []).map((input) => input.name));
  const extra = [...m.graph.inputs.keys()].find((name) => !declared.has(name));
  if (extra) return `${extra} has no role`;
  return inputs(m, (input) => {
    const {name, role} = input;
    if (!rolesOf(m.manifest.kind).includes(role)) return `${role} is no role of a ${m.manifest.kind}`;
    if (NEEDS_RANGE.includes(role) && !input.range) return `${name} has no range`;
    if (['view', 'projection', 'time'].includes(role)) return undefined; // GI001 to GI003
    const shape = shapeOf(m, input);
    const picture = m.manifest.kind === 'post-process' && role === 'image';
    const patterns = picture ? ['1 3 H W', '1 4 H W'] : SHAPES[role]; // R44
    const fits = shape && patterns.some((pattern) => {
      const sizes = pattern.split(' ');
      if (pattern === '*') return shape.every((size) => size > 0);
      return sizes.length === shape.length && sizes.every((size, i) => (/\d/.test(size)
        ? Number(size) === shape[i] : shape[i] > 0 || (picture && shape[i] === null))); // R45
    });
    return fits ? undefined : `${name} is [${shape}], not [${patterns}]`;
  });
});
rule('GI012', 'info', {kinds: null}, (m) => { // I17.2
  const weight = m.model.graph.inputs.find((value) => m.graph.weights.has(value.name));
  return weight && `${weight.name} is a weight`;
});
const isInteger = (m, input) => m.graph.inputs.get(input.name).dtype === DTYPE.int32;
rule('GI013', 'error', {kinds: ALL, needs: ['GM004']}, (m) => inputs(m, (input) => { // M20.1
  if (!input.range) return undefined;
  if (!(input.range[0] <= input.range[1])) return `${input.name}: [${input.range}]`;
  const fits = isInteger(m, input) ? (end) => end === (end | 0) : (end) => Math.abs(end) <= 3.4028234663852886e38;
  return input.range.every(fits) ? undefined : `${input.name}: [${input.range}] beyond its type`;
}));

const CONVENTIONS = { // R11 to R20, R28 to R31
  pose: {'axis-angle': /^\d+ 3$/, 'smpl-axis-angle': /^(24|55) 3$/, 'quaternion-wxyz': /^\d+ 4$/,
    flame: /^5 3$/, mano: /^16 3$/},
  shape: {flame: /^\d+$/, mano: /^10$/, 'smplx-10': /^10$/},
  expression: {flame: /^\d+$/, 'arkit-52': /^52$/, 'smplx-10': /^10$/},
  root_rotation: {'axis-angle': /^3$/, matrix: /^3 3$/},
  audio: {samples: /^\d+$/, mel: /^\d+ \d+$/},
};
rule('GI015', 'error', {kinds: ALL, needs: ['GM004', 'GI005']}, (m) => inputs(m, (input) => {
  const known = CONVENTIONS[input.role]?.[input.convention];
  const fits = input.convention === undefined || known?.test(shapeOf(m, input).join(' '));
  return fits ? undefined : `${input.convention} for ${input.role} [${shapeOf(m, input)}]`;
}));
rule('GI014', 'error', {kinds: ALL, needs: ['GM005', 'GI001', 'GI002', 'GI003', 'GI005', 'GI013']},
  (m) => inputs(m, (input) => { // M21
    const {name, role, range, default: start} = input;
    if (start === undefined) return undefined;
    const shape = shapeOf(m, input) ?? [];
    const size = shape.reduce((x, y) => x * y, 1);
    let values = start === 'zeros' ? [0] : [start].flat();
    if (start === 'identity') {
      const square = ['4 4', '3 3'].includes(shape.slice(-2).join(' ')) && shape.length <= 3
        && (shape.length === 2 || shape.join(' ').endsWith('4 4'));
      if (!square && !(role === 'pose' && shape[1] === 4)) return `${name}: identity of [${shape}]`;
      values = [0, 1];
    } else if (Array.isArray(start) && start.length !== size) return `${name}: ${start.length} of ${size}`;
    if (isInteger(m, input) && !values.every(Number.isInteger)) return `${name}: ${values} of integers`;
    const slack = range && 1e-6 * Math.max(1, ...range.map(Math.abs));
    const within = !range || values.every((n) => n >= range[0] - slack && n <= range[1] + slack);
    return within ? undefined : `${name}: ${values} beyond [${range}]`;
  }));
const OWN_START = ['pose', 'shape', 'expression', 'root_translation', 'root_rotation', 'appearance_id',
  'control', 'timestep', 'conditioning', 'audio', 'condition', 'image_view', 'image_intrinsics'];
rule('GI016', 'warning', {kinds: ALL, needs: ['GM004']}, (m) => inputs(m, (input) => // M22
  (OWN_START.includes(input.role) && input.default === undefined ? `${input.name} has no default` : undefined)));
rule('GI017', 'error', {kinds: ALL, needs: ['GM004']}, (m) => { // M23, M69
  if (m.manifest.step_seconds === 0) return 'step_seconds is 0';
  return inputs(m, (input) => {
    const field = ['loop', 'frames', 'fps'].find((name) => input[name] !== undefined);
    if (field && !['time', 'frame_index'].includes(input.role)) return `${input.name} has ${field}`;
    return input.fps === 0 ? `${input.name}: fps is 0` : undefined;
  });
});
rule('GI018', 'error', {kinds: ALL, needs: ['GM004', 'GI015']}, (m) => inputs(m, (input) => { // C18
  const shape = shapeOf(m, input)?.join(' ');
  const vector = (input.role === 'pose' && shape?.endsWith(' 3')) || (input.role === 'root_rotation' && shape === '3');
  const far = vector && input.range?.some((end) => Math.abs(end) > 2 * Math.PI + 1e-6);
  return far ? `${input.name}: [${input.range}]` : undefined;
}));
rule('GI025', 'error', {needs: ['GM004', 'GI013']}, (m) => inputs(m, ({role, range, frames}) => { // R9.3, M25
  if (!range || !(frames > 1)) return undefined;
  const step = (range[1] - range[0]) / frames;
  const same = role === 'time' && !(step > 0 && step >= 2 ** -23 * Math.max(...range.map(Math.abs)));
  return same || (role === 'frame_index' && frames > range[1] - range[0] + 1) ? `${frames} frames` : undefined;
}));
rule('GI030', 'error', {needs: ['GM004', 'GI005']}, (m) => inputs(m, (input) => { // M26.1
  const joints = input.joints ?? [];
  if (!joints.length) return undefined;
  if (input.role !== 'pose') return `${input.name} has joints`;
  if (joints.length !== shapeOf(m, input)[0]) return `${joints.length} joints`;
  const before = new Set();
  return first(joints, ({name, parent}) => {
    if (before.has(name)) return `the joint ${name} is there twice`;
    if (parent !== undefined && !before.has(parent)) return `${name} is before its parent`;
    before.add(name);
    return undefined;
  });
}));
rule('GI031', 'error', {needs: ['GM004', 'GI015']}, (m) => inputs(m, ({convention, range}) => // R18.2
  (convention === 'arkit-52' && range && !(range[0] >= 0 && range[1] <= 1) ? `[${range}]` : undefined)));
rule('GI032', 'error', {needs: ['GM004', 'GI015']}, (m) => inputs(m, (input) => { // R28, M26.3
  const has = ['rate', 'window', 'hop'].map((field) => input[field] !== undefined);
  const mel = input.role === 'audio' && shapeOf(m, input).length === 2; // R31
  const expected = [input.role === 'audio', mel, mel];
  if (has.join() !== expected.join()) return `${input.name}: rate, window, hop are there: ${has}`;
  return mel && input.hop > input.window ? `${input.name}: hop is above window` : undefined;
}));
rule('GI033', 'error', {needs: ['GM004', 'GI005']}, (m) => { // R36.1
  const pictures = (m.manifest.inputs ?? []).filter((input) => input.role.startsWith('image'));
  const counts = new Set(pictures.map((input) => shapeOf(m, input)[0]));
  if (counts.size > 1) return `${[...counts].join(' and ')} pictures`;
  return pictures.length && !pictures.some((input) => input.role === 'image') ? 'cameras alone' : undefined;
});
const isPicture = ({role}) => ['image', 'image_view', 'image_intrinsics'].includes(role);
rule('GI034', 'error', {kinds: ALL, needs: ['GM004']}, (m) => inputs(m, (input) => { // M28.3
  if (input.pass === undefined) return undefined;
  if (m.manifest.kind !== 'gaussian-generator') return `${input.name} has a pass`;
  const ofFrame = [...CAMERA, 'time', 'frame_index', 'audio'].includes(input.role);
  const wrong = input.pass === 'scene' ? ofFrame : isPicture(input);
  return wrong ? `${input.name} belongs to the ${input.pass}` : undefined;
}));
rule('GI035', 'error', {kinds: ALL, needs: ['GM004']}, (m) => inputs(m, ({name, role, background}) => { // R39.2
  if (background === undefined) return undefined;
  const fits = role === 'image' && m.manifest.kind === 'gaussian-generator';
  return fits && background.every((c) => c >= 0 && c <= 1) ? undefined : `${name}: ${background}`;
}));
rule('GI036', 'warning', {needs: ['GI006', 'GI034', 'GG019']}, (m) => { // M32
  const scene = new Set((m.manifest.inputs ?? []).filter((input) => isPicture(input) || input.pass === 'scene')
    .map((input) => input.name));
  if (!scene.size || scene.size === m.graph.inputs.size) return undefined;
  const alone = m.graph.nodes.some((node) => {
    const sources = [...m.graph.dependencies(node.outputs[0])];
    return sources.length && sources.every((name) => scene.has(name));
  });
  return alone ? undefined : 'no operator works on the scene alone';
});
rule('GI045', 'warning', {needs: ['GM004', 'GI025']}, (m) => inputs(m, (input) => { // M20.4
  if (!input.range || m.graph.inputs.get(input.name).dtype !== DTYPE.float32) return undefined;
  const order = (value) => { // float32 numbers in their order, as integers
    const bits = new Int32Array(Float32Array.of(value).buffer)[0];
    return bits < 0 ? -(bits & 0x7fffffff) : bits;
  };
  const steps = order(input.range[1]) - order(input.range[0]);
  return steps > 0 && steps < 64 ? `${input.name}: ${steps} steps` : undefined; // no step: GM010
}));

// ---- files beside the model

rule('GS001', 'error', {kinds: null}, (m) => first(m.model.graph.initializers, (tensor) => { // I10
  if (tensor.location !== 1) return undefined;
  const entry = Object.fromEntries(tensor.external.map(({key, value}) => [key, value]));
  const reason = outside(m.folder, entry.location);
  if (reason) return `${tensor.name}: ${reason}`;
  const bytes = tensor.dims.reduce((x, y) => x * y, DTYPE_BYTES[tensor.dtype]);
  if (entry.length !== undefined && Number(entry.length) !== bytes) return `${tensor.name}: ${entry.length} bytes`;
  const end = Number(entry.offset ?? 0) + bytes;
  return end > fs.statSync(path.join(m.folder, entry.location)).size ? `${entry.location} is short` : undefined;
}));
rule('GM025', 'error', {}, (m) => { // M57
  const images = m.manifest.reference_images ?? [];
  if (images.length > 16) return `${images.length} pictures`;
  return first(images, (image) => {
    const reason = outside(m.folder, image.path);
    if (reason) return reason;
    const file = path.join(m.folder, image.path);
    if (fs.statSync(file).size > 2 ** 25) return `${image.path} is large`;
    const png = fs.readFileSync(file).subarray(0, 8).toString('latin1') === '\x89PNG\r\n\x1a\n';
    return png && digest(file) === image.sha256 ? undefined : `${image.path} is not the declared PNG`;
  });
});
rule('GM033', 'warning', {kinds: ALL, needs: ['GM004']}, (m) => first(m.manifest.test_vectors ?? [], ({files = []}) => {
  if (!files.length) return undefined; // M51.5
  const held = new Set(files.map((file) => file.input));
  if (held.size !== m.graph.inputs.size || ![...held].every((name) => m.graph.inputs.has(name))) {
    return `files for ${[...held]}`;
  }
  return first(files, (file) => outside(m.folder, file.path)
    ?? (digest(path.join(m.folder, file.path)) === file.sha256 ? undefined : `${file.path} has another digest`));
}));
