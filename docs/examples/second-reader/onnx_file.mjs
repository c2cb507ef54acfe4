// Reads an ONNX file: protobuf's wire format, and the few messages of onnx.proto that rules need.

// Messages: field number → [name, kind]. A kind is a scalar, or the name of another message;
// a leading * marks a repeated field.
const MESSAGES = {
  Model: {1: ['irVersion', 'int'], 7: ['graph', 'Graph'], 8: ['opsets', '*Opset'],
    14: ['metadata', '*Entry'], 25: ['functions', '*Function']}, // I14: field 14
  Opset: {1: ['domain', 'text'], 2: ['version', 'int']},
  Entry: {1: ['key', 'text'], 2: ['value', 'bytes']},
  Graph: {1: ['nodes', '*Node'], 2: ['name', 'text'], 5: ['initializers', '*Tensor'],
    11: ['inputs', '*Value'], 12: ['outputs', '*Value'], 13: ['values', '*Value'],
    15: ['sparse', '*Sparse'], 16: ['metadata', '*Entry']},
  Node: {1: ['inputs', '*text'], 2: ['outputs', '*text'], 3: ['name', 'text'], 4: ['op', 'text'],
    5: ['attributes', '*Attribute'], 7: ['domain', 'text'], 9: ['metadata', '*Entry']},
  Attribute: {1: ['name', 'text'], 2: ['f', 'float'], 3: ['i', 'int'], 4: ['s', 'bytes'],
    5: ['t', 'Tensor'], 6: ['g', 'Graph'], 7: ['floats', '*float'], 8: ['ints', '*int'],
    10: ['tensors', '*Tensor'], 11: ['graphs', '*Graph']},
  Function: {1: ['name', 'text'], 4: ['inputs', '*text'], 5: ['outputs', '*text'],
    7: ['nodes', '*Node'], 9: ['opsets', '*Opset'], 10: ['domain', 'text']},
  Value: {1: ['name', 'text'], 2: ['type', 'Type'], 4: ['metadata', '*Entry']},
  Type: {1: ['tensor', 'TensorType']},
  TensorType: {1: ['dtype', 'int'], 2: ['shape', 'Shape']},
  Shape: {1: ['dims', '*Dimension']},
  Dimension: {1: ['size', 'int'], 2: ['symbol', 'text']},
  Sparse: {1: ['values', 'Tensor']},
  Tensor: {1: ['dims', '*int'], 2: ['dtype', 'int'], 4: ['floats', '*float'], 5: ['int32s', '*int'],
    7: ['int64s', '*int'], 8: ['name', 'text'], 9: ['raw', 'bytes'], 10: ['doubles', '*double'],
    11: ['uint64s', '*int'], 13: ['external', '*Text'], 14: ['location', 'int'],
    16: ['metadata', '*Entry']},
  Text: {1: ['key', 'text'], 2: ['value', 'text']},
};

export const DTYPE = {float32: 1, uint8: 2, int8: 3, uint16: 4, int16: 5, int32: 6, int64: 7,
  string: 8, bool: 9, float16: 10, float64: 11, uint32: 12, uint64: 13, complex64: 14,
  complex128: 15, bfloat16: 16};
export const DTYPE_NAME = Object.fromEntries(Object.entries(DTYPE).map(([name, id]) => [id, name]));
export const DTYPE_BYTES = {1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8, 12: 4,
  13: 8, 14: 8, 15: 16, 16: 2};

export class Unreadable extends Error {}

/** Return the ModelProto in `bytes`; integers beyond 2⁵³ lose their last digits. */
export function readModel(bytes) {
  const model = message(bytes, 0, bytes.length, 'Model');
  if (!model.graph) throw new Unreadable('the file has no graph');
  return model;
}

function message(bytes, start, end, kind) {
  const fields = MESSAGES[kind];
  const result = {};
  for (const [name, type] of Object.values(fields)) if (type[0] === '*') result[name] = [];
  let at = start;
  const varint = () => {
    let value = 0n;
    for (let shift = 0n; shift < 70n; shift += 7n) {
      if (at >= end) throw new Unreadable(`a number is cut off at byte ${at}`);
      const byte = bytes[at++];
      value |= BigInt(byte & 127) << shift;
      if (byte < 128) return Number(BigInt.asIntN(64, value));
    }
    throw new Unreadable(`a number has more than ten bytes at byte ${at}`);
  };
  while (at < end) {
    const tag = varint();
    const wire = tag & 7;
    const [name, type] = fields[tag >>> 3] ?? [];
    const scalar = type?.replace('*', '');
    const store = (value) => {
      if (type[0] === '*') result[name].push(value);
      else result[name] = value;
    };
    if (wire === 0) {
      const value = varint();
      if (name) store(value);
    } else if (wire === 1 || wire === 5) {
      if (at + (wire === 1 ? 8 : 4) > end) throw new Unreadable(`a number is cut off at byte ${at}`);
      if (name) store(number(bytes, at, scalar));
      at += wire === 1 ? 8 : 4;
    } else if (wire === 2) {
      const size = varint();
      const stop = at + size;
      if (size < 0 || stop > end) throw new Unreadable(`field ${tag >>> 3} of ${kind} is cut off`);
      if (name === undefined) at = stop;
      else if (scalar === 'int') while (at < stop) store(varint());
      else if (scalar === 'float') for (; at < stop; at += 4) store(number(bytes, at, scalar));
      else if (scalar === 'double') for (; at < stop; at += 8) store(number(bytes, at, scalar));
      else {
        const part = bytes.subarray(at, stop);
        if (scalar === 'bytes') store(part);
        else if (scalar === 'text') store(new TextDecoder().decode(part));
        else store(message(bytes, at, stop, scalar));
        at = stop;
      }
    } else throw new Unreadable(`wire type ${wire} at byte ${at}`);
  }
  return result;
}

function number(bytes, at, kind) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  return kind === 'double' ? view.getFloat64(at, true) : view.getFloat32(at, true);
}

/** Return the float16 `bits` as a number. */
export function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24);
}

/** Return the numbers of a tensor inside the file, or undefined where they lie elsewhere. */
export function numbers(tensor) {
  if (!tensor || tensor.location === 1) return undefined;
  const {raw, dtype} = tensor;
  if (raw === undefined) {
    const stored = [tensor.floats, tensor.int32s, tensor.int64s, tensor.doubles, tensor.uint64s];
    const values = stored.find((list) => list.length) ?? [];
    return dtype === DTYPE.float16 ? values.map(half) : values;
  }
  const view = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const read = {1: (i) => view.getFloat32(4 * i, true), 2: (i) => raw[i],
    3: (i) => view.getInt8(i), 6: (i) => view.getInt32(4 * i, true),
    7: (i) => Number(view.getBigInt64(8 * i, true)), 9: (i) => raw[i],
    10: (i) => half(view.getUint16(2 * i, true)), 11: (i) => view.getFloat64(8 * i, true)}[dtype];
  return read && Array.from({length: raw.length / DTYPE_BYTES[dtype]}, (_, i) => read(i));
}

/** Return the attribute `name` of a node as a number, text, list, tensor or graph. */
export function attribute(node, name) {
  const found = node.attributes.find((entry) => entry.name === name);
  if (!found) return undefined;
  if (found.s) return new TextDecoder().decode(found.s);
  return found.i ?? found.f ?? found.t ?? found.g ?? (found.ints.length ? found.ints : found.floats);
}
