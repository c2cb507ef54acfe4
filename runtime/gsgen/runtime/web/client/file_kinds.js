// Written by `make web` from Python functions of the contract; do not edit.
// @ts-nocheck

import * as py from "./python.js";

class FileKind$kind extends py.Record {
static fields = [["name", null, null], ["title", null, null], ["hint", null, () => ""]];
}
function content_kind$recognition(head) {
  let hint, kind, text;
if (!py.bool(head)) {
hint = "Write or download it again: the program that wrote it may have failed.";
return new FileKind$kind("empty", "an empty file (0 bytes)", hint);
}
if (py.bool(py.startsWith(head, ["ply\n", "ply\r"]))) {
return ply_kind$text_kinds(head);
}
if (py.bool(py.startsWith(head, "glTF"))) {
return _glb_kind$recognition(head);
}
kind = kind_by_signature$signatures(head);
if ((kind != null)) {
return kind;
}
text = decoded_text$text_kinds(head);
if ((text != null)) {
return text_kind$text_kinds(text);
}
if ((py.eq(py.count(head, "\u0000"), py.len(head)))) {
return new FileKind$kind("zeros", "a file that begins with zeros only", "Copy or download the file again.");
}
return null;
}
function ply_kind$text_kinds(head) {
  let counts, header, hint;
header = py.item(py.partition(head, "end_header"), 0);
counts = py.dict((function* () { for (const match of py.iter(header.matchAll(new RegExp(_PLY_ELEMENT$0, `g${_PLY_ELEMENT$0.flags}`)))) yield [py.item(match, 1), py.int(py.item(match, 2))]; })());
if ((py.contains(header, "property uint packed_position"))) {
return new FileKind$kind("compressed-ply", "a compressed PLY of splats", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it.");
}
if (((py.contains(header, "f_offset_0")) || (py.contains(header, "anchor")))) {
hint = "`gsgen plugins` lists the methods whose checkpoints are exported.";
return new FileKind$kind("ply-anchors", "a PLY of anchors, not splats", hint);
}
if (py.bool(_PLY_SPLATS$1.exec(header))) {
return new FileKind$kind("ply-splats", "a PLY of splats", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it.");
}
if ((py.bool(py.get(counts, "face", 0)) || py.bool(py.get(counts, "tristrips", 0)))) {
return new FileKind$kind("ply-mesh", "a PLY mesh", "A mesh: `gsgen render` draws it.");
}
if ((py.contains(counts, "vertex"))) {
hint = "Points with colours: `gsgen export static` makes splats of them.";
return new FileKind$kind("ply-points", "a PLY point cloud", hint);
}
return new FileKind$kind("ply", "a PLY file without vertices", "Copy or download the file again.");
}
function _glb_kind$recognition(head) {
if ((py.eq(py.slice(head, 4, 8), "\u0001\u0000\u0000\u0000"))) {
return new FileKind$kind("glb", "a GLB file of version 1", "Export splats as PLY, or a mesh as GLB, with the program that wrote it.");
}
if (((py.contains(head, "KHR_gaussian_splatting")) || (py.contains(head, "\"_ROTATION\"")))) {
return new FileKind$kind("glb-splats", "a GLB file of splats", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it.");
}
return new FileKind$kind("glb", "a GLB file without splats", "A mesh: `gsgen render` draws it.");
}
function kind_by_signature$signatures(head) {
  let hint, is_model_version, name, offset, signature, title;
for ([offset, signature, name, title, hint] of py.iter(_FILE_SIGNATURES$2)) {
if ((py.eq(py.slice(head, offset, (py.plus(offset, py.len(signature)))), signature))) {
return new FileKind$kind(name, title, hint);
}
}
if (((py.eq(py.slice(head, 8, 9), "{")) && (py.compare(0, py.fromBytes(py.slice(head, null, 8), "little")) < 0 && py.compare(py.fromBytes(py.slice(head, null, 8), "little"), (10 ** 8)) < 0))) {
return new FileKind$kind("safetensors", "a file of weights (safetensors)", "Save the tensors as a 3DGS PLY, or in a checkpoint of gsplat.");
}
is_model_version = py.and((py.eq(py.slice(head, null, 1), "\b")), () => (py.compare("\u0000", py.slice(head, 1, 2)) < 0 && py.compare(py.slice(head, 1, 2), "@") < 0));
if (((py.compare(py.len(head), 3) > 0) && py.bool(is_model_version) && (py.contains("\u0012\u001a\"*2:Br", py.slice(head, 2, 3))))) {
return new FileKind$kind("onnx", "an ONNX model", "With the suffix .onnx, `gsgen render` draws it, `gsgen bake` writes its splats, and `gsgen validate` checks it.");
}
return null;
}
function decoded_text$text_kinds(head) {
  let text;
text = py.decoded(head);
return (py.bool(_is_readable$text_kinds(text)) ? text : null);
}
function _is_readable$text_kinds(text) {
  let begin, readable_count;
if ((!py.bool(text) || (py.contains(text, "\u0000")))) {
return false;
}
begin = py.slice(text, null, 1024);
readable_count = py.list((function* () { for (const char of py.iter(begin)) if ((py.bool(!/[\p{C}\p{Zl}\p{Zp}]|(?! )\p{Zs}/u.test(char)) || (py.contains("\t\r\n\f", char)))) yield 1; })()).reduce(py.plus, 0);
return py.and((py.eq(readable_count, py.len(py.list(begin)))), () => (py.compare((py.count(text, "�") * 20), py.len(text)) <= 0));
}
function text_kind$text_kinds(text) {
  let first_line, hint, lines, low, shortened_line, start, whole_lines;
start = text.trimStart();
low = py.slice(start, null, 4096).toLowerCase();
if (py.bool(py.startsWith(low, ["version https://git-lfs", "version https://hawser"]))) {
return new FileKind$kind("git-lfs", "a git LFS pointer", "The file itself is not here: fetch it with `git lfs pull`.");
}
if (py.bool(py.startsWith(low, "<"))) {
return _markup_kind$text_kinds(start, low);
}
if (py.bool(py.startsWith(start, ["{", "["]))) {
return json_kind$text_kinds(start);
}
if (py.bool(py.startsWith(start, "Namespace("))) {
return new FileKind$kind("cfg-args", "the options of a 3DGS training (cfg_args)", "Name its folder: `gsgen render FOLDER -o picture.png`.");
}
if (py.bool(py.startsWith(low, ["# camera list with", "# image list with", "# 3d point list with"]))) {
return new FileKind$kind("colmap", "a text file of COLMAP", "Cameras: give it to `gsgen render --camera`, beside the scene.");
}
if (py.bool(py.startsWith(low, "; fbx"))) {
return new FileKind$kind("fbx", "an FBX file (text)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it.");
}
if ((py.bool(py.startsWith(low, "solid ")) && (py.contains(low, "facet")))) {
return new FileKind$kind("stl", "an STL mesh (text)", "A mesh: `gsgen render` draws it.");
}
if (py.bool(py.startsWith(low, ["# .pcd", "version .7", "version 0.7"]))) {
hint = "A point cloud: convert it to a PLY with x, y, z and colours.";
return new FileKind$kind("pcd", "a point cloud in PCD", hint);
}
lines = [...(function* () { for (const line of py.iter(py.slice(start.split(/\r\n|[\n\v\f\r\x1c-\x1e\x85\u2028\u2029]/), null, 200))) if ((py.bool(line) && !py.bool(py.startsWith(line, "#")))) yield line; })()];
whole_lines = py.or(py.slice(lines, null, (-1)), () => lines);
if ((py.bool(lines) && py.list((function* () { for (const line of py.iter(whole_lines)) yield _OBJ_LINE$10.exec(line); })()).every(py.bool))) {
return new FileKind$kind("obj", "an OBJ mesh", "A mesh: `gsgen render` draws it.");
}
if ((py.bool(lines) && py.list((function* () { for (const line of py.iter(whole_lines)) yield new RegExp(`^(?:${_NUMBER_ROW_PATTERN$11.source})$`, _NUMBER_ROW_PATTERN$11.flags).exec(line.trim()); })()).every(py.bool))) {
hint = "Write points as a PLY with x, y, z and colours.";
return new FileKind$kind("numbers", "a table of numbers as text", hint);
}
first_line = py.item(py.partition(start, "\n"), 0).trim();
shortened_line = ((py.compare(py.len(first_line), 40) <= 0) ? first_line : (py.plus(py.slice(first_line, null, 39), "…")));
return new FileKind$kind("text", `text that begins ${py.str(py.repr(shortened_line))}`);
}
function _markup_kind$text_kinds(start, low) {
  let hint, match, name, reason, title, word;
if (((py.contains(low, "<html")) || py.bool(py.startsWith(low, "<!doctype html")))) {
match = _HTML_TITLE$3.exec(py.slice(start, null, 4096));
title = (py.bool(match) ? `a web page (HTML) titled ${py.str(py.repr(py.item(match, 1).trim()))}` : "a web page (HTML)");
hint = "Download the file itself: the address is that of a page about it, or the server refused.";
return new FileKind$kind("html", title, hint);
}
if (((py.contains(low, "<code>")) && (py.contains(low, "<message>")))) {
match = _ERROR_CODE$4.exec(py.slice(start, null, 4096));
reason = (py.bool(match) ? ` (${py.str(py.item(match, 1).trim())})` : "");
hint = "The server refused the download: check the address, or sign in.";
return new FileKind$kind("error", `an error message of a server${py.str(reason)}`, hint);
}
for ([word, name] of py.iter([["<svg", "an SVG picture"], ["<collada", "a COLLADA scene"], ["<kml", "KML"]])) {
if ((py.contains(low, word))) {
return new FileKind$kind("xml", name, (py.bool(py.startsWith(name, "a C")) ? "Export splats as PLY, or a mesh as GLB, with the program that wrote it." : ""));
}
}
return new FileKind$kind("xml", "an XML document");
}
function json_kind$text_kinds(text) {
  let gltf_keys, hint, is_gltf, keys, name, names, needed, reason, title, values;
keys = _top_level_keys$text_kinds(text);
if (py.bool(py.startsWith(text, "["))) {
if (((py.contains(keys, "img_name")) && (py.contains(keys, "rotation")))) {
title = "the list of cameras of a 3DGS training (cameras.json)";
return new FileKind$kind("cameras", title, "Cameras: give it to `gsgen render --camera`, beside the scene.");
}
return new FileKind$kind("json", "a JSON list");
}
for ([needed, name, title, hint] of py.iter(_JSON_OBJECT_KINDS$6)) {
if (py.bool(py.list(needed).every((entry) => keys.has(entry)))) {
return new FileKind$kind(name, title, hint);
}
}
gltf_keys = [...(function* () { for (const key of py.iter(keys)) if ((py.contains(_GLTF_KEYS$7, key))) yield key; })()];
is_gltf = py.or((py.compare(py.len(gltf_keys), 1) > 0), () => py.list((function* () { for (const key of py.iter(keys)) yield (py.contains(_GLTF_ONLY_KEYS$8, key)); })()).some(py.bool));
if ((py.bool(is_gltf) || (py.bool(gltf_keys) && (py.contains(keys, "asset"))))) {
if ((py.contains(text, "KHR_gaussian_splatting"))) {
return new FileKind$kind("gltf-splats", "a glTF file of splats", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it.");
}
return new FileKind$kind("gltf", "a glTF file without splats", "A mesh: `gsgen render` draws it.");
}
if ((py.list((function* () { for (const key of py.iter(keys)) yield (py.contains(_ERROR_KEYS$9, key.toLowerCase())); })()).some(py.bool) && (py.compare(py.len(keys), 6) <= 0))) {
values = [...(function* () { for (const key of py.iter(keys)) if (((py.contains(_ERROR_KEYS$9, key.toLowerCase())) && py.bool(py.item(keys, key)))) yield py.item(keys, key); })()];
reason = (py.bool(values) ? ` (${py.str(py.item(values, 0))})` : "");
hint = "The server refused the download: check the address, or sign in.";
return new FileKind$kind("error", `an error message in JSON${py.str(reason)}`, hint);
}
if (!py.bool(keys)) {
return new FileKind$kind("json", "a JSON document without keys");
}
names = (py.plus(py.list(py.slice(py.list(keys), null, 6)).join(", "), ((py.compare(py.len(keys), 6) > 0) ? ", …" : "")));
return new FileKind$kind("json", `a JSON document with the keys ${py.str(names)}`);
}
function _top_level_keys$text_kinds(text) {
  let depth, key, keys, last_string, level, match, previous, token;
level = (py.bool(py.startsWith(text, "[")) ? 2 : 1);
keys = py.dict([]);
[depth, last_string, key, previous] = [0, "", "", ""];
for (match of py.iter(text.matchAll(new RegExp(_JSON_TOKEN_PATTERN$5, `g${_JSON_TOKEN_PATTERN$5.flags}`)))) {
token = py.item(match, 0);
if ((py.contains("{[", token))) {
depth = (py.plus(depth, 1));
} else {
if ((py.contains("}]", token))) {
depth = (py.minus(depth, 1));
if (((py.compare(depth, level) < 0) && py.bool(keys))) {
break;
}
} else {
if ((py.eq(token, ":"))) {
if ((py.eq(depth, level))) {
key = last_string;
keys.set(key, "");
}
} else {
if ((!py.eq(token, ","))) {
last_string = _strip_quotes$text_kinds(token);
if (((py.eq(previous, ":")) && (py.eq(depth, level)) && py.bool(key))) {
keys.set(key, py.slice(last_string, null, 60));
}
}
}
}
}
previous = token;
}
return keys;
}
function _strip_quotes$text_kinds(token) {
try {
return py.str(py.loads(token));
} catch (error) {
if (!(error instanceof SyntaxError)) throw error;
return py.slice(token, 1, (-1));
}
}
function archive_kind$recognition(names) {
  let base_names, count, files, has_one_splat_file, hint, is_script, listed_names, suffixes, title;
files = [...(function* () { for (const name of py.iter(names)) if (!(py.bool(py.endsWith(name, "/")) || py.bool(_is_hidden$recognition(name)))) yield name; })()];
base_names = py.set((function* () { for (const name of py.iter(files)) yield py.item(py.rpartition(name, "/"), 2).toLowerCase(); })());
suffixes = py.set((function* () { for (const name of py.iter(files)) yield _suffix$recognition(name); })());
if ((py.contains(base_names, "data.pkl"))) {
is_script = (py.contains(base_names, "constants.pkl"));
title = (py.bool(is_script) ? "a network in TorchScript" : "a checkpoint of torch");
hint = "`gsgen render` and `gsgen export static` take those of gsplat, nerfstudio and 3DGS, and `gsgen export` those of the methods that `gsgen plugins` lists.";
return new FileKind$kind((py.bool(is_script) ? "torchscript" : "torch"), title, hint);
}
if ((py.bool(files) && (py.eq(suffixes, py.set([".npy"]))))) {
return new FileKind$kind("npz", "an NPZ archive of NumPy arrays", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it.");
}
if (((py.contains(base_names, "tileset.json")) || (py.contains(base_names, "@3dtilesindex1@")))) {
return new FileKind$kind("3tz", "an archive of a tileset (3TZ)", "`gsgen render`, `gsgen validate` and `gsgen tiles info` take its tileset.json.");
}
if ((py.contains(base_names, "lod-meta.json"))) {
title = "a ZIP archive of a streamed SOG";
return new FileKind$kind("streamed-sog", title, "Unpack it, and name lod-meta.json.");
}
if (((py.contains(base_names, "meta.json")) && (py.contains(suffixes, ".webp")))) {
return new FileKind$kind("sog", "a SOG file of splats", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it.");
}
if ((py.bool(files) && (py.contains([".usda", ".usdc", ".usd"], _suffix$recognition(py.item(files, 0)))))) {
return new FileKind$kind("usd", "a USD archive (usdz)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it.");
}
if ((py.contains(base_names, "[content_types].xml"))) {
return new FileKind$kind("office", "an office document or 3MF model", "Export splats as PLY, or a mesh as GLB, with the program that wrote it.");
}
listed_names = (py.plus(py.list(py.slice(files, null, 4)).join(", "), ((py.compare(py.len(files), 4) > 0) ? ", …" : "")));
count = ((py.compare(py.len(files), 4) > 0) ? `${py.str(py.len(files))} files: ` : "");
title = (py.bool(files) ? `a ZIP archive of ${py.str(count)}${py.str(listed_names)}` : "a ZIP archive without files");
has_one_splat_file = (py.eq(py.list((function* () { for (const name of py.iter(files)) yield py.endsWith(name.toLowerCase(), SPLAT_SUFFIXES$12); })()).reduce(py.plus, 0), 1));
return new FileKind$kind("zip", title, (py.bool(has_one_splat_file) ? "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it." : "Unpack it, and name one file of it."));
}
function _is_hidden$recognition(name) {
return py.list((function* () { for (const part of py.iter(name.split("/"))) yield py.or(py.startsWith(part, "."), () => (py.eq(part, "__MACOSX"))); })()).some(py.bool);
}
function _suffix$recognition(name) {
  let dot, ending, stem;
[stem, dot, ending] = py.rpartition(py.item(py.rpartition(name, "/"), 2), ".");
return ((py.bool(stem) && py.bool(ending)) ? `${py.str(dot)}${py.str(ending)}`.toLowerCase() : "");
}
const _PLY_ELEMENT$0 = new RegExp("^element\\s+(\\w+)\\s+(\\d+)", "m");
const _PLY_SPLATS$1 = new RegExp("^property\\s+\\w+\\s+(f_dc_0|scale_0|rot_0|opacity)\\s*$", "m");
const _FILE_SIGNATURES$2 = [[0, "b3dm", "b3dm", "a tile of 3D Tiles 1.0 with a mesh (b3dm)", "Upgrade its tileset to 3D Tiles 1.1, whose contents are GLB: `3d-tiles-tools upgrade`."], [0, "i3dm", "i3dm", "a tile of 3D Tiles 1.0 with instances (i3dm)", "Upgrade its tileset to 3D Tiles 1.1, whose contents are GLB: `3d-tiles-tools upgrade`."], [0, "pnts", "pnts", "a tile of 3D Tiles 1.0 with points (pnts)", "Upgrade its tileset to 3D Tiles 1.1, whose contents are GLB: `3d-tiles-tools upgrade`."], [0, "cmpt", "cmpt", "a composite tile of 3D Tiles 1.0 (cmpt)", "Upgrade its tileset to 3D Tiles 1.1, whose contents are GLB: `3d-tiles-tools upgrade`."], [0, "subt", "subtree", "a subtree of an implicit tileset", "Name its tileset.json."], [0, "Kaydara FBX Binary", "fbx", "an FBX file", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "PXR-USDC", "usd", "a USD file (binary, usdc)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "#usda", "usd", "a USD file (text, usda)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "RAD0", "rad", "a RAD file of splats (Spark)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "RADC", "rad", "a chunk of a RAD file of splats (Spark)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "LASF", "las", "a point cloud in LAS or LAZ", "A point cloud: convert it to a PLY with x, y, z and colours."], [0, "ASTM-E57", "e57", "a point cloud in E57", "A point cloud: convert it to a PLY with x, y, z and colours."], [0, "# .PCD", "pcd", "a point cloud in PCD", "A point cloud: convert it to a PLY with x, y, z and colours."], [0, "DRACO", "draco", "a mesh or point cloud in Draco", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "BLENDER", "blend", "a Blender file", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "Ogawa", "alembic", "an Alembic file", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [0, "\u0089PNG", "picture", "a PNG picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "\u00ff\u00d8\u00ff", "picture", "a JPEG picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "GIF8", "picture", "a GIF picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "II*\u0000", "picture", "a TIFF picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "MM\u0000*", "picture", "a TIFF picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "v/1\u0001", "picture", "an OpenEXR picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "#?RADIANCE", "picture", "an HDR picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "8BPS", "picture", "a Photoshop picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "DDS ", "picture", "a DDS texture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "\u00abKTX ", "picture", "a KTX texture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [8, "WEBP", "picture", "a WebP picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [8, "AVI ", "video", "an AVI video", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [8, "WAVE", "audio", "a sound file (WAV)", ""], [4, "ftypheic", "picture", "a HEIC picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [4, "ftypmif1", "picture", "a HEIF picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [4, "ftypavif", "picture", "an AVIF picture", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [4, "ftyp", "video", "an MP4 or QuickTime video", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [4, "moov", "video", "a QuickTime video", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "\u001aE\u00df\u00a3", "video", "a Matroska or WebM video", "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."], [0, "7z\u00bc\u00af'\u001c", "archive", "a 7z archive", "Unpack it, and name one file of it."], [0, "Rar!\u001a\u0007", "archive", "a RAR archive", "Unpack it, and name one file of it."], [0, "BZh", "archive", "a bzip2 file", "Unpack it, and name one file of it."], [0, "\u00fd7zXZ\u0000", "archive", "an xz file", "Unpack it, and name one file of it."], [0, "(\u00b5/\u00fd", "archive", "a Zstandard file", "Unpack it, and name one file of it."], [257, "ustar", "archive", "a tar archive", "Unpack it, and name one file of it."], [0, "PK\u0005\u0006", "zip", "an empty ZIP archive", "Copy or download the file again."], [0, "\u0093NUMPY", "npy", "a NumPy array", "Save named arrays with `np.savez`."], [0, "\u0089HDF", "hdf5", "an HDF5 file", "Save the tensors as a 3DGS PLY, or in a checkpoint of gsplat."], [0, "GGUF", "gguf", "a file of weights (GGUF)", "Save the tensors as a 3DGS PLY, or in a checkpoint of gsplat."], [0, "PAR1", "parquet", "a Parquet table", ""], [0, "SQLite format 3", "sqlite", "an SQLite database, such as COLMAP's", ""], [0, "%PDF", "pdf", "a PDF document", ""], [0, "\u007fELF", "program", "a program or library", ""], [4, "ORTM", "ort", "a model in ONNX Runtime's own format (ORT)", "Name the ONNX model that it was converted from; an ORT file cannot be turned back."], [4, "TFL3", "tflite", "a TensorFlow Lite model", "Convert it to ONNX."], [0, "NGSP", "spz", "an SPZ file of splats", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it."], [0, "\u0080\u0002\u008a\nl\u00fc\u009cF\u00f9 j\u00a8P\u0019.", "old-torch", "a checkpoint of torch before 1.6", "Load it with torch, and save it again: `torch.save(torch.load(OLD), NEW)`."], [0, "\u0080\u0002", "pickle", "a pickle", "Only checkpoints of `torch.save` are read: save the tensors with torch 1.6 or later."], [0, "\u0080\u0003", "pickle", "a pickle", "Only checkpoints of `torch.save` are read: save the tensors with torch 1.6 or later."], [0, "\u0080\u0004", "pickle", "a pickle", "Only checkpoints of `torch.save` are read: save the tensors with torch 1.6 or later."], [0, "\u0080\u0005", "pickle", "a pickle", "Only checkpoints of `torch.save` are read: save the tensors with torch 1.6 or later."]];
const _HTML_TITLE$3 = new RegExp("<title[^>]*>\\s*([^<]{1,60})", "i");
const _ERROR_CODE$4 = new RegExp("<code>\\s*([^<]{1,60})", "i");
const _JSON_TOKEN_PATTERN$5 = new RegExp("\"(?:[^\"\\\\]|\\\\.)*\"|[{}\\[\\]:,]", "");
const _JSON_OBJECT_KINDS$6 = [[py.set(["asset", "root"]), "tileset", "a tileset of 3D Tiles", "`gsgen render`, `gsgen validate` and `gsgen tiles info` take its tileset.json."], [py.set(["asset", "geometricError"]), "tileset", "a tileset of 3D Tiles", "`gsgen render`, `gsgen validate` and `gsgen tiles info` take its tileset.json."], [py.set(["lodLevels"]), "streamed-sog", "the lod-meta.json of a streamed SOG", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it."], [py.set(["filenames", "tree"]), "streamed-sog", "the lod-meta.json of a streamed SOG", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it."], [py.set(["means", "scales"]), "sog", "the meta.json of a SOG", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it."], [py.set(["means", "quats"]), "sog", "the meta.json of a SOG", "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` makes a model of it."], [py.set(["gsgen_scene"]), "scene", "a scene file of gsgen", "`gsgen render` and `gsgen view` draw it."], [py.set(["totalSplats"]), "lcc", "an LCC file of splats (XGRIDS)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [py.set(["cellLengthX", "totalLevel"]), "lcc", "an LCC file of splats (XGRIDS)", "Export splats as PLY, or a mesh as GLB, with the program that wrote it."], [py.set(["camera_angle_x", "frames"]), "cameras", "a file of cameras (transforms.json)", "Cameras: give it to `gsgen render --camera`, beside the scene."], [py.set(["fl_x", "frames"]), "cameras", "a file of cameras (transforms.json)", "Cameras: give it to `gsgen render --camera`, beside the scene."], [py.set(["frames", "w"]), "cameras", "a file of cameras (transforms.json)", "Cameras: give it to `gsgen render --camera`, beside the scene."], [py.set(["frames"]), "cameras", "a JSON document of frames, such as transforms.json", "Cameras: give it to `gsgen render --camera`, beside the scene."], [py.set(["camera_path"]), "cameras", "a camera path of nerfstudio", "Cameras: give it to `gsgen render --camera`, beside the scene."], [py.set(["camera_type", "keyframes"]), "cameras", "a camera path of nerfstudio", "Cameras: give it to `gsgen render --camera`, beside the scene."]];
const _GLTF_KEYS$7 = py.set(["accessors", "bufferViews", "buffers", "meshes", "nodes", "scenes"]);
const _GLTF_ONLY_KEYS$8 = py.set(["accessors", "bufferViews"]);
const _ERROR_KEYS$9 = py.set(["code", "detail", "error", "errors", "message", "status", "statuscode", "title"]);
const _OBJ_LINE$10 = new RegExp("^(v|vn|vt|f|o|g|s|mtllib|usemtl)\\s+\\S", "");
const _NUMBER_ROW_PATTERN$11 = new RegExp("[-+\\d.eE]+(?:[\\s,;]+[-+\\d.eEnaifNAIF]+)+", "");
const SPLAT_SUFFIXES$12 = [".ply", ".spz", ".splat", ".ksplat", ".sog"];
/** @type {any} */
export const contentKind = content_kind$recognition;
/** @type {any} */
export const archiveKind = archive_kind$recognition;
/** @type {any} */
export const RECOGNITION_BYTES = 65536;
