/** Streamed SOG (`lod-meta.json` of PlayCanvas) as the JSON of a tileset: `gsgen.tiles.loading.streamed_sog`. */

import { download, parsedJson } from "./download.js";
import { failing } from "./errors.js";
import { IDENTITY } from "./matrices.js";

const Z_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]; // column by column, from y down
const BYTES_PER_SPLAT = 14; // of degree 0: a file does not say how much of it a leaf takes
const MOST_DEGREE = 3;

const boxOf = (low, high) => {
  const [x, y, z] = low.map((side, axis) => (high[axis] - side) / 2);
  return [...low.map((side, axis) => (side + high[axis]) / 2), x, 0, 0, 0, y, 0, 0, 0, z];
};

/** Return the tileset of a `lod-meta.json`: below its root, each leaf is a chain of its levels, the finest last. */
export async function tilesetOf({ filenames, tree, environment }, address) {
  const fail = failing(address, "Download it again.");
  if (!Array.isArray(filenames)) fail("has no list of filenames");
  const leavesOf = (node) => (node?.children?.length ? node.children.flatMap(leavesOf) : [node]);
  const leaves = leavesOf(tree);
  const levelsOf = (leaf) => Object.keys(leaf?.lods ?? {}).filter((key) => /^\d+$/.test(key) && leaf.lods[key]?.count !== 0).map(Number).sort((a, b) => a - b);
  const coarsest = leaves.flatMap(levelsOf).reduce((most, level) => Math.max(most, level), 0);
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  const children = leaves.map((leaf) => {
    const { min, max } = leaf?.bound ?? {};
    if (![min, max].every((corner) => corner?.length === 3 && corner.every(Number.isFinite))) fail("has a leaf without a box");
    [0, 1, 2].forEach((axis) => ([low[axis], high[axis]] = [Math.min(low[axis], min[axis]), Math.max(high[axis], max[axis])]));
    const box = boxOf(min, max);
    let tile;
    for (const level of levelsOf(leaf)) {
      const { file, offset, count } = leaf.lods[level] ?? {};
      // Errors are squared differences of pictures; those of cells on a surface are the default.
      const share = leaf.errors?.[level] ?? 16 / count;
      if (![file, offset, count].every((x) => Number.isInteger(x) && x >= 0) || file >= filenames.length || !(share >= 0)) fail(`has a leaf with the levels ${JSON.stringify(leaf.lods)} and errors ${leaf.errors}`);
      const geometricError = tile ? Math.max(tile.geometricError, 2 * Math.hypot(...box.slice(3)) * Math.sqrt(share)) : 0;
      const metadata = { properties: { splats: count, bytes: [BYTES_PER_SPLAT * count] } };
      const own = { content: { uri: filenames[file] }, rows: [offset, count], level: 1 + coarsest - level };
      tile = { ...own, boundingVolume: { box }, geometricError, refine: "REPLACE", metadata, children: tile ? [tile] : [] };
    }
    return tile ?? fail(`has a leaf with the levels ${JSON.stringify(leaf?.lods)}`);
  });
  const box = boxOf(low, high);
  const root = { content: environment ? { uri: environment } : undefined, boundingVolume: { box }, geometricError: 2 * Math.hypot(...box.slice(3)), refine: "ADD", transform: Z_UP, children };
  const isMeta = filenames[0].endsWith("meta.json");
  const first = isMeta ? parsedJson(await download(String(new URL(filenames[0], address)))) : { shN: {} };
  const degree = first?.shN ? (first.shN.bands ?? MOST_DEGREE) : 0;
  return { root, metadata: { properties: { sh_degree: degree, axes: IDENTITY } } };
}
