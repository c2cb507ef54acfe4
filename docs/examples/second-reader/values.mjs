// Level `values`: what the outputs of single runs must be.

import path from 'node:path';
import {DTYPE_NAME} from './onnx_file.mjs';
import {Rules} from './rules.mjs';
import {eigenvalues, Frame, runProbes, semiDefinite} from './runs.mjs';
import {digest, outside} from './static_manifest.mjs';
import {addSuspicions} from './suspicions.mjs';

export {startRuntime} from './runs.mjs';
export const rules = new Rules('values');
const rule = rules.add.bind(rules);
const ALL = ['gaussian-generator', 'post-process', 'trajectory-predictor'];

const RUNS = ['GM002', 'GM003', 'GM004', 'GI001', 'GI002', 'GI003', 'GI004', 'GI005', 'GG001', 'GG002',
  'GG012', 'GG019', 'GS001', 'GS002', 'GS004'];
const RUN = ['GV025'];
const COUNT = [...RUN, 'GO010', 'GO011'];
const ROWS = [...RUN, 'GG025', 'GG010', 'GO001', 'GO002', 'GO008'];
const FIELDS = [...ROWS, 'GO016'];
const COLORS = [...ROWS, 'GO005', 'GO006', 'GO007'];

/** The first frame, and the first row of `rows(frame)`, for which `breaks` says so. */
function anyRow(m, rows, breaks) {
  for (const frame of m.frames) {
    const row = rows(frame).find((i) => breaks(frame, i));
    if (row !== undefined) return `${frame.label}: row ${row}`;
  }
  return undefined;
}
const live = (frame) => Array.from({length: frame.live}, (_, i) => i);
const padding = (frame) => Array.from({length: frame.rows - frame.live}, (_, i) => frame.live + i);
const drawn = (frame) => frame.drawn;
const covariance = (frame, i) => frame.row(i).subarray(4);
const anyFrame = (m, check) => {
  for (const frame of m.frames) {
    const message = check(frame);
    if (message) return `${frame.label}: ${message}`;
  }
  return undefined;
};

// ---- the run

rule('GS005', 'error', {kinds: ALL, needs: ['GS001']}, (m) => { // M14
  const used = new Set(m.model.graph.initializers.flatMap((tensor) => tensor.external)
    .filter(({key}) => key === 'location').map(({value}) => value));
  for (const file of m.manifest.external_data ?? []) {
    if (!used.has(file.path)) return `the model does not use ${file.path}`;
    const reason = outside(m.folder, file.path);
    if (reason || digest(path.join(m.folder, file.path)) !== file.sha256) return reason ?? `${file.path} differs`;
  }
  return undefined;
});
rule('GS004', 'error', {kinds: ALL, needs: RUNS.slice(0, -1)}, (m) => { // V3
  const weights = [...m.graph.weights.keys()].reduce((sum, name) => sum + m.graph.bytes(name), 0);
  const large = [...m.graph.computed.keys()].find((name) => m.graph.bytes(name) > 2 ** 31 + 5 * weights);
  return large && `${large} has ${m.graph.bytes(large)} bytes`;
});
rule('GV025', 'error', {kinds: ALL, needs: RUNS}, async (m) => { // I26
  const {runs, error} = await runProbes(m, ownProbes(m));
  m.runs = runs.filter((run) => !run.own);
  m.zero = runs.find((run) => run.label === 'all inputs zero');
  if (m.manifest.kind === 'gaussian-generator') {
    // R25.2: nothing but finite outputs, shapes and the count's range holds at the zero probe.
    m.frames = runs.filter((run) => run !== m.zero && run.label !== TURNED).map((run) => new Frame(run, m.manifest));
    m.everyFrame = runs.map((run) => new Frame(run, m.manifest));
    m.turned = m.everyFrame.find((frame) => frame.label === TURNED);
  }
  return error;
});

const TURNED = 'turned around';
/** Inputs that the text names, and the kit's probes do not have. */
function ownProbes(m) {
  const probe = m.probes[1];
  const image = m.manifest.inputs?.find((input) => input.role === 'image')?.name;
  if (m.manifest.kind === 'post-process' && m.graph.inputs.get(image).shape?.slice(2).includes(null)) {
    return [[37, 53]].map(([h, w]) => { // V10
      const {dtype, shape: [, channels]} = probe.inputs[image];
      const [open, wide] = m.graph.inputs.get(image).shape.slice(2);
      const shape = [1, channels, open ?? h, wide ?? w];
      const values = Array.from({length: shape.reduce((x, y) => x * y)}, (_, i) => (i % 255) / 255);
      return {label: `${shape}`, inputs: {...probe.inputs, [image]: {dtype, shape, values}}};
    });
  }
  const view = m.manifest.inputs?.find((input) => input.role === 'view')?.name;
  if (!view || !probe) return [];
  // V10: the camera of the second probe, turned around.
  const isRow = m.manifest.space?.matrix_order === 'row';
  const values = probe.inputs[view].values.map((value, i) => {
    const row = isRow ? i >> 2 : i & 3;
    return row === 0 || row === 2 ? -value : value;
  });
  return [{label: TURNED, inputs: {...probe.inputs, [view]: {...probe.inputs[view], values}}}];
}

rule('GV024', 'error', {needs: RUN}, (m) => { // C29
  for (const run of m.runs) {
    for (const [name, {dtype, dims}] of run.outputs) {
      const declared = m.graph.output(name);
      const fits = DTYPE_NAME[declared.dtype] === dtype && (!declared.shape
        || (declared.shape.length === dims.length && declared.shape.every((n, i) => n === null || n === dims[i])));
      if (!fits) return `${run.label}: ${name} is ${dtype} [${dims}]`;
    }
  }
  return undefined;
});
rule('GI009', 'error', {needs: RUN}, (m) => { // R25.1
  // V12: a result that another probe gives, too, is judged as that one's.
  const same = (run) => run !== m.zero && [...run.outputs].every(([name, {data}]) =>
    data.every((n, i) => Object.is(n, m.zero.outputs.get(name).data[i])));
  if (m.zero && m.runs.some(same)) return undefined;
  for (const [name, {data}] of m.zero?.outputs ?? []) {
    if (!data.every((n) => Number.isFinite(Number(n)))) return `${name} is not finite`;
  }
  return undefined;
});

// ---- count and cameras

rule('GV016', 'error', {needs: [...COUNT, 'GO001', 'GO002']}, (m) => { // L19
  const frame = m.everyFrame.find(({stored, rows}) => stored < 0 || stored > rows);
  return frame && `${frame.label}: ${frame.stored} of ${frame.rows} rows`;
});
rule('GV054', 'error', {needs: [...COUNT, 'GO001', 'GO002', 'GI001', 'GM006']}, (m) => { // C5.2
  if (!m.turned) return undefined;
  const front = Math.max(...m.frames.map(({drawn}) => drawn.length));
  const behind = m.turned.drawn.length;
  return front <= 0.1 * behind ? `${front} rows in front, ${behind} behind` : undefined;
});
rule('GV032', 'error', {needs: [...COUNT, 'GO004', 'GV054']}, (m) => // L19, I7
  (m.everyFrame.every((frame) => frame.stored === 0) ? 'no row is live at any probe' : undefined));
rule('GV059', 'error', {needs: [...COUNT, 'GO001', 'GO002', 'GI001', 'GM006']}, (m) => { // C1.3
  const view = m.manifest.inputs?.find((input) => input.role === 'view')?.name;
  const [a, b] = m.frames;
  if (!view || !b || Math.min(a.live, b.live) < 4) return undefined;
  const order = m.manifest.space.matrix_order ?? 'column';
  // The space of the centres in camera i's frame, undone: camera and OpenGL space, relative to the
  // camera's centre c or to t, moved by c, turned by R, moved by the inverse of the view matrix.
  const spaces = [
    ({p, t, turned}) => turned(p.map((x, k) => x - t[k])),
    ({p, t, turned}) => turned([p[0] - t[0], -p[1] - t[1], -p[2] - t[2]]),
    ({p, c}) => p.map((x, k) => x + c[k]),
    ({p, c}) => p.map((x, k) => x - c[k]),
    ({p, t}) => p.map((x, k) => x + t[k]),
    ({p, turned}) => turned(p),
    ({p, t, at}) => [0, 1, 2].map((r) => at(r, 0) * p[0] + at(r, 1) * p[1] + at(r, 2) * p[2] + t[r]),
  ];
  const undone = (frame, i, space) => {
    const {values} = frame.inputs[view];
    const at = (r, c) => values[order === 'row' ? 4 * r + c : 4 * c + r];
    const turned = (p) => [0, 1, 2].map((c) => p[0] * at(0, c) + p[1] * at(1, c) + p[2] * at(2, c));
    const [t, p] = [[0, 1, 2].map((r) => at(r, 3)), [...frame.row(i).slice(0, 3)]];
    return space({p, t, at, turned, c: turned(t).map((x) => -x)});
  };
  const rows = live(a).filter((i) => i < b.live && a.finite(i) && b.finite(i));
  const distance = (f, g) => Math.sqrt(rows.reduce((sum, i) => {
    const [p, q] = [f(i), g(i)];
    return sum + (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2;
  }, 0) / rows.length);
  const here = (frame) => (i) => frame.row(i);
  const centre = [0, 1, 2].map((k) => rows.reduce((sum, i) => sum + a.row(i)[k], 0) / rows.length);
  const spread = distance(here(a), () => centre);
  const follows = distance(here(a), here(b)) > 0.05 * spread
    && spaces.some((space) => distance((i) => undone(a, i, space), (i) => undone(b, i, space)) < 0.002 * spread);
  return follows ? 'centres move with the camera' : undefined;
});

// ---- rows

rule('GV001', 'error', {needs: ROWS}, (m) => anyRow(m, live, (frame, i) => !frame.finite(i))); // L21, C21
rule('GV002', 'error', {needs: ROWS}, (m) => anyRow(m, padding, (frame, i) => !frame.finite(i))); // L21.1
rule('GV010', 'error', {needs: ROWS}, (m) => anyFrame(m, (frame) => // L9
  ([frame.gaussians, frame.colors].some((output) => output?.dtype === 'float16'
    && output.data.some((n) => Number.isFinite(n) && Math.abs(n) >= 65504)) ? 'a value is 65504' : undefined)));

// Orders that other tools write, as the column of xx xy xz yy yz zz (L3).
const ORDERS = {'the diagonal first': [4, 7, 8, 5, 9, 6], 'the lower triangle': [4, 5, 7, 6, 8, 9]};
rule('GO016', 'error', {needs: ROWS}, (m) => { // L3, L6
  const frame = m.frames.find(({live: n}) => n > 0);
  if (!frame) return undefined;
  const rows = live(frame).filter((i) => frame.finite(i));
  const share = (holds) => rows.filter((i) => holds(frame.row(i))).length / rows.length;
  const valid = (order) => share((row) => {
    const sigma = order.map((column) => row[column]);
    return [0, 3, 5].every((k) => sigma[k] >= 0) && semiDefinite(sigma, frame.isHalf);
  });
  if (rows.length < 16 || valid([4, 5, 6, 7, 8, 9]) > 0.5) return undefined;
  const order = Object.keys(ORDERS).find((name) => valid(ORDERS[name]) > 0.99);
  if (order) return order;
  const quaternion = [3, 6].find((at) => share((row) => // scales and a unit quaternion
    Math.abs(Math.hypot(...row.subarray(at, at + 4)) - 1) < 1e-2) > 0.99);
  return quaternion && `a quaternion in column ${quaternion}`;
});
rule('GV003', 'error', {needs: FIELDS}, (m) => anyRow(m, live, (frame, i) => // L5
  frame.finite(i) && !(frame.row(i)[3] >= -0.001 && frame.row(i)[3] <= 1.001)));
rule('GV005', 'error', {needs: FIELDS}, (m) => anyRow(m, drawn, (frame, i) => // L6
  [0, 3, 5].some((k) => covariance(frame, i)[k] < 0)));
rule('GV006', 'error', {needs: FIELDS}, (m) => anyRow(m, drawn, (frame, i) => // L7, L8.2
  [0, 3, 5].every((k) => covariance(frame, i)[k] >= 0) && !semiDefinite(covariance(frame, i), frame.isHalf)));
rule('GV007', 'warning', {needs: FIELDS}, (m) => anyRow(m, drawn, (frame, i) => // L8.1
  covariance(frame, i).every((n) => n === 0)));
rule('GV008', 'warning', {needs: FIELDS, when: (target) => target.capture}, (m) => anyFrame(m, (frame) => { // T6
  if (!frame.isHalf) return undefined;
  const small = frame.drawn.filter((i) => {
    const largest = Math.max(...[0, 3, 5].map((k) => covariance(frame, i)[k]));
    return largest > 0 && largest < 2 ** -14;
  });
  return small.length > 0.1 * frame.drawn.length ? `${small.length} rows` : undefined; // 100 ‰
}));
rule('GV009', 'warning', {needs: FIELDS}, (m) => anyFrame(m, (frame) => { // L9
  const digits = frame.isHalf ? 10 : 23;
  const coarse = frame.drawn.filter((i) => {
    const far = Math.max(...frame.row(i).subarray(0, 3).map(Math.abs));
    return 2 ** (Math.floor(Math.log2(far)) - digits) > Math.sqrt(eigenvalues(covariance(frame, i))[2]);
  });
  const extended = coarse.filter((i) => covariance(frame, i).some((n) => n !== 0)); // else GV007
  return extended.length > 0.01 * frame.drawn.length ? `${extended.length} rows` : undefined;
}));
const bounds = (m) => {
  const {min, max} = m.manifest.bounds;
  return {min, max, diagonal: Math.hypot(...min.map((low, k) => max[k] - low))};
};
rule('GV011', 'warning', {needs: [...FIELDS, 'GM009', 'GM019']}, (m) => // M10.3
  anyRow(m, (frame) => (frame.drawn.length >= 16 ? frame.drawn : []), (frame, i) =>
    Math.sqrt(eigenvalues(covariance(frame, i))[2]) > bounds(m).diagonal));
rule('GV021', 'error', {needs: [...FIELDS, 'GM009', 'GM019', 'GV059']}, (m) => anyFrame(m, (frame) => { // M10.3
  const {min, max, diagonal} = bounds(m);
  const slack = 0.001 * diagonal;
  const out = frame.drawn.filter((i) => min.some((low, k) =>
    !(frame.row(i)[k] >= low - slack && frame.row(i)[k] <= max[k] + slack)));
  return out.length > 0.001 * frame.drawn.length ? `${out.length} rows` : undefined;
}));
rule('GV065', 'warning', {needs: [...ROWS, 'GM009', 'GM019']}, (m) => { // M10.4
  const rows = m.frames.flatMap((frame) => frame.drawn.map((i) => frame.row(i)));
  const extents = [0, 1, 2].map((k) => {
    const ends = rows.flatMap((row) => [-1, 1].map((sign) =>
      row[k] + sign * Math.sqrt(Math.max(0, row[[4, 7, 9][k]]))));
    return ends.reduce((x, y) => Math.max(x, y), -Infinity) - ends.reduce((x, y) => Math.min(x, y), Infinity);
  });
  return rows.length && bounds(m).diagonal > 100 * Math.hypot(...extents) ? 'the bounds are far too large' : undefined;
});
rule('GV004', 'warning', {needs: [...FIELDS, 'GV054']}, (m) => { // L20.3
  const opacities = m.frames.flatMap((frame) => live(frame).filter((i) => frame.finite(i))
    .map((i) => frame.row(i)[3]));
  const [all, seen] = [opacities.length, opacities.filter((a) => a >= 1 / 255).length];
  return seen < 0.1 * all ? `${seen} of ${all} rows are visible` : undefined;
});
rule('GV018', 'error', {needs: [...FIELDS, 'GV032']}, (m) => anyRow(m, padding, (frame, i) => // L21.1
  frame.finite(i) && frame.row(i)[3] !== 0));
rule('GV020', 'warning', {needs: ROWS}, (m) => anyFrame(m, (frame) => { // L20.4
  const seen = new Set(frame.drawn.map((i) => frame.row(i).join()));
  const copies = frame.drawn.length - seen.size;
  return frame.drawn.length >= 16 && copies > 0.1 * frame.drawn.length ? `${copies} copies` : undefined;
}));
rule('GO012', 'info', {needs: [...ROWS, 'GO010', 'GO011']}, (m) => { // L22.1
  if (m.graph.dependencies(m.manifest.outputs.count.name).size) return undefined;
  const {stored, rows} = m.everyFrame[0];
  return stored > 0 && rows > Math.ceil(stored / 256) * 256 ? `${stored} of ${rows} rows` : undefined;
});
rule('GL006', 'warning', {needs: [...COUNT, 'GO001', 'GO002'], when: (_, name) => name === 'visionary'}, (m) => {
  const frame = m.frames.find(({stored, rows}) => stored < rows && rows % 256);
  return frame && `${frame.rows} rows`; // T7
});
rule('TV110', 'info', {needs: [...ROWS, 'GM009'], when: (_, name) => name === 'visionary'}, (m) => anyFrame(m, (frame) => {
  // A lens of 45° on 1080 rows that sees all of the bounds; the filter is 0.3 pixels² (C24).
  const focal = 540 / Math.tan(Math.PI / 8);
  const distance = bounds(m).diagonal / 2 / Math.sin(Math.PI / 8);
  const faded = frame.drawn.filter((i) => {
    const [xx, , , yy, , zz] = covariance(frame, i);
    const pixels = ((xx + yy + zz) / 3) * (focal / distance) ** 2;
    return pixels / (pixels + 0.3) < 0.5;
  });
  return faded.length > 0.5 * frame.drawn.length ? `${faded.length} rows` : undefined;
}));

// ---- colours

rule('GV012', 'error', {needs: COLORS}, (m) => { // L14
  const {space, range: [low, high] = [0, 1]} = m.manifest.outputs.appearance;
  const slack = 0.01 * Math.abs(high - low);
  if (space !== 'rgb') return undefined;
  return anyRow(m, drawn, (frame, i) => frame.color(i).some((c) => !(c >= low - slack && c <= high + slack)))
    ?? (low > high ? 'the range is upside down' : undefined);
});
rule('GV013', 'warning', {needs: [...COLORS, 'GM005']}, (m) => anyFrame(m, (frame) => { // L17
  if (frame.isRgb) return undefined;
  const rest = frame.drawn.flatMap((i) => [...frame.color(i).subarray(3)]);
  const large = rest.filter((c) => Math.abs(c) > 10).length;
  return large > 0.01 * rest.length ? `${large} of ${rest.length} coefficients` : undefined;
}));
rule('GV022', 'info', {needs: [...COLORS, 'GM005']}, (m) => anyFrame(m, (frame) => { // L11.2
  if (!frame.isRgb || frame.channels !== 4) return undefined;
  const fourth = new Set(live(frame).map((i) => frame.colors.data[4 * i + 3]));
  return fourth.size > 1 ? `${fourth.size} values` : undefined;
}));

// ---- cells

const CELLS = [...ROWS, 'GO021'];
const anyCell = (m, breaks) => anyFrame(m, (frame) => {
  if (!frame.cells) return undefined;
  const size = m.manifest.outputs.cells.per_cell;
  const isHalf = frame.cells.dtype === 'float16';
  for (let c = 0; c < frame.cells.dims[0]; c++) {
    const cell = frame.cells.data.subarray(10 * c, 10 * c + 10);
    const rows = Array.from({length: size}, (_, k) => c * size + k).filter((i) => i < frame.live);
    if (breaks({frame, cell, rows, isHalf, visibility: cell[3]})) return `cell ${c}`;
  }
  return undefined;
});
rule('GV026', 'error', {needs: CELLS}, (m) => anyCell(m, ({cell, isHalf}) => // W7.3
  !cell.every((n) => Number.isFinite(n) && !(isHalf && Math.abs(n) >= 65504))));
rule('GV027', 'error', {needs: CELLS}, (m) => anyCell(m, ({visibility}) => // W5
  visibility < -0.001 || visibility > 1.001));
rule('GV028', 'error', {needs: CELLS}, (m) => anyCell(m, ({cell, visibility, isHalf}) => // W6
  visibility > 0 && cell.every(Number.isFinite) && !semiDefinite(cell.subarray(4), isHalf)));
rule('GV029', 'warning', {needs: [...CELLS, 'GO010', 'GO011']}, (m) => anyCell(m, ({frame, rows, visibility}) => // W7.1
  visibility === 0 && rows.some((i) => frame.row(i)[3] !== 0)));
rule('GV030', 'error', {needs: [...CELLS, 'GO010', 'GO011']}, (m) => anyCell(m, ({rows, visibility}) => // W7.2
  !rows.length && visibility !== 0));
rule('GV031', 'warning', {needs: CELLS}, (m) => anyCell(m, ({frame, cell, rows, visibility}) => { // W3.2, W4
  const reach = 2 * Math.sqrt(cell[4] + cell[7] + cell[9]);
  return visibility > 0 && rows.some((i) => frame.row(i)[3] >= 1 / 255
    && Math.hypot(...[0, 1, 2].map((k) => frame.row(i)[k] - cell[k])) > reach);
}));

// ---- post-process models

const IMAGE = {kinds: ['post-process'], needs: RUN};
const pictures = (m, check) => {
  for (const run of m.runs) {
    const message = check(run.outputs.get(m.manifest.outputs.image.name), run);
    if (message) return `${run.label}: ${message}`;
  }
  return undefined;
};
rule('GV055', 'error', IMAGE, (m) => pictures(m, ({data}) => // M58.2
  (data.every(Number.isFinite) ? undefined : 'not finite')));
rule('GV056', 'error', {...IMAGE, needs: [...RUN, 'GO018']}, (m) => { // M58.2
  const image = m.manifest.inputs.find((input) => input.role === 'image').name;
  const scale = m.manifest.outputs.image.scale ?? 1;
  return pictures(m, ({dims}, run) => {
    const {shape} = run.inputs[image];
    const fits = dims.length === 4 && [2, 3].every((k) => dims[k] === scale * shape[k]);
    return fits ? undefined : `[${dims}] for [${shape}]`;
  });
});
rule('GV057', 'error', {...IMAGE, needs: ['GV055', 'GV056', 'GG025', 'GG010']}, (m) => { // R46.5
  const [low, high] = m.manifest.outputs.image.range ?? [0, 1];
  const slack = 0.25 * (high - low);
  return pictures(m, ({data}) => {
    const out = data.filter((n) => !(n >= low - slack && n <= high + slack)).length;
    return out > 0.1 * data.length ? `${out} of ${data.length} values` : undefined;
  });
});

// ---- trajectory predictors

const PATH = {kinds: ['trajectory-predictor'], needs: [...RUN, 'GO019']};
const states = (m, check) => {
  const {future, uncertainty} = m.manifest.outputs;
  const history = m.manifest.inputs?.find((input) => input.role === 'camera_history');
  for (const run of m.runs) {
    const predicted = run.outputs.get(future.name);
    const [steps, size] = predicted.dims;
    const rows = Array.from({length: steps}, (_, i) => [...predicted.data.subarray(i * size, (i + 1) * size)]);
    const newest = history && run.inputs[history.name].values.slice(-size);
    const message = check({rows, size, sigma: run.outputs.get(uncertainty.name), newest, zero: run === m.zero});
    if (message) return `${run.label}: ${message}`;
  }
  return undefined;
};
rule('GV060', 'error', PATH, (m) => states(m, ({rows, sigma}) => // M66.2
  ([...rows.flat(), ...sigma.data].every(Number.isFinite) ? undefined : 'not finite')));
const AFTER = {...PATH, needs: [...PATH.needs, 'GV060']};
rule('GV061', 'error', AFTER, (m) => states(m, ({rows, size, sigma}) => { // M66.2, M69.3
  const width = sigma.dims[1];
  const upper = m.manifest.outputs.uncertainty.semantics === 'covariance-upper';
  const diagonal = Array.from({length: size}, (_, k) => (upper ? k * size - (k * (k - 1)) / 2 : k));
  const low = rows.findIndex((_, i) => diagonal.some((k) => !(sigma.data[i * width + k] > 0)));
  return low >= 0 ? `step ${low}` : undefined;
}));
const isQuaternion = (m) => m.manifest.outputs.future.representation.endsWith('wxyz');
rule('GV062', 'error', AFTER, (m) => isQuaternion(m) && states(m, ({rows, zero}) => { // M66.2
  const off = rows.findIndex((row) => Math.abs(Math.hypot(...row.slice(3)) - 1) > 0.001);
  return !zero && off >= 0 ? `step ${off}` : undefined;
}));
rule('GV064', 'error', {...AFTER, needs: [...AFTER.needs, 'GV062']}, (m) => states(m, ({rows, newest, zero}) => { // M65
  if (zero) return undefined;
  const before = [newest, ...rows];
  const off = rows.findIndex((row, i) => (isQuaternion(m)
    ? before[i] && row.slice(3).reduce((sum, q, k) => sum + q * before[i][3 + k], 0) < -0.001
    : Math.hypot(...row.slice(3)) > Math.PI + 0.001));
  return off >= 0 ? `step ${off}` : undefined;
}));

addSuspicions(rule, {FIELDS, COLORS, SCENE: [...FIELDS, 'GV003', 'GV005', 'GV006']});
