// Level `static`: the graph, the declared outputs, and the limits of targets.

import {attribute, DTYPE, DTYPE_BYTES, DTYPE_NAME} from './onnx_file.mjs';
import {reads} from './graph.mjs';
import * as operators from './operators.mjs';
import {declaredOutputs, outputBytes, shapeOf} from './static_manifest.mjs';
import {ALL, Rules, TARGETS} from './rules.mjs';

export const rules = new Rules('static');
const rule = rules.add.bind(rules);
const ANY = {kinds: null};

// ---- the graph alone

rule('GG001', 'error', ANY, (m) => { // I23.2, T2
  const {opset: [low, high], ir} = TARGETS[m.target];
  if (!(m.opset >= low && m.opset <= high)) return `operator set ${m.opset}`;
  return m.model.irVersion > ir ? `IR version ${m.model.irVersion}` : undefined;
});
const isOnnx = (node) => ['', 'ai.onnx', undefined].includes(node.domain);
rule('GG002', 'error', ANY, (m) => { // I23.1, T5
  const node = m.graph.nodes.find((n) => !isOnnx(n) && !m.graph.functions.has(`${n.domain}:${n.op}`));
  return node && `${node.domain}.${node.op}`;
});
const CHECKED = {kinds: null, needs: ['GG001', 'GG002']};
rule('GG019', 'error', CHECKED, (m) => { // I22.1
  const known = new Set([...m.graph.inputs.keys(), ...m.graph.weights.keys()]);
  const bare = [...m.model.graph.inputs, ...m.model.graph.outputs].find(({type}) => !type?.tensor?.shape);
  if (bare) return `${bare.name} has no shape`;
  const domains = new Set(m.model.opsets.map(({domain}) => domain ?? ''));
  for (const node of m.graph.nodes) {
    if (isOnnx(node)) {
      if (!operators.ONNX.has(node.op)) return `there is no operator ${node.op}`;
      const {length} = node.inputs;
      if (!domains.has(node.domain ?? '')) return `${node.op}: no operator set of the domain ${node.domain}`;
      if (length < (operators.FEWEST[node.op] ?? 1) || (operators.UNARY.has(node.op) && length > 1)) {
        return `${node.op} has ${length} inputs`;
      }
      const needed = operators.REQUIRED_ATTRIBUTE[node.op];
      if (needed && attribute(node, needed) === undefined) return `${node.op} has no ${needed}`;
    }
    const inside = new Set(subgraphs(node).flatMap((graph) => [...graph.inputs.map((value) => value.name),
      ...graph.initializers.map((tensor) => tensor.name), ...graph.nodes.flatMap((n) => n.outputs)]));
    const dangling = reads(node).find((name) => !known.has(name) && !inside.has(name));
    if (dangling) return `${node.op} reads ${dangling} before it is there`; // also a cycle
    for (const name of node.outputs.filter(Boolean)) {
      if (known.has(name)) return `${name} is made twice`;
      known.add(name);
    }
  }
  const absent = m.graph.outputs.find((value) => !known.has(value.name));
  return absent && `the output ${absent.name} is made by no operator`;
});
const subgraphs = (node) => node.attributes.flatMap((entry) => [entry.g, ...entry.graphs]).filter(Boolean);
const FORMED = {kinds: null, needs: ['GG019']};

rule('GG003', 'warning', ANY, (m) => // I24.1
  m.graph.nodes.find((node) => operators.CONTROL_FLOW.has(node.op))?.op);
rule('GG012', 'error', ANY, (m) => { // I22.3
  const seen = new Set();
  for (const {name} of m.graph.nodes.filter((node) => node.name)) {
    if (seen.has(name)) return `two nodes are called ${name}`;
    seen.add(name);
  }
  const names = [...m.graph.inputs.keys(), ...m.graph.outputs.map((value) => value.name)];
  return names.find((name) => /[\s\p{C}]/u.test(name));
});
rule('GO014', 'error', ANY, (m) => { // I22.4
  const names = m.graph.outputs.map((value) => value.name);
  return names.find((name, i) => names.indexOf(name) !== i);
});
rule('GG014', 'warning', ANY, (m) => { // I25
  if (m.size >= 1500 * 2 ** 20) return `${m.size} bytes`;
  const node = m.graph.nodes.find((n) => n.op === 'Constant' && m.graph.bytes(n.outputs[0]) > 2 ** 20);
  return node && `the Constant ${node.outputs[0]} is large`;
});
rule('GS002', 'error', ANY, (m) => { // I26
  for (const name of new Set([...m.graph.declared.keys(), ...m.graph.weights.keys()])) {
    const {dtype, shape} = m.graph.declared.get(name)
      ?? {dtype: m.graph.weights.get(name).dtype, shape: m.graph.weights.get(name).dims};
    const count = (shape ?? []).reduce((x, y) => x * (y ?? 1), 1);
    const bytes = count * (DTYPE_BYTES[dtype] ?? 1);
    if (count > 2 ** 40 || shape?.length > 64 || bytes > 2 ** 31) return `${name} is [${shape}]`; // V3
  }
  return undefined;
});
rule('GG011', 'error', FORMED, (m) => // I22.4
  [...m.graph.declarations, ...m.graph.computed].find(([, {dtype}]) => dtype === DTYPE.float64)?.[0]);
rule('GG015', 'error', FORMED, (m) => { // I22.2
  if (m.graph.conflicts.length) return `the inputs of ${m.graph.conflicts[0].op} do not fit`;
  for (const [name, declared] of m.graph.declarations) {
    const computed = m.graph.computed.get(name) ?? {};
    if (computed.dtype && declared.dtype && computed.dtype !== declared.dtype) {
      return `${name} is ${DTYPE_NAME[computed.dtype]}`;
    }
    const [a, b] = [computed.shape, declared.shape];
    const differ = a && b && (a.length !== b.length
      || a.some((size, i) => size !== null && b[i] !== null && size !== b[i]));
    if (differ) return `${name} is [${a}], not [${b}]`;
  }
  return undefined;
});
rule('GG020', 'error', FORMED, (m) => { // I23.3
  const node = m.graph.nodes.find((n) => n.op === 'MatMul'
    && m.graph.producer.get(n.inputs[0])?.op === 'Transpose' && m.graph.shape(n.inputs[1])?.length === 1);
  return node && `${node.outputs[0]} is such a product`;
});
rule('GG025', 'error', FORMED, (m) => { // M49.2
  const node = m.graph.nodes.find((n) => n.op === 'Bernoulli'
    || (n.op === 'Dropout' && n.inputs[2] && m.graph.constant(n.inputs[2])?.[0])
    || (n.op === 'BatchNormalization' && attribute(n, 'training_mode')));
  return node && `${node.op} is in training mode`;
});
rule('GG010', 'error', {kinds: null, needs: ['GG025']}, (m) => { // M49.2: outputs alone count
  const open = m.graph.outputs.map((value) => value.name);
  const seen = new Set(open);
  while (open.length) {
    const node = m.graph.producer.get(open.pop());
    if (node && operators.RANDOM.has(node.op)) return `${node.op} reaches an output`;
    for (const name of node ? reads(node) : []) {
      if (!seen.has(name)) open.push(name);
      seen.add(name);
    }
  }
  return undefined;
});
rule('GG016', 'warning', FORMED, (m) => { // I24.2
  const {graph} = m;
  const copies = (node) => operators.VIEWS.has(node.op)
    || (['Max', 'Min', 'Sum', 'Mean'].includes(node.op) && node.inputs.length === 1)
    || (node.op.startsWith('Reduce') && attribute(node, 'noop_with_empty_axes')
      && graph.axes(node)?.length === 0);
  const output = graph.outputs.map((value) => value.name).find((name) => graph.dependencies(name).size
    && (graph.inputs.has(name) || copies(graph.producer.get(name) ?? {op: ''})));
  if (output) return `${output} is a view`;
  // An update in place of a weight is seen in the next frame, too, behind other operators as well.
  const scatter = graph.nodes.find((node) => node.op.startsWith('Scatter')
    && !graph.dependencies(node.inputs[0]).size && graph.dependencies(node.outputs[0]).size);
  return scatter && `${scatter.outputs[0]} is updated in place`;
});
rule('GO013', 'warning', FORMED, (m) => { // L22.2
  const count = m.manifest?.outputs?.count?.name;
  const output = m.graph.outputs.find(({name}) => m.graph.weights.has(name) && name !== count);
  return output && `${output.name} is a weight`;
});
rule('GI006', 'warning', {kinds: ALL, needs: ['GM004', 'GG019']}, (m) => { // I24.3, M45
  const denied = m.manifest.depends_on ?? {};
  const idle = (m.manifest.inputs ?? []).find(({name, role}) => (denied[name] ?? denied[role]) !== false
    && !m.graph.outputs.some((value) => m.graph.dependencies(value.name).has(name)));
  return idle && `no output is computed from ${idle.name}`;
});

// ---- what a frame that is recorded once cannot have

const captured = {kinds: null, needs: ['GG001', 'GG002', 'GG019'], when: (target) => target.capture};
const ofFrame = (m) => m.graph.nodes.filter((node) => m.graph.dependencies(node.outputs[0]).size);
rule('GG004', 'error', captured, (m) => [...m.graph.valueShaped()][0]?.op);
rule('GG006', 'error', captured, (m) => ofFrame(m).find((node) => operators.NO_KERNEL.has(node.op))?.op);
rule('GG008', 'error', {...captured}, (m) => ofFrame(m).find((node) => node.op === 'GroupNormalization'
  || (node.op === 'LpNormalization' && m.target === 'visionary'))?.op);
rule('GG018', 'error', captured, (m) => m.opset >= 22 && ofFrame(m).find((n) => operators.OF_22.has(n.op))?.op);
rule('GG017', 'error', captured, (m) => { // int64 within 32 bits
  const ranges = new Map((m.manifest?.inputs ?? []).filter((input) => input.range)
    .map((input) => [input.name, input.range]));
  const node = ofFrame(m).find((n) => m.graph.dtype(n.outputs[0]) === DTYPE.int64
    && !(m.graph.range(n.outputs[0], ranges) ?? [-Infinity]).every((end) => Math.abs(end) < 2 ** 31));
  return node && `${node.outputs[0]} may leave 32 bits`;
});
rule('GG007', 'error', {...FORMED, when: (target) => target.split}, (m) => {
  const {split, concat = Infinity} = TARGETS[m.target];
  const node = ofFrame(m).find((n) => (n.op === 'Split' && n.outputs.length > split)
    || (n.op === 'Concat' && n.inputs.length > concat));
  return node && `${node.op} of ${Math.max(node.inputs.length, node.outputs.length)}`;
});
rule('GG009', 'info', {...captured, needs: ['GG003', 'GG004', 'GG006', 'GG008', 'GG011', 'GG018']}, (m) =>
  ofFrame(m).find((node) => !operators.PORTABLE_1.has(node.op))?.op);
rule('GG026', 'error', {kinds: ALL.slice(0, 2), needs: ['GG001', 'GG002', 'GG019', 'GG004']}, (m) => { // M48
  const {capture} = m.manifest;
  return capture && capture.static_shapes !== false ? [...m.graph.valueShaped()][0]?.op : undefined;
});

// ---- declared outputs

const FLOATS = [DTYPE.float32, DTYPE.float16];
const named = (m, part) => m.manifest.outputs[part] && m.graph.output(m.manifest.outputs[part].name);
const NAMED = {needs: ['GM004']};

rule('GO001', 'error', NAMED, (m) => (named(m, 'gaussians') ? undefined : 'no gaussians')); // L1, M35
rule('GO005', 'error', NAMED, (m) => (named(m, 'appearance') ? undefined : 'no appearance'));
rule('GO010', 'error', NAMED, (m) => (named(m, 'count') ? undefined : 'no count'));
rule('GO003', 'error', {needs: ['GO001']}, (m) => { // L2.3
  const {shape} = named(m, 'gaussians');
  return shape?.length === 2 ? undefined : `gaussians are [${shape}]`;
});
rule('GO002', 'error', {needs: ['GO001', 'GO003']}, (m) => { // L3
  const {shape} = named(m, 'gaussians');
  return shape[1] !== null && shape[1] !== 10 ? `a row has ${shape[1]} numbers` : undefined;
});
rule('GO004', 'error', {needs: ['GO001', 'GO003']}, (m) => { // L2.1, L2.2; of unknown rank: GO003, GO006
  const open = ['gaussians', 'appearance'].filter((part) => named(m, part))
    .find((part) => named(m, part).shape && !named(m, part).shape.every((size) => size > 0));
  return open && `${open} are [${named(m, open).shape}]`;
});
rule('GO006', 'error', {needs: ['GO005']}, (m) => { // L10.1
  const {shape} = named(m, 'appearance');
  const allowed = m.manifest.outputs.appearance.space === 'sh' ? [3, 12, 27, 48] : [3, 4];
  return shape?.length === 2 && (shape[1] === null || allowed.includes(shape[1])) ? undefined : `[${shape}]`;
});
rule('GO007', 'error', {needs: ['GO004', 'GO006']}, (m) => { // L2.5
  const [a, b] = ['gaussians', 'appearance'].map((part) => named(m, part).shape[0]);
  return a === b ? undefined : `${a} rows, but ${b} colours`;
});
rule('GO008', 'error', {needs: ['GO001', 'GO005']}, (m) => // L1
  ['gaussians', 'appearance', 'cells'].find((part) => named(m, part) && !FLOATS.includes(named(m, part).dtype)));
rule('GO009', 'warning', {needs: ['GO008']}, (m) => // L2.6
  (named(m, 'gaussians').dtype === named(m, 'appearance').dtype ? undefined : 'two dtypes'));
rule('GO011', 'error', {needs: ['GO010']}, (m) => { // L19
  const {dtype} = named(m, 'count');
  const shape = m.graph.filledShape(m.manifest.outputs.count.name);
  return dtype === DTYPE.int32 && shape?.join() === '1' ? undefined : `${DTYPE_NAME[dtype]} [${shape}]`;
});
rule('GO015', 'error', {needs: ['GO002', 'GO006', 'GO008']}, (m) => // L10.2
  ['gaussians', 'appearance', 'cells'].find((part) => {
    const output = named(m, part);
    return output?.shape?.[1] && (output.shape[1] * DTYPE_BYTES[output.dtype]) % 4;
  }));
rule('GO020', 'error', {needs: ['GM004', 'GM017']}, (m) => { // W3.1
  const cells = named(m, 'cells');
  const fits = !cells || (cells.shape?.length === 2 && cells.shape[0] > 0 && cells.shape[1] === 10);
  return fits ? undefined : `cells are [${cells.shape}]`;
});
rule('GO021', 'error', {needs: ['GO020', 'GO002', 'GO004']}, (m) => { // W3.1, M42.1
  const cells = named(m, 'cells');
  const rows = cells && cells.shape[0] * m.manifest.outputs.cells.per_cell;
  return cells && rows !== named(m, 'gaussians').shape[0] ? `cells hold ${rows} rows` : undefined;
});
rule('GO018', 'error', {kinds: ['post-process'], needs: ['GM004', 'GI005']}, (m) => { // M58.1, R49.1
  const {name, dtype = 'float32', scale = 1} = m.manifest.outputs.image;
  const output = m.graph.output(name);
  if (output.dtype !== DTYPE[dtype]) return `${name} is ${DTYPE_NAME[output.dtype]}`;
  const image = m.manifest.inputs?.find((input) => input.role === 'image');
  const [shape, size] = [m.graph.filledShape(name), image && shapeOf(m, image)];
  if (shape && (shape.length !== 4 || ![3, 4, null].includes(shape[1]))) return `${name} is [${shape}]`;
  const differs = shape && size && [2, 3].some((i) => shape[i] && size[i] && shape[i] !== scale * size[i]);
  return differ(differs, `${name} is [${shape}] for [${size}]`);
});
const differ = (is, message) => (is ? message : undefined);
rule('GO019', 'error', {kinds: ['trajectory-predictor'], needs: ['GM004']}, (m) => { // M65.1, M69
  const {future, uncertainty} = m.manifest.outputs;
  const size = future.representation.endsWith('wxyz') ? 7 : 6;
  const expected = {
    [future.name]: [future.steps, size],
    [uncertainty.name]: [future.steps,
      uncertainty.semantics === 'covariance-upper' ? (size * (size + 1)) / 2 : size],
  };
  const wrong = Object.keys(expected).find((name) => m.graph.filledShape(name)?.join() !== expected[name].join());
  if (wrong) return `${wrong} is [${m.graph.output(wrong).shape}], not [${expected[wrong]}]`;
  const history = m.manifest.inputs?.find((input) => input.role === 'camera_history');
  const past = history && shapeOf(m, history);
  return differ(history && past?.[1] !== size, `the history is [${past}]`);
});
rule('GO017', 'warning', {kinds: ALL, needs: ['GM004', 'GO001', 'GO005', 'GO010', 'TV102']}, (m) => { // I17.4
  const declared = [...declaredOutputs(m), ...m.manifest.inputs ?? []].map((part) => part.name);
  const output = m.graph.outputs.find(({name}) => !declared.includes(name));
  return output && `${output.name} is not declared`;
});

// ---- limits of targets (T6)

const buffers = (m) => [...m.graph.outputs.map((value) => value.name), ...m.graph.weights.keys(),
  ...m.graph.nodes.flatMap((node) => node.outputs).filter((name) => !m.graph.dependencies(name).size)];
for (const [id, limit, needs] of [['GL002', 'buffer', []], ['GL001', 'binding', ['GL002']]]) {
  rule(id, 'error', {kinds: null, needs, when: (target) => target[limit]}, (m) =>
    buffers(m).find((name) => Math.max(m.graph.bytes(name), outputBytes(m, name)) > TARGETS[m.target][limit]));
}
rule('GL003', 'error', {needs: ['GO004', 'GL001', 'GL002'], when: (target) => target.rows}, (m) =>
  differ(named(m, 'gaussians').shape[0] > TARGETS[m.target].rows, `${named(m, 'gaussians').shape[0]} rows`));
rule('GL005', 'info', {needs: ['GM004', 'GL001', 'GL002'], when: (target) => target.frame}, (m) => {
  const bytes = m.graph.outputs.reduce((sum, value) => sum + outputBytes(m, value.name), 0);
  return differ(bytes > TARGETS[m.target].frame, `${bytes} bytes`);
});

// ---- the target `visionary` (T7)

const visionary = (needs) => ({needs, when: (_, name) => name === 'visionary'});
rule('TV101', 'error', visionary(['GO001']), (m) => {
  const found = m.graph.outputs.find(({name}) => name.startsWith('gauss'))?.name;
  return differ(found !== m.manifest.outputs.gaussians.name, `it takes ${found}`);
});
rule('TV102', 'error', visionary(['GO005', 'TV101']), (m) => {
  const found = m.graph.outputs.find(({name}) => /color|sh|rgb/.test(name))?.name;
  return differ(found !== m.manifest.outputs.appearance.name, `it takes ${found}`);
});
rule('TV103', 'error', visionary(['GM004', 'GI005']), (m) => {
  const fed = (name) => (/camera|view|matrix/.test(name) ? 'view'
    : name.includes('proj') ? 'projection' : name.includes('time') ? 'time' : 'nothing');
  const input = (m.manifest.inputs ?? []).find(({name, role}) => fed(name) !== role);
  return input && `${input.name} is fed ${fed(input.name)}`;
});
rule('TV104', 'error', visionary(['GO006', 'GO008', 'GM005']), (m) => {
  const {dtype, shape} = named(m, 'appearance');
  const read = m.manifest.outputs.appearance.space === 'sh' ? shape[1] === 48
    : shape[1] === 4 && dtype === DTYPE.float16;
  return differ(!read, `${DTYPE_NAME[dtype]} [${shape}]`);
});
rule('TV107', 'info', visionary(['GO010']), (m) =>
  differ(m.graph.dependencies(m.manifest.outputs.count.name).size, 'the count varies'));
rule('TV108', 'warning', visionary(['GM004']), (m) => {
  const input = m.manifest.inputs?.find(({role, range}) => role === 'time' && range && range.join() !== '0,1');
  return input && `time runs over [${input.range}]`;
});
rule('TV109', 'info', visionary(['GO008', 'GG019']), (m) => {
  if (['gaussians', 'appearance'].some((part) => named(m, part).dtype === DTYPE.float16)) return undefined;
  return ofFrame(m).flatMap((node) => node.outputs).find((name) => m.graph.dtype(name) === DTYPE.float16);
});
rule('TV111', 'warning', visionary(['GO005']), (m) =>
  differ(m.manifest.outputs.appearance.color_space === 'linear', 'linear colours'));
rule('TV112', 'warning', visionary(['GM017']), (m) => differ(m.manifest.blend === 'wsr', 'a weighted sum'));
