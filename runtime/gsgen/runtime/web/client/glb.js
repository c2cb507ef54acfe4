/** Reads splats in glTF files by KHR_gaussian_splatting: attributes, or SPZ in a buffer view. */

import { failing } from "./errors.js";
import { composed, determinant, linearPart, rotationOf, transposed4 } from "./matrices.js";
import { MOST_COEFFICIENTS, RowWriter, SH_C0, logit, setUnit, turn } from "./row_writer.js";
import { unpackedSpz, writeSpz } from "./spz.js";

const MAGIC = 0x46546c67; // "glTF"
const JSON_CHUNK = 0x4e4f534a;
const HEADER = 20; // bytes before the JSON: that of the file, and that of its first chunk
const CHUNK_HEADER = 8;
const SPLATS = "KHR_gaussian_splatting";
const PACKED = [`${SPLATS}_compression_spz_2`, `${SPLATS}_compression_spz`, "KHR_spz_gaussian_splats_compression"];
const KNOWN = [
  SPLATS, ...PACKED, "KHR_mesh_quantization", "KHR_lights_punctual", "KHR_xmp_json_ld",
  "EXT_structural_metadata", "EXT_mesh_features",
];
const FROM_CONTENT = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]; // left, up, forward → right, down, forward
const SPACES = { srgb_rec709_display: false, lin_rec709_display: true };
const COMPONENTS = {
  5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array,
};
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };

const { fround } = Math;

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readGlb(source, { sink }, transform = FROM_CONTENT) {
  const { name } = source;
  const fail = failing(name, "Download it again.");
  const data = await source.rest();
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  if (data.length < HEADER || view.getUint32(0, true) !== MAGIC) fail("is not a .glb file");
  const [version, length, jsonBytes, kind] = [4, 8, 12, 16].map((offset) => view.getUint32(offset, true));
  if (version !== 2) fail(`has version ${version} of glTF, expected 2`, "Export it as glTF 2.0.");
  const first = HEADER + jsonBytes + CHUNK_HEADER;
  if (data.length < length || HEADER + jsonBytes > length || kind !== JSON_CHUNK) fail(`has ${data.length} bytes, expected ${length}`);
  const size = first <= length ? view.getUint32(HEADER + jsonBytes, true) : 0;
  if (size && first + size > length) fail(`has ${data.length} bytes, expected ${first + size}`);
  const document = parsed(data.subarray(HEADER, HEADER + jsonBytes), fail);
  await writeScene(document, [data.subarray(first, first + size)], name, sink, transform);
}

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readGltf(source, { sink, beside }) {
  const { name } = source;
  const fail = failing(name, "Pack all buffers into one .glb file.");
  const document = parsed(await source.rest(), fail);
  const buffers = [];
  for (const { uri, byteLength } of document.buffers ?? []) {
    if (typeof uri !== "string") fail("has a buffer without an address");
    const inlined = /^data:[^,]*;base64,/.exec(uri);
    const bytes = inlined
      ? Uint8Array.from(atob(uri.slice(inlined[0].length)), (letter) => letter.charCodeAt(0))
      : await beside(decodeURIComponent(uri));
    if (bytes.length < byteLength) fail(`has a buffer of ${bytes.length} bytes, expected ${byteLength}`);
    buffers.push(bytes);
  }
  await writeScene(document, buffers, name, sink, FROM_CONTENT);
}

function parsed(bytes, fail) {
  try {
    return JSON.parse(new TextDecoder().decode(bytes));
  } catch (error) {
    return fail(`has invalid JSON: ${error.message}`);
  }
}

async function writeScene(document, buffers, name, sink, transform) {
  const fail = failing(name, "Write it again: gsgen convert FILE model.glb");
  const { nodes = [], meshes = [], scenes, scene = 0, extensionsRequired = [] } = document;
  const unknown = extensionsRequired.filter((extension) => !KNOWN.includes(extension) && !extension.startsWith("KHR_materials_"));
  if (unknown.length) fail(`needs ${unknown.join(", ")}, which pages do not read`, "Export the file without this extension.");
  const inner = new Set(nodes.flatMap(({ children = [] }) => children));
  const roots = scenes ? (scenes[scene]?.nodes ?? []) : nodes.keys().filter((node) => !inner.has(node)).toArray();
  const seen = new Set();
  let found = 0;
  const visit = async (index, parent) => {
    const node = nodes[index] ?? fail(`has no node ${index}`);
    if (seen.has(index)) fail(`has the node ${index} twice`);
    seen.add(index);
    const own = localMatrix(node, fail);
    const matrix = composed(parent, own);
    for (const primitive of node.mesh === undefined ? [] : (meshes[node.mesh]?.primitives ?? fail(`has no mesh ${node.mesh}`))) {
      if (!isOfSplats(primitive)) continue;
      found += 1;
      await writePrimitive(document, buffers, primitive, name, sink, matrix, fail);
    }
    for (const child of node.children ?? []) await visit(child, matrix);
  };
  for (const root of roots) await visit(root, transform);
  if (!found) fail(`holds no splats, expected a mesh of points with ${SPLATS}`, "A mesh: `gsgen render` draws it.");
}

function isOfSplats({ extensions = {}, attributes = {} }) {
  return [SPLATS, ...PACKED].some((key) => key in extensions) || ("_ROTATION" in attributes && "_SCALE" in attributes);
}

/** Return the matrix of a node, row by row. */
function localMatrix({ matrix, translation = [0, 0, 0], rotation = [0, 0, 0, 1], scale = [1, 1, 1] }, fail) {
  const [x, y, z, w] = rotation.map((part) => part / (Math.hypot(...rotation) || 1));
  const turned = rotationOf([w, x, y, z]);
  const rows = [0, 3, 6].flatMap((first, i) => [...scale.map((size, j) => size * turned[first + j]), translation[i]]);
  const result = matrix ? transposed4(matrix) : [...rows, 0, 0, 0, 1];
  if (!(determinant(linearPart(result)) > 0)) fail("has a node that mirrors or flattens, expected a scale above 0 along every axis");
  return result;
}

async function writePrimitive(document, buffers, primitive, name, sink, transform, fail) {
  const { extensions = {}, attributes = {}, mode = 4 } = primitive;
  if (mode !== 0) fail(`has splats in the mode ${mode}, expected 0, points`);
  const own = extensions[SPLATS] ?? {};
  const { kernel = "ellipse", colorSpace } = own;
  if (kernel !== "ellipse") fail(`has the kernel ${kernel}, expected ellipse`);
  const isDraft = !(SPLATS in extensions) || "extensions" in own || "_ROTATION" in attributes;
  if (!(colorSpace in SPACES) && !(colorSpace === undefined && isDraft)) {
    fail(`has the colour space ${colorSpace}, expected ${Object.keys(SPACES).join(" or ")}`);
  }
  const isLinear = SPACES[colorSpace] ?? false;
  const packed = { ...extensions, ...own.extensions };
  const spz = PACKED.find((key) => key in packed);
  if (spz) {
    const frame = await unpackedSpz(viewOf(document, buffers, packed[spz].bufferView, fail), name);
    const [x, y, z] = frame.signs;
    // Axes that the file declares lead to those of glTF; without them it has the axes of glTF.
    const isDeclared = frame.signs.join() !== "1,-1,-1";
    const turned = isDeclared ? composed(transform, [-x, 0, 0, 0, 0, -y, 0, 0, 0, 0, z, 0, 0, 0, 0, 1]) : transform;
    return writeSpz(frame, sink, name, turned, isLinear);
  }
  await writeAttributes(document, buffers, attributes, name, sink, transform, isLinear, fail);
}

/** Return the bytes of a buffer view. @returns {Uint8Array} */
function viewOf({ bufferViews = [] }, buffers, index, fail) {
  const { buffer = 0, byteOffset = 0, byteLength } = bufferViews[index] ?? fail(`has no buffer view ${index}`);
  const bytes = buffers[buffer];
  if (!bytes || byteOffset + byteLength > bytes.length) fail(`has a buffer view that ends at byte ${byteOffset + byteLength} of ${bytes?.length ?? 0}`);
  return bytes.subarray(byteOffset, byteOffset + byteLength);
}

/** Return the numbers of an accessor, one after the other; normalised integers become fractions of 1. */
function numbersOf(document, buffers, index, widths, fail) {
  const accessor = document.accessors?.[index] ?? fail(`has no accessor ${index}`);
  const { componentType, type, count, byteOffset = 0, normalized = false } = accessor;
  if (accessor.sparse || accessor.bufferView === undefined) fail("has a sparse accessor, expected one with all values");
  const Numbers = COMPONENTS[componentType] ?? fail(`has an accessor of the type ${componentType}`);
  const width = WIDTHS[type];
  if (!widths.includes(width)) fail(`has an accessor of ${type}, expected ${widths} components`);
  const bytes = viewOf(document, buffers, accessor.bufferView, fail);
  const size = Numbers.BYTES_PER_ELEMENT;
  const stride = document.bufferViews[accessor.bufferView].byteStride ?? size * width;
  if (count && byteOffset + stride * (count - 1) + size * width > bytes.length) fail(`has an accessor of ${count} values, more than its buffer view`);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  const method = `get${Numbers.name.slice(0, -5)}`; // such as getUint8
  const most = normalized && componentType !== 5126 ? 2 ** (8 * size - (Numbers.name[0] === "I" ? 1 : 0)) - 1 : 1;
  const numbers = new Float32Array(count * width);
  for (let row = 0; row < count; row++) {
    for (let i = 0; i < width; i++) {
      const value = view[method](byteOffset + row * stride + i * size, true);
      numbers[row * width + i] = most === 1 ? value : Math.max(value / most, -1);
    }
  }
  return numbers;
}

async function writeAttributes(document, buffers, attributes, name, sink, transform, isLinear, fail) {
  let count = -1;
  const read = (names, widths) => {
    const found = names.find((key) => key in attributes) ?? fail(`lacks the attribute ${names[0]}`);
    const numbers = numbersOf(document, buffers, attributes[found], widths, fail);
    if (count >= 0 && numbers.length !== count * widths[0]) fail(`has ${numbers.length / widths[0]} values of ${found}, expected ${count}`);
    count = numbers.length / widths[0];
    return numbers;
  };
  const position = read(["POSITION"], [3]);
  if (!count) fail("has 0 splats");
  const turns = read([`${SPLATS}:ROTATION`, "_ROTATION"], [4]);
  const scale = read([`${SPLATS}:SCALE`, "_SCALE"], [3]);
  const color = `${SPLATS}:OPACITY` in attributes ? null : read(["COLOR_0"], [4]);
  const opacity = color ? null : read([`${SPLATS}:OPACITY`], [1]);
  const bands = Object.keys(attributes).map((key) => /:SH_DEGREE_(\d)_COEF_(\d)$/.exec(key)?.[1]);
  const degree = color ? 0 : Math.max(0, ...bands.filter((band) => band !== undefined).map(Number));
  if (degree > 4) fail(`has SH of degree ${degree}, expected 0 to 4`);
  const names = Array.from({ length: degree + 1 }, (_, band) => {
    return Array.from({ length: 2 * band + 1 }, (_, n) => `${SPLATS}:SH_DEGREE_${band}_COEF_${n}`);
  }).flat();
  const harmonics = color ? [] : names.map((key) => read([key], [3])).slice(0, MOST_COEFFICIENTS);
  const writer = new RowWriter(sink, name, { count, coefficients: names.length, isLinear, transform });
  for await (const [first, rows] of writer.batches()) {
    for (let row = first; row < first + rows; row++) {
      const [i, q] = [3 * row, 4 * row];
      const alpha = color ? color[q + 3] : opacity?.[row] ?? 0;
      if (!(scale[i] >= 0 && scale[i + 1] >= 0 && scale[i + 2] >= 0)) fail(`has a scale below 0 in row ${row}`);
      if (!(alpha >= 0 && alpha <= 1)) fail(`has the opacity ${alpha} in row ${row}, expected 0 to 1`);
      setUnit(turns[q + 3], turns[q], turns[q + 1], turns[q + 2], 0);
      let base = writer.place(
        position[i], position[i + 1], position[i + 2], turn[0], turn[1], turn[2], turn[3],
        Math.log(scale[i]), Math.log(scale[i + 1]), Math.log(scale[i + 2]), logit(alpha),
      );
      for (let c = 0; color && c < 3; c++) writer.appearance[base + c] = fround(color[q + c] - 0.5) / fround(SH_C0);
      for (const coefficient of harmonics) {
        for (let c = 0; c < 3; c++) writer.appearance[base++] = coefficient[i + c];
      }
      writer.keep();
    }
  }
  writer.end();
}
