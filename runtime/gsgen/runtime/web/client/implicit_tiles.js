/** Subtrees of implicit tilesets (3D Tiles 1.1), as the JSON of explicit tiles. */

import { failing } from "./errors.js";

const HEADER = 24; // bytes of a binary subtree before its JSON
const MAGIC = 0x74627573; // "subt"
const NUMBERS = { FLOAT32: Float32Array, FLOAT64: Float64Array, UINT32: Uint32Array };

/** Return where a subtree lies in its tree, and its address. */
function subtreeAt(tile, level, cell) {
  return { tile, level, cell, uri: filled(tile.implicitTiling.subtrees.uri, level, cell) };
}

/** Return the first subtree of a tile that declares implicit tiling; null of other tiles. */
export function firstSubtree(tile) {
  if (!tile.implicitTiling) return null;
  return subtreeAt(tile, 0, tile.implicitTiling.subdivisionScheme === "OCTREE" ? [0, 0, 0] : [0, 0]);
}

function filled(template, level, cell) {
  const names = ["x", "y", "z"].slice(0, cell.length);
  const text = template.replaceAll("{level}", level);
  return names.reduce((uri, name, axis) => uri.replaceAll(`{${name}}`, cell[axis]), text);
}

/** Return the part of a box, center and half axes, that a cell of a level is. */
function cellBox(box, level, cell) {
  const [center, ...axes] = [0, 3, 6, 9].map((first) => box.slice(first, first + 3));
  cell.forEach((number, axis) => {
    const middle = (2 * number + 1) / 2 ** level - 1;
    for (let i = 0; i < 3; i++) center[i] += middle * axes[axis][i];
    axes[axis] = axes[axis].map((part) => part / 2 ** level);
  });
  return [center, ...axes].flat();
}

/** Return the JSON of a subtree's root: explicit tiles, and one for each subtree below them. */
export function subtreeRoot(data, { tile, level: top, cell: corner }, schema, name, files = []) {
  const view = new DataView(data);
  const fail = failing(name, "Pages read binary subtrees: gsgen tiles build --implicit");
  if (data.byteLength < HEADER || view.getUint32(0, true) !== MAGIC) fail("is not a binary subtree");
  const end = HEADER + Number(view.getBigUint64(8, true));
  if (end + Number(view.getBigUint64(16, true)) !== data.byteLength) fail("is not whole");
  const json = JSON.parse(new TextDecoder().decode(data.slice(HEADER, end)));
  if (json.buffers?.some(({ uri }) => uri)) fail("has buffers in other files");
  const bytesOf = (index) => {
    const { byteOffset = 0, byteLength } = json.bufferViews[index];
    return data.slice(end + byteOffset, end + byteOffset + byteLength);
  };
  /** @type {(availability: any) => (index: number) => boolean} */
  const bitsOf = ({ constant, bitstream }) => {
    const bytes = bitstream === undefined ? null : new Uint8Array(bytesOf(bitstream));
    return (index) => Boolean(bytes ? (bytes[index >> 3] >> (index & 7)) & 1 : constant);
  };
  const branching = 2 ** corner.length;
  const count = (branching ** tile.implicitTiling.subtreeLevels - 1) / (branching - 1);
  const [isTile, isSubtree] = [json.tileAvailability, json.childSubtreeAvailability].map(bitsOf);
  const contents = (json.contentAvailability ?? []).map(bitsOf);
  const rows = new Map([...Array(count).keys()].filter(isTile).map((index, row) => [index, row]));
  const table = json.propertyTables?.[json.tileMetadata];
  /** @type {Record<string, any>} */
  const columns = {};
  /** Return the values of a tile in a column of as many numbers for each. */
  const rowOf = (key, index) => {
    const width = (columns[key]?.length ?? 0) / table?.count;
    return width ? [...columns[key].subarray(rows.get(index) * width, (rows.get(index) + 1) * width)] : [];
  };
  for (const [key, { semantic = key, componentType }] of Object.entries(schema?.classes?.[table?.class]?.properties ?? {})) {
    const { values } = table.properties?.[key] ?? {};
    if (values !== undefined && NUMBERS[componentType]) columns[semantic] = new NUMBERS[componentType](bytesOf(values));
  }
  const templates = (tile.contents ?? [tile.content ?? []]).flatMap(({ uri = [] }) => uri);
  const tileAt = (index, level, cell) => {
    const declared = rowOf("TILE_BOUNDING_BOX", index);
    const box = declared.length ? declared : cellBox(tile.boundingVolume.box, level, cell);
    const geometricError = columns.TILE_GEOMETRIC_ERROR?.[rows.get(index)] ?? tile.geometricError / 2 ** level;
    const own = { boundingVolume: { box }, geometricError, refine: tile.refine };
    const children = Array.from({ length: branching }, (_, k) => {
      const below = cell.map((number, axis) => 2 * number + ((k >> axis) & 1));
      const child = branching * index + 1 + k;
      if (child < count) return isTile(child) ? tileAt(child, level + 1, below) : [];
      return isSubtree(child - count) ? { ...own, subtree: subtreeAt(tile, level + 1, below) } : [];
    }).flat();
    const uris = templates.filter((_, i) => contents[i]?.(index));
    const [[splats], bytes, worth] = ["splats", "bytes", "worth"].map((key) => rowOf(key, index));
    const properties = { splats, bytes, worth, files: files.map((uri) => filled(uri, level, cell)) };
    return { ...own, metadata: { properties }, children, contents: uris.map((uri) => ({ uri: filled(uri, level, cell) })) };
  };
  return tileAt(0, top, corner);
}
