/** Opens files that a page shows: tells what they are, unpacks archives, and reads splats. */

import { ByteSource } from "./byte_source.js";
import { openSource } from "./download.js";
import { failing } from "./errors.js";
import { RECOGNITION_BYTES, archiveKind, contentKind } from "./file_kinds.js";
import { extentOf } from "./framing.js";
import { looksLikeKsplat } from "./ksplat.js";
import { looksLikeSplat } from "./splat_rows.js";

const READABLE = "Pages read .ply, .spz, .splat, .ksplat, .sog, .glb and .gltf of splats, lod-meta.json, tileset.json and .onnx.";
const SCENE_KEY = /"(models|meshes)"\s*:/;
const MOST_NESTED = 2; // archives within each other
const SUFFIXES = /\.(ply|spz|splat|ksplat|sog|glb|gltf)(\.gz)?$/i;

/**
 * What readers of formats get beside the bytes.
 * @typedef {object} Context
 * @property {import("./row_writer.js").Sink} sink Takes the rows.
 * @property {(file: string) => Promise<Uint8Array>} beside Returns the bytes of a file in the same folder.
 * @property {[number, number]} [range] Of a SOG, which row comes first, and how many do.
 */

/** Readers by the kinds of `contract/file_kinds`. @type {Record<string, (source: ByteSource, context: Context) => Promise<void>>} */
const READERS = {
  ply: async (source, context) => (await import("./ply.js")).readPly(source, context),
  spz: async (source, context) => (await import("./spz.js")).readSpz(source, context),
  glb: async (source, context) => (await import("./glb.js")).readGlb(source, context),
  gltf: async (source, context) => (await import("./glb.js")).readGltf(source, context),
  sog: async (source, context) => (await import("./sog.js")).readSogMeta(source, context),
  ksplat: async (source, context) => (await import("./ksplat.js")).readKsplat(source, context),
  splat: async (source, context) => (await import("./splat_rows.js")).readSplat(source, context),
};
const READER_OF_KIND = {
  "ply-splats": "ply", "compressed-ply": "ply", "ply-points": "ply", spz: "spz", glb: "glb", "glb-splats": "glb",
  "gltf-splats": "gltf", sog: "sog",
};

/**
 * What is to be read: an address, or bytes; `name` is for messages.
 * @typedef {{name: string, address?: string, bytes?: ArrayBuffer | Uint8Array, cache?: RequestCache, target?: string,
 *     range?: [number, number], rows?: Float32Array, count?: number}} Request
 *     Of generators, `target` is whose limits and quirks rules check. Of rows, the extent is told.
 */
/**
 * What a file is; the bytes of what are no splats, and what rules say of a generator.
 * @typedef {object} FileContent
 * @property {"splats" | "onnx" | "tileset" | "scene" | "rows"} kind
 * @property {Uint8Array} [bytes]
 * @property {import("./findings.js").Inspected} [inspected]
 * @property {import("./framing.js").Extent} [extent]
 */

/**
 * Read a file; its splats go to the sink, other files that pages know are returned.
 * @param {Request} request
 * @param {import("./row_writer.js").Sink} sink
 * @param {(loaded: number, total: number) => void} [onProgress]
 * @param {AbortSignal} [signal]
 * @returns {Promise<FileContent>}
 */
export async function readRequest({ name, address, bytes, cache, target, range, rows, count = 0 }, sink, onProgress, signal) {
  if (rows) return { kind: "rows", extent: extentOf({ rows, count }) };
  const source = bytes ? ByteSource.of(bytes, name) : await openSource(address, name, onProgress, signal, cache);
  const beside = async (file) => {
    const folder = new URL(".", /^https?:|^file:/.test(address ?? "") ? address : "none:/");
    const place = new URL(file, folder);
    const isInside = folder.protocol !== "none:" && String(place).startsWith(String(folder));
    if (!isInside) failing(name, "Pack the folder into a ZIP archive, or show it by its address.")(`refers to the file ${file}, which is not beside it`);
    // Others may wait for a file of which a part is read.
    return (await openSource(String(place), file, undefined, range ? undefined : signal)).rest();
  };
  const content = await readFile(source, { sink, beside, range });
  if (content.kind !== "onnx" || !content.bytes) return content;
  const { inspectedModel } = await import("./findings.js");
  return { ...content, inspected: inspectedModel(content.bytes, name, target) };
}

/** Return the first bytes of a file as a text with a character for each, as `file_kinds.js` reads them. */
export function textOf(head) {
  let text = "";
  for (let i = 0; i < head.length; i += 4096) text += String.fromCharCode(...head.subarray(i, i + 4096));
  return text;
}

/** Return what kind of file begins so, and which reader it has. */
function recognised(head, size) {
  const kind = contentKind(textOf(head));
  const marked = READER_OF_KIND[kind?.name];
  // Formats without a mark are told by their first rows, as Python tells them.
  const unmarked = looksLikeKsplat(head, size) ? "ksplat" : looksLikeSplat(head, size) ? "splat" : undefined;
  return { kind, reader: marked ?? (kind && head[0] === 0x7b ? undefined : unmarked) };
}

/** @returns {Promise<FileContent>} */
async function readFile(source, context) {
  for (let depth = 0; ; depth++) {
    const { name } = source;
    const head = await source.peek(RECOGNITION_BYTES);
    const [first, second] = head;
    if (first === 0x1f && second === 0x8b && depth < MOST_NESTED) {
      source = source.unpacked("gzip");
      continue;
    }
    if (first === 0x50 && second === 0x4b && head[2] === 3) {
      const { filesOfZip } = await import("./zip.js");
      const files = filesOfZip(await source.rest(), name);
      const kind = archiveKind([...files.keys()]);
      if (kind.name === "sog") {
        await (await import("./sog.js")).readSog(files, name, context);
        return { kind: "splats" };
      }
      source = await fileOfZip(files, kind, name, depth);
      continue;
    }
    const { kind, reader } = recognised(head, source.size);
    if (reader) {
      await READERS[reader](source, context);
      return { kind: "splats" };
    }
    if (kind?.name === "onnx" || (!kind && /\.onnx$/i.test(name))) return { kind: "onnx", bytes: await source.rest() };
    if (kind?.name === "tileset" || kind?.name === "streamed-sog") return { kind: "tileset", bytes: await source.rest() };
    const isScene = kind?.name === "scene" || (kind?.name === "json" && SCENE_KEY.test(textOf(head)));
    if (isScene) return { kind: "scene", bytes: await source.rest() };
    const problem = kind ? `is ${kind.title}` : `begins with ${[...head.subarray(0, 5)].map((byte) => byte.toString(16).padStart(2, "0")).join(" ")}, as no file of splats does`;
    return failing(name, kind?.hint || READABLE)(`${problem}; expected splats or a generator`);
  }
}

/** Return the one file of an archive that can be read. */
async function fileOfZip(files, kind, name, depth) {
  const readable = [];
  for (const [file, { size, open }] of depth < MOST_NESTED ? files : []) {
    const isHidden = file.split("/").some((part) => part.startsWith(".") || part === "__MACOSX");
    if (isHidden || file.endsWith("/") || !size) continue;
    const found = recognised(await open().peek(RECOGNITION_BYTES), size);
    const isPacked = !found.kind || ["zip", "gzip"].includes(found.kind.name);
    if (found.reader || (isPacked && SUFFIXES.test(file))) readable.push({ file, open });
  }
  const names = readable.slice(0, 4).map(({ file }) => file).join(", ");
  if (readable.length > 1) failing(name, "Unpack it, and name one of them.")(`holds ${readable.length} files of splats: ${names}`);
  if (!readable.length) failing(name, kind.hint || READABLE)(`is ${kind.title}; expected a file of splats in it`);
  return readable[0].open();
}
