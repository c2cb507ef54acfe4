/** The header of a PLY file, and the rows of its elements (Greg Turk, "The PLY Polygon File Format"). */

import { failing } from "./errors.js";

const MOST_HEADER_BYTES = 1 << 20;
const TEXT_BYTES = 1 << 18; // that are parsed at once
const END = /\nend_header[ \t]*\r?\n/;
const KINDS = {
  char: "Int8", uchar: "Uint8", short: "Int16", ushort: "Uint16", int: "Int32", uint: "Uint32",
  float: "Float32", double: "Float64",
};
const TYPES = { ...KINDS, ...Object.fromEntries(Object.values(KINDS).map((kind) => [kind.toLowerCase(), kind])) };

/**
 * @typedef {{name: string, type: string, size: number, countType: string}} Property
 * @typedef {{name: string, count: number, properties: Property[], rowBytes: number, hasLists: boolean}} Element
 * @typedef {{encoding: string, elements: Element[], isMip: boolean, up: number[] | null}} Header
 */

const sizeOf = (type) => Number(/\d+/.exec(type)) / 8;

/** Read the header of a PLY file; the source is then at its first row. @returns {Promise<Header>} */
export async function readHeader(source) {
  const fail = failing(source.name, "Write the file again.");
  let text = "";
  for (let size = 1 << 12; !END.test(text); size *= 4) {
    const head = await source.peek(Math.min(size, MOST_HEADER_BYTES));
    text = new TextDecoder("latin1").decode(head);
    if (head.length < size && !END.test(text)) fail(`has no end_header in its first ${head.length} bytes`);
  }
  const { index, 0: end } = /** @type {RegExpExecArray} */ (END.exec(text));
  await source.take(index + end.length);
  const header = /** @type {Header} */ ({ encoding: "", elements: [], isMip: false, up: null });
  const typeOf = (word) => TYPES[word] ?? fail(`has a property of the type ${word}`);
  for (const line of text.slice(0, index).split("\n").slice(1)) {
    const [word, ...words] = line.trim().split(/\s+/);
    const element = header.elements[header.elements.length - 1];
    if (word === "format") header.encoding = words[0];
    else if (word === "comment") noteComment(header, words.join(" "));
    else if (word === "element") {
      if (!/^\d{1,15}$/.test(words[1])) fail(`has an element ${words[0]} of ${words[1]} rows`);
      header.elements.push({ name: words[0], count: Number(words[1]), properties: [], rowBytes: 0, hasLists: false });
    } else if (word === "property" && element) {
      const isList = words[0] === "list";
      const type = typeOf(words[isList ? 2 : 0]);
      element.properties.push({ name: words[isList ? 3 : 1], type, size: sizeOf(type), countType: isList ? typeOf(words[1]) : "" });
      element.rowBytes += sizeOf(type);
      element.hasLists ||= isList;
    } else if (word && word !== "obj_info") fail(`has a header with the line "${line.trim()}"`);
  }
  if (!["ascii", "binary_little_endian", "binary_big_endian"].includes(header.encoding)) fail(`has the format "${header.encoding}"`);
  return header;
}

/** Keep what comments of Brush, Postshot and nerfstudio declare. */
function noteComment(header, text) {
  const mode = /^(?:SplatRenderMode:\s*(\S+)|antialiased\s+(\d+))$/i.exec(text);
  if (mode) header.isMip = ["mip", "1"].includes((mode[1] ?? mode[2]).toLowerCase());
  const axis = /^(?:vertical|up)[ _]axis\s*[:=]?\s*(.*)$/i.exec(text)?.[1].trim().toLowerCase();
  if (axis === undefined) return;
  const letter = /^[+-]?([xyz])$/.exec(axis)?.[1];
  const numbers = axis.replace(/^[[(\s]+|[\])\s]+$/g, "").split(/[\s,;]+/).map(Number);
  const length = Math.hypot(...numbers);
  // A bare y names the axis, not its sign: Brush writes it for −y, that of 3DGS.
  const sign = axis[0] === "-" || axis === "y" ? -1 : 1;
  if (letter) header.up = ["x", "y", "z"].map((name) => (name === letter ? sign : 0));
  else if (numbers.length === 3 && length > 0 && length < Infinity) header.up = numbers.map((x) => x / length);
}

/** Pass over the rows of an element. @param {import("./byte_source.js").ByteSource} source */
export async function skipElement(source, { encoding }, element) {
  if (encoding !== "ascii" && !element.hasLists) return source.skip(element.count * element.rowBytes);
  if (encoding === "ascii") {
    for await (const _ of textRows(source, element, 1 << 12)) continue;
    return;
  }
  const what = `element ${element.name}`;
  for (let row = 0; row < element.count; row++) {
    for (const { countType, size } of element.properties) {
      let length = 1;
      if (countType) {
        const { buffer } = await source.need(sizeOf(countType), what);
        length = new DataView(buffer)[`get${countType}`](0, encoding === "binary_little_endian");
      }
      await source.need(size * Math.max(length, 0), what);
    }
  }
}

/**
 * Yield tables of some columns of an element, row by row, as many rows at once as asked for.
 * @returns {AsyncGenerator<Float64Array | Float32Array>}
 */
export async function* columnsOf(source, { encoding }, element, names, batch) {
  const { properties, rowBytes, count } = element;
  const columns = names.map((name) => properties.findIndex((property) => property.name === name));
  const width = names.length;
  if (encoding === "ascii") {
    for await (const rows of textRows(source, element, batch)) {
      yield Float64Array.from(rows.flatMap((values) => columns.map((column) => values[column])));
    }
    return;
  }
  const isLittle = encoding === "binary_little_endian";
  const isFloats = isLittle && properties.every(({ type }) => type === "Float32");
  const offsets = columns.map((column) => properties.slice(0, column).reduce((sum, { size }) => sum + size, 0));
  const methods = columns.map((column) => `get${properties[column].type}`);
  for (let first = 0; first < count; first += batch) {
    const rows = Math.min(batch, count - first);
    const { buffer } = await source.need(rows * rowBytes, `element ${element.name}`);
    const table = isFloats ? new Float32Array(rows * width) : new Float64Array(rows * width);
    const [floats, view] = [isFloats ? new Float32Array(buffer) : null, new DataView(buffer)];
    for (let i = 0; i < width; i++) {
      for (let row = 0, place = offsets[i]; row < rows; row++, place += rowBytes) {
        table[row * width + i] = floats ? floats[place >> 2] : view[methods[i]](place, isLittle);
      }
    }
    yield table;
  }
}

/** Yield the numbers of the rows of a text file, which has a line for each. */
async function* textRows(source, { name, count, properties, hasLists }, batch) {
  const fail = failing(source.name, "Write or download the file again.");
  let [rest, read, rows] = ["", 0, /** @type {number[][]} */ ([])];
  while (read < count) {
    const bytes = await source.take(TEXT_BYTES);
    const lines = (rest + new TextDecoder("latin1").decode(bytes)).split("\n");
    rest = (bytes.length && lines.pop()) || "";
    if (!bytes.length && !lines.some(Boolean)) fail(`ends after ${read} of ${count} rows of the element ${name}`);
    let used = 0;
    for (; used < lines.length && read < count; used++) {
      const words = lines[used].trim().split(/\s+/);
      if (!words[0]) continue;
      const values = words.map(numberOf);
      const wrong = words.find((word, i) => Number.isNaN(values[i]) && !/^[+-]?nan$/i.test(word));
      if (wrong !== undefined) fail(`has "${wrong}" in row ${read} of the element ${name}, expected a number`);
      if (!hasLists && words.length !== properties.length) fail(`has ${words.length} values in row ${read}, expected ${properties.length}`);
      rows.push(values);
      read += 1;
      if (rows.length < batch && read < count) continue;
      yield rows;
      rows = [];
    }
    const left = [...lines.slice(used), rest].join("\n");
    if (read === count) source.unread(Uint8Array.from(left, (letter) => letter.charCodeAt(0)));
  }
}

function numberOf(word) {
  return /^[+-]?inf(inity)?$/i.test(word) ? (word[0] === "-" ? -Infinity : Infinity) : Number(word);
}
