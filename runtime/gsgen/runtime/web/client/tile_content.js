/** Reads the content of tiles: splats in glTF files (.glb) by KHR_gaussian_splatting, as SPZ. */

import { failing } from "./errors.js";
import { composed, transposed4 } from "./matrices.js";
import { readSplats } from "./splat_files.js";

const MAGIC = 0x46546c67; // "glTF"
const HEADER = 20; // bytes before the JSON: that of the file, and that of its first chunk
const CHUNK_HEADER = 8;
const SPLATS = "KHR_gaussian_splatting";
// A viewer turns glTF content about x: (x, y, z) of the content is (x, −z, y) of the tile.
const TILE_FROM_CONTENT = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1];

/**
 * Return the splats of each primitive; their transforms lead to the axes of the tile.
 * @param {string} name Address of the file, for messages.
 * @returns {Promise<import("./splat_buffers.js").Splats[]>}
 */
export async function readTileContent(data, name) {
  const view = new DataView(data);
  const fail = failing(name);
  if (data.byteLength < HEADER || view.getUint32(0, true) !== MAGIC) {
    fail("is not a .glb file", "Pages draw tiles of glTF splats: gsgen tiles build.");
  }
  const [bytes, jsonBytes] = [view.getUint32(8, true), view.getUint32(12, true)];
  if (bytes !== data.byteLength || HEADER + jsonBytes > bytes) {
    fail(`has ${data.byteLength} bytes, expected ${bytes}`, "Download it again.");
  }
  const { nodes, meshes, bufferViews, scenes, scene = 0 } = JSON.parse(
    new TextDecoder().decode(new Uint8Array(data, HEADER, jsonBytes)),
  );
  const first = HEADER + jsonBytes + CHUNK_HEADER;
  const found = [];
  const visit = async (index, parent) => {
    const { matrix, mesh, children = [], translation, rotation, scale } = nodes[index];
    if (translation ?? rotation ?? scale) fail("has a node without matrix", "gsgen tiles build");
    const transform = matrix ? composed(parent, transposed4(matrix)) : parent;
    for (const { extensions } of meshes[mesh]?.primitives ?? []) {
      const packed = Object.entries(extensions?.[SPLATS]?.extensions ?? {});
      const spz = packed.find(([extension]) => extension.includes("compression_spz"));
      if (!spz) fail("has a primitive that is not SPZ splats", "gsgen tiles build --codec spz");
      const { byteOffset = 0, byteLength } = bufferViews[spz[1].bufferView];
      const part = data.slice(first + byteOffset, first + byteOffset + byteLength);
      found.push({ ...(await readSplats(part, name)), transform });
    }
    for (const child of children) await visit(child, transform);
  };
  for (const root of scenes[scene].nodes) await visit(root, TILE_FROM_CONTENT);
  return found;
}
