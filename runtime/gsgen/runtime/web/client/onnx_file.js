/** Reads ONNX files: protobuf messages, whose fields have the names that ONNX gives them. */

/** @typedef {Record<string, [number, string, string, number][]>} Messages Fields: number, name, kind, repeated. */

/** Read a number of 7 bits a byte: its value, and the position behind it. */
function varint(bytes, start) {
  let [value, complement, factor] = [0, 0, 1];
  for (let position = start; position < bytes.length; position++) {
    const byte = bytes[position];
    if (position === start + 9) return [-complement - 1, position + 1]; // the highest of 64 bits is set
    value += (byte & 127) * factor;
    complement += (~byte & 127) * factor;
    factor *= 128;
    if (byte >= 128) continue;
    return [value, position + 1];
  }
  throw new RangeError("a number ends behind the message");
}

/**
 * Yield the fields of a protobuf message: number, and bytes or a number.
 * @returns {Generator<[number, any]>}
 */
function* fieldsOf(bytes) {
  for (let position = 0; position < bytes.length; ) {
    let key, value;
    [key, position] = varint(bytes, position);
    const [number, wire] = [Math.floor(key / 8), key % 8];
    if (wire === 0) {
      [value, position] = varint(bytes, position);
      yield [number, value];
      continue;
    }
    if (![1, 2, 5].includes(wire)) throw new RangeError(`wire type ${wire}`);
    let length = wire === 1 ? 8 : 4;
    if (wire === 2) [length, position] = varint(bytes, position);
    if (position + length > bytes.length) throw new RangeError("a field ends behind the message");
    yield [number, bytes.subarray(position, position + length)];
    position += length;
  }
}

/** Yield packed integers. */
function* integers(value) {
  for (let position = 0; position < value.length; ) {
    let number;
    [number, position] = varint(value, position);
    yield number;
  }
}

/** A protobuf message; fields are decoded when they are read. */
export class Message {
  /** @param {Messages} messages @param {Uint8Array} bytes */
  constructor(messages, type, bytes) {
    const parts = new Map();
    for (const [number, value] of fieldsOf(bytes)) parts.set(number, [...(parts.get(number) ?? []), value]);
    const numbers = new Map(messages[type].map(([number, name]) => [name, number]));
    this.HasField = (name) => parts.has(numbers.get(name));
    for (const [number, name, kind, isRepeated] of messages[type]) {
      const get = () => {
        const read = (parts.get(number) ?? []).flatMap((part) => decoded(messages, kind, part));
        const value = isRepeated ? read : (read.at(-1) ?? decoded(messages, kind, new Uint8Array())[0] ?? 0);
        Object.defineProperty(this, name, { value });
        return value;
      };
      Object.defineProperty(this, name, { get, configurable: true });
    }
  }
}

function decoded(messages, kind, part) {
  if (kind === "int") return typeof part === "number" ? [part] : [...integers(part)];
  if (kind === "text") return [new TextDecoder().decode(part)];
  return [kind in messages ? new Message(messages, kind, part) : part];
}
