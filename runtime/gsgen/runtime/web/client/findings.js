/**
 * Judges a model's manifest beside its graph, by rules of the contract that run nothing.
 *
 * Ids, severities and hints come from the document `plans.json`; the other rules are checked by
 * `gsgen validate MODEL`.
 */

import { graphOf, manifestText } from "./onnx_metadata.js";

/** @typedef {{rule: string, severity: string, where: string, actual: string, expected: string,
 *     hint: string}} PageFinding */
/** @typedef {{name: string, dtype: string, dims: (number | string | null)[] | null}} Tensor */
/** @typedef {string[]} Violation Rule, where, actual and expected. */

const short = (text) => (text.length <= 60 ? text : `${text.slice(0, 57)}…`);
const shortJson = (value) => short(typeof value === "string" ? value : JSON.stringify(value));
const listed = (parts) => `[${parts.join(", ")}]`;
const shapeOf = ({ dtype, dims }) => `shape ${dtype || "?"} ${listed(dims.map((dim) => dim ?? "?"))}`;
const decimal = (number) => (Number.isInteger(number) ? number.toFixed(1) : String(number));

/** Return what is wrong with a model, as far as a page checks it. @returns {PageFinding[]} */
export function findingsOf(bytes, plans) {
  const { rules } = plans.contract;
  return [...violationsOf(bytes, plans.contract)].map(([rule, where, actual, expected]) => {
    return { rule, where, actual, expected, ...rules[rule] };
  });
}

function* violationsOf(bytes, contract) {
  const text = manifestText(bytes);
  if (text === null) {
    yield ["GM001", "metadata_props", "no key 'gsgen.manifest'", "a manifest under that key"];
    return;
  }
  let manifest;
  try {
    manifest = JSON.parse(text);
  } catch (error) {
    yield ["GM002", "manifest", short(text), `a JSON document (${error.message})`];
    return;
  }
  const declared = [...version(manifest, contract)];
  yield* declared;
  if (declared.some(([rule]) => rule !== "GM015")) return;
  if (!contract.kinds.includes(manifest.kind)) {
    yield ["GM002", "manifest kind", shortJson(manifest.kind ?? null), `one of ${contract.kinds.join(", ")}`];
    return;
  }
  const graph = graphOf(bytes);
  const missing = [...namesExist(manifest, graph)];
  yield* missing;
  if (manifest.kind !== "gaussian-generator") return;
  if (!missing.length) yield* tensorsAgree(manifest, graph, contract);
  const { gaussians, appearance, cells } = manifest.outputs ?? {};
  const [rows, colors, groups] = [gaussians, appearance, cells].map((spec) => {
    return graph.outputs.find(({ name, dims }) => name === spec?.name && dims);
  });
  if (rows) yield* rowsFit(rows, contract.rows);
  if (rows && colors) yield* colorsFit([rows, colors, groups], appearance.space, contract.appearance);
  if (!manifest.space) yield ["GM006", "manifest space", "not declared", "up, unit and matrix_order"];
  yield* boundsHold(manifest);
}

function* version({ contract: value }, { version: [major, minor] }) {
  const parts = /^(\d{1,5})\.(\d{1,5})$/.exec(typeof value === "string" ? value : "");
  if (!parts) {
    yield ["GM003", "manifest contract", shortJson(value ?? "nothing"), 'a version such as "1.0"'];
    return;
  }
  const [first, second] = parts.slice(1).map(Number);
  const dotted = `${first}.${second}`;
  if (first > major || first < 1) {
    yield ["GM003", "manifest contract", dotted, `major version 1 to ${major}`];
  } else if (first === major && second > minor) {
    yield ["GM015", "manifest contract", dotted, `${major}.${minor} or older`];
  }
}

/** Check that each declared name is a tensor of the graph, and declared once (GM004). */
function* namesExist(manifest, graph) {
  const outputs = Object.values(manifest.outputs ?? {}).filter((part) => part?.name);
  for (const [side, specs] of [["input", manifest.inputs ?? []], ["output", outputs]]) {
    const names = graph[`${side}s`].map(({ name }) => name);
    const known = names.slice(0, 8).join(", ") + (names.length > 8 ? ", …" : "");
    const expected = names.length ? `one of ${known}` : "a tensor that exists; the graph has none";
    for (const { name } of specs) {
      if (!names.includes(name)) {
        yield ["GM004", `manifest ${side} '${name}'`, `no such graph ${side}`, expected];
      }
    }
  }
  for (const specs of [manifest.inputs ?? [], outputs]) {
    const names = specs.map(({ name }) => name);
    for (const name of new Set(names.filter((each, i) => names.indexOf(each) !== i))) {
      yield ["GM004", `manifest name '${name}'`, "declared more than once", "one role per tensor"];
    }
  }
}

/** Check that declared dtypes and sizes are those of the graph (GM005). */
function* tensorsAgree({ inputs = [], outputs = /** @type {any} */ ({}) }, graph, { channels }) {
  const tensorOf = (side, name) => graph[side].find((tensor) => tensor.name === name);
  const isSize = (dim) => typeof dim === "number" && dim > 0;
  for (const { name, shape } of inputs) {
    const dims = tensorOf("inputs", name)?.dims;
    if (shape && dims?.length && dims.every(isSize) && dims.join() !== shape.join()) {
      yield ["GM005", `input ${name}`, `graph has ${listed(dims)}`, `the declared shape ${listed(shape)}`];
    }
  }
  const dtypesAgree = function* (spec) {
    const tensor = spec && tensorOf("outputs", spec.name);
    if (!tensor || !["float32", "float16"].includes(tensor.dtype)) return;
    if (tensor.dtype !== spec.dtype) {
      yield ["GM005", `output ${spec.name}`, `graph has ${tensor.dtype}`, `the declared dtype ${spec.dtype}`];
    }
  };
  const { gaussians, appearance, cells } = outputs;
  yield* dtypesAgree(gaussians);
  const rows = gaussians && tensorOf("outputs", gaussians.name)?.dims;
  if (rows?.length === 2 && isSize(rows[0]) && rows[0] !== gaussians.capacity) {
    yield ["GM005", `output ${gaussians.name}`, `graph has ${rows[0]} rows`, `the declared capacity ${gaussians.capacity}`];
  }
  const color = appearance && tensorOf("outputs", appearance.name);
  const width = color?.dims?.length === 2 ? color.dims[1] : null;
  if (appearance?.space === "sh" && typeof width === "number" && /^float(32|16)$/.test(color.dtype)) {
    const where = `output ${appearance.name}`;
    const { degree } = appearance;
    if (degree == null) {
      yield ["GM005", where, "no degree is declared", `the degree of ${width} SH channels`];
    } else if (channels.includes(width) && width !== channels[degree]) {
      yield ["GM005", where, `graph has ${width} channels`, `${channels[degree]} channels, as SH degree ${degree} has`];
    }
  }
  yield* dtypesAgree(cells);
}

/** Check the shape of the packed rows (GO002, GO003), and that a dispatch reaches all (GL003). */
function* rowsFit(tensor, { width, most, meanings }) {
  const { name, dims } = tensor;
  const [where, rows, columns] = [`output ${name}`, dims[0], dims[dims.length - 1]];
  const shape = shapeOf(tensor);
  if (dims.length !== 2) {
    const flat = dims.length === 1 ? "; these rows are flattened" : "";
    yield ["GO003", where, shape, `two axes, [N, ${width}]${flat}`];
  } else if (columns !== width) {
    const meaning = meanings[columns] ? `; ${columns} columns usually are ${meanings[columns]}` : "";
    const likely = rows === width ? "; this one is transposed, channels first" : meaning;
    yield ["GO002", where, shape, `[N, ${width}]${likely}`];
  } else if (rows > most) yield ["GL003", where, `${rows} rows`, `${most} rows at most`];
}

/** Check the shape of the appearance (GO006, GO007), and the dtypes of outputs (GO008, GO009). */
function* colorsFit([rows, colors, groups], space, channelCounts) {
  const [{ name, dtype, dims }, allowed] = [colors, channelCounts[space]];
  const [where, channels] = [`output ${name}`, dims[dims.length - 1]];
  if (dims.length !== 2 || !allowed.includes(channels)) {
    const isRest = space === "sh" && allowed.includes(channels + 3);
    const cause = isRest ? `; ${channels} is f_rest without the constant term f_dc` : "";
    const flat = dims.length === 3 ? "; reshape the last two axes into one" : "";
    yield ["GO006", where, shapeOf(colors), `[N, C] with C in ${listed(allowed)} for ${space}${cause || flat}`];
  } else if (rows.dims[0] > 0 && dims[0] !== rows.dims[0]) {
    yield ["GO007", where, `${dims[0]} rows`, `${rows.dims[0]} rows`];
  }
  const wrong = [rows, colors, groups].filter((tensor) => tensor && !/^float(32|16)$/.test(tensor.dtype));
  for (const tensor of wrong) yield ["GO008", `output ${tensor.name}`, tensor.dtype, "float32 or float16"];
  if (!wrong.length && rows.dtype !== dtype) yield ["GO009", where, dtype, `${rows.dtype}, as ${rows.name}`];
}

/** Check that bounds are declared, and are a box (GM009, GM019). */
function* boundsHold({ bounds, outputs }) {
  if (!bounds) {
    yield ["GM009", "manifest bounds", "not declared", "min and max corners"];
    return;
  }
  const [low, high] = [bounds.min, bounds.max];
  const actual = `min ${listed(low.map(decimal))}, max ${listed(high.map(decimal))}`;
  if (!low.every((x, axis) => x <= high[axis])) {
    yield ["GM019", "manifest bounds", actual, "min <= max on every axis"];
  } else if (low.join() === high.join() && outputs?.gaussians?.capacity > 1) {
    yield ["GM019", "manifest bounds", actual, "a box; these bounds are a point"];
  }
}
