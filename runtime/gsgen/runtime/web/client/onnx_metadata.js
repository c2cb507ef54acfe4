/** Reads what a page has to know of an ONNX file: its manifest, and what computes its outputs. */

const KEYS = ["gsgen.manifest", "gaussian-generator.manifest"];
const METADATA = 14; // ModelProto.metadata_props
const [IR_VERSION, GRAPH] = [1, 7]; // ModelProto.ir_version, ModelProto.graph
const [NODE, WEIGHT, INPUT, OUTPUT] = [1, 5, 11, 12]; // GraphProto
const DTYPES = // by TensorProto.DataType
  "? float32 uint8 int8 uint16 int16 int32 int64 string bool float16 float64 uint32 uint64 ? ? bfloat16".split(" ");
const EMPTY = new Uint8Array();
const TENSOR_NAME = 8; // TensorProto.name
const NODE_PARTS = { input: 1, output: 2, operator: 4 }; // NodeProto

/**
 * Yield the fields of a protobuf message: number, and bytes or a number.
 * @returns {Generator<[number, any]>}
 */
function* fieldsOf(bytes) {
  let position = 0;
  const varint = () => {
    let [value, factor] = [0, 1];
    for (;;) {
      if (position >= bytes.length) throw new RangeError("a number ends behind the message");
      const byte = bytes[position++];
      value += (byte & 127) * factor;
      if (byte < 128) return value;
      factor *= 128;
    }
  };
  while (position < bytes.length) {
    const key = varint();
    const [number, wire] = [Math.floor(key / 8), key % 8];
    if (wire === 0) yield [number, varint()];
    else if (wire === 1 || wire === 5) position += wire === 1 ? 8 : 4;
    else if (wire === 2) {
      const length = varint();
      if (position + length > bytes.length) throw new RangeError("a field ends behind the message");
      yield [number, bytes.subarray(position, position + length)];
      position += length;
    } else throw new RangeError(`wire type ${wire}`);
  }
}

/** Return whether bytes begin like an ONNX model. @param {Uint8Array} bytes */
export function isOnnx(bytes) {
  if (bytes[0] !== 8 * IR_VERSION) return false;
  try {
    for (const [number] of fieldsOf(bytes)) if (number === GRAPH) return true;
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
  }
  return false;
}

/** Return the text of a model's manifest; null without one. @param {Uint8Array} bytes */
export function manifestText(bytes) {
  const decoder = new TextDecoder();
  for (const [number, value] of fieldsOf(bytes)) {
    if (number !== METADATA || typeof value === "number") continue;
    const entry = new Map(fieldsOf(value));
    const text = (part) => decoder.decode(entry.get(part));
    if (KEYS.includes(text(1))) return text(2);
  }
  return null;
}

/** Return the bytes of a model's graph. @param {Uint8Array} bytes */
function graphBytes(bytes) {
  return [...fieldsOf(bytes)].find(([number]) => number === GRAPH)?.[1] ?? EMPTY;
}

/**
 * Return the inputs and outputs of a model's graph, as it declares them.
 * @returns {Record<"inputs" | "outputs", import("./findings.js").Tensor[]>}
 */
export function graphOf(bytes) {
  const fields = [...fieldsOf(graphBytes(bytes))];
  const tensors = (part) => fields.filter(([number]) => number === part).map(([, value]) => tensorOf(value));
  return { inputs: tensors(INPUT), outputs: tensors(OUTPUT) };
}

/** Return name, dtype and dimensions of a ValueInfoProto. */
function tensorOf(bytes) {
  const decoder = new TextDecoder();
  const info = new Map(fieldsOf(bytes));
  const type = new Map(fieldsOf(new Map(fieldsOf(info.get(2) ?? EMPTY)).get(1) ?? EMPTY));
  const shape = type.get(2) && [...fieldsOf(type.get(2))].filter(([number]) => number === 1);
  const dims = shape?.map(([, dim]) => {
    const [entry] = [...fieldsOf(dim)].filter(([number]) => number <= 2);
    return entry ? (typeof entry[1] === "number" ? entry[1] : decoder.decode(entry[1])) : null;
  });
  return { name: decoder.decode(info.get(1)), dtype: DTYPES[type.get(1)] ?? "", dims: dims ?? null };
}

/**
 * Sort the outputs of a model by what computes them in a captured graph, which records kernels alone.
 *
 * A buffer copy is not recorded: its output is stale, or overwritten, in all frames but the first.
 * Outputs that depend on no input are constants, which ONNX Runtime folds: nothing computes them.
 * @param {{always: string[], "of one input": string[]}} copies Operators without kernels.
 * @returns {{copied: string[], constant: string[], all: string[]}}
 */
export function outputsByOrigin(bytes, copies) {
  const decoder = new TextDecoder();
  const nameOf = (value, part = 1) => decoder.decode(new Map(fieldsOf(value)).get(part));
  const [outputs, changing, copied, weights] = [[], new Set(), new Set(), new Set()];
  const [inputs, nodes] = [[], []];
  for (const [number, value] of fieldsOf(graphBytes(bytes))) {
    if (typeof value === "number") continue;
    if (number === OUTPUT) outputs.push(nameOf(value));
    else if (number === INPUT) inputs.push(nameOf(value));
    else if (number === WEIGHT) weights.add(nameOf(value, TENSOR_NAME));
    else if (number === NODE) nodes.push(nodeOf(value, decoder));
  }
  // Files of the oldest versions list weights among the inputs.
  for (const name of inputs) {
    copied.add(name);
    if (!weights.has(name)) changing.add(name);
  }
  for (const { operator, reads, writes } of nodes) {
    if (!reads.some((name) => changing.has(name))) continue;
    // A reduction without axes may return its input, too.
    const isCopy =
      copies.always.includes(operator) ||
      operator.startsWith("Reduce") ||
      (reads.length === 1 && copies["of one input"].includes(operator));
    for (const name of writes) {
      changing.add(name);
      if (isCopy) copied.add(name);
    }
  }
  return {
    all: outputs,
    constant: outputs.filter((name) => !changing.has(name)),
    copied: outputs.filter((name) => changing.has(name) && copied.has(name)),
  };
}

/** Return operator, inputs and outputs of a node. */
function nodeOf(bytes, decoder) {
  const parts = [...fieldsOf(bytes)];
  const texts = (part) =>
    parts.filter(([field]) => field === part).map(([, text]) => decoder.decode(text));
  const { input, output, operator } = NODE_PARTS;
  return { operator: texts(operator)[0] ?? "", reads: texts(input), writes: texts(output) };
}
