"""Kinds of text files: JSON, XML, pointers, meshes, headers of PLY files, and others."""

__all__ = ["decoded_text", "json_kind", "ply_kind", "text_kind"]

import codecs
import json
import re
from typing import Final

from gsgen.contract.file_kinds.kind import (
    CAMERAS,
    DOWNLOAD_AGAIN_HINT,
    EXPORT_SPLATS_HINT,
    MESH_RENDER_HINT,
    SPLATS,
    TILESET,
    FileKind,
)

SPLAT_EXTENSION: Final = "KHR_gaussian_splatting"

_JSON_TOKEN_PATTERN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,]')
_OBJ_LINE = re.compile(r"^(v|vn|vt|f|o|g|s|mtllib|usemtl)\s+\S")
_NUMBER_ROW_PATTERN = re.compile(r"[-+\d.eE]+(?:[\s,;]+[-+\d.eEnaifNAIF]+)+")
_ERROR_KEYS = {"error", "errors", "message", "detail", "status", "statuscode", "code", "title"}
_MAX_LISTED_KEYS = 6
_HTML_TITLE = re.compile(r"<title[^>]*>\s*([^<]{1,60})", re.IGNORECASE)
_ERROR_CODE = re.compile(r"<code>\s*([^<]{1,60})", re.IGNORECASE)

# Keys that an object has all of → name, title, hint; the first match counts.
_JSON_OBJECT_KINDS: Final[tuple[tuple[set[str], str, str, str], ...]] = (
    ({"asset", "root"}, "tileset", "a tileset of 3D Tiles", TILESET),
    ({"asset", "geometricError"}, "tileset", "a tileset of 3D Tiles", TILESET),
    ({"lodLevels"}, "streamed-sog", "the lod-meta.json of a streamed SOG", SPLATS),
    ({"tree", "filenames"}, "streamed-sog", "the lod-meta.json of a streamed SOG", SPLATS),
    ({"means", "scales"}, "sog", "the meta.json of a SOG", SPLATS),
    ({"means", "quats"}, "sog", "the meta.json of a SOG", SPLATS),
    ({"gsgen_scene"}, "scene", "a scene file of gsgen", "`gsgen render` and `gsgen view` draw it."),
    ({"totalSplats"}, "lcc", "an LCC file of splats (XGRIDS)", EXPORT_SPLATS_HINT),
    ({"totalLevel", "cellLengthX"}, "lcc", "an LCC file of splats (XGRIDS)", EXPORT_SPLATS_HINT),
    ({"frames", "camera_angle_x"}, "cameras", "a file of cameras (transforms.json)", CAMERAS),
    ({"frames", "fl_x"}, "cameras", "a file of cameras (transforms.json)", CAMERAS),
    ({"frames", "w"}, "cameras", "a file of cameras (transforms.json)", CAMERAS),
    ({"frames"}, "cameras", "a JSON document of frames, such as transforms.json", CAMERAS),
    ({"camera_path"}, "cameras", "a camera path of nerfstudio", CAMERAS),
    ({"camera_type", "keyframes"}, "cameras", "a camera path of nerfstudio", CAMERAS),
)  # fmt: skip
_GLTF_KEYS = {"meshes", "scenes", "nodes", "accessors", "buffers", "bufferViews"}
_GLTF_ONLY_KEYS = {"accessors", "bufferViews"}


def decoded_text(head: bytes) -> str | None:
    """Decode the first bytes of a file as text; None if they are not text."""
    text = _decoded(head)
    return text if _is_readable(text) else None


def _decoded(head: bytes) -> str:
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif head.startswith(codecs.BOM_UTF8):
        encoding = "utf-8-sig"
    else:
        encoding = "utf-8"
    # The last character may be cut off.
    return codecs.getincrementaldecoder(encoding)("replace").decode(head)


def _is_readable(text: str) -> bool:
    """Return whether what was decoded is text: it has no control characters."""
    if not text or "\0" in text:
        return False
    begin = text[:1024]
    readable_count = sum(1 for char in begin if char.isprintable() or char in "\t\r\n\f")
    return readable_count == len(list(begin)) and text.count("�") * 20 <= len(text)


def text_kind(text: str) -> FileKind:
    """Return the kind of a text file from its beginning."""
    start = text.lstrip()
    low = start[:4096].lower()
    if low.startswith(("version https://git-lfs", "version https://hawser")):
        return FileKind(
            name="git-lfs",
            title="a git LFS pointer",
            hint="The file itself is not here: fetch it with `git lfs pull`.",
        )
    if low.startswith("<"):
        return _markup_kind(start, low)
    if start.startswith(("{", "[")):
        return json_kind(start)
    if start.startswith("Namespace("):
        return FileKind(
            name="cfg-args",
            title="the options of a 3DGS training (cfg_args)",
            hint="Name its folder: `gsgen render FOLDER -o picture.png`.",
        )
    if low.startswith(("# camera list with", "# image list with", "# 3d point list with")):
        return FileKind(name="colmap", title="a text file of COLMAP", hint=CAMERAS)
    if low.startswith("; fbx"):
        return FileKind(name="fbx", title="an FBX file (text)", hint=EXPORT_SPLATS_HINT)
    if low.startswith("solid ") and "facet" in low:
        return FileKind(name="stl", title="an STL mesh (text)", hint=MESH_RENDER_HINT)
    if low.startswith(("# .pcd", "version .7", "version 0.7")):
        hint = "A point cloud: convert it to a PLY with x, y, z and colours."
        return FileKind(name="pcd", title="a point cloud in PCD", hint=hint)
    lines = [line for line in start.splitlines()[:200] if line and not line.startswith("#")]
    whole_lines = lines[:-1] or lines  # the last one may be cut off
    if lines and all(_OBJ_LINE.match(line) for line in whole_lines):
        return FileKind(name="obj", title="an OBJ mesh", hint=MESH_RENDER_HINT)
    if lines and all(_NUMBER_ROW_PATTERN.fullmatch(line.strip()) for line in whole_lines):
        hint = "Write points as a PLY with x, y, z and colours."
        return FileKind(name="numbers", title="a table of numbers as text", hint=hint)
    first_line = start.partition("\n")[0].strip()
    shortened_line = first_line if len(first_line) <= 40 else first_line[:39] + "…"
    return FileKind(name="text", title=f"text that begins {shortened_line!r}")


def _markup_kind(start: str, low: str) -> FileKind:
    if "<html" in low or low.startswith("<!doctype html"):
        match = _HTML_TITLE.search(start[:4096])
        title = f"a web page (HTML) titled {match[1].strip()!r}" if match else "a web page (HTML)"
        hint = "Download the file itself: the address is that of a page about it, or the server refused."
        return FileKind(name="html", title=title, hint=hint)
    if "<code>" in low and "<message>" in low:
        match = _ERROR_CODE.search(start[:4096])
        reason = f" ({match[1].strip()})" if match else ""
        hint = "The server refused the download: check the address, or sign in."
        return FileKind(name="error", title=f"an error message of a server{reason}", hint=hint)
    for word, name in (
        ("<svg", "an SVG picture"),
        ("<collada", "a COLLADA scene"),
        ("<kml", "KML"),
    ):
        if word in low:
            return FileKind(
                name="xml", title=name, hint=EXPORT_SPLATS_HINT if name.startswith("a C") else ""
            )
    return FileKind(name="xml", title="an XML document")


def json_kind(text: str) -> FileKind:
    """Return the kind of a JSON file from its beginning."""
    keys = _top_level_keys(text)
    if text.startswith("["):
        if "img_name" in keys and "rotation" in keys:
            title = "the list of cameras of a 3DGS training (cameras.json)"
            return FileKind(name="cameras", title=title, hint=CAMERAS)
        return FileKind(name="json", title="a JSON list")
    for needed, name, title, hint in _JSON_OBJECT_KINDS:
        if needed.issubset(keys):
            return FileKind(name=name, title=title, hint=hint)
    gltf_keys = [key for key in keys if key in _GLTF_KEYS]
    # The first array may be longer than what is seen.
    is_gltf = len(gltf_keys) > 1 or any(key in _GLTF_ONLY_KEYS for key in keys)
    if is_gltf or (gltf_keys and "asset" in keys):
        if SPLAT_EXTENSION in text:
            return FileKind(name="gltf-splats", title="a glTF file of splats", hint=SPLATS)
        return FileKind(name="gltf", title="a glTF file without splats", hint=MESH_RENDER_HINT)
    if any(key.lower() in _ERROR_KEYS for key in keys) and len(keys) <= _MAX_LISTED_KEYS:
        values = [keys[key] for key in keys if key.lower() in _ERROR_KEYS and keys[key]]
        reason = f" ({values[0]})" if values else ""
        hint = "The server refused the download: check the address, or sign in."
        return FileKind(name="error", title=f"an error message in JSON{reason}", hint=hint)
    if not keys:
        return FileKind(name="json", title="a JSON document without keys")
    names = ", ".join(list(keys)[:_MAX_LISTED_KEYS]) + (
        ", …" if len(keys) > _MAX_LISTED_KEYS else ""
    )
    return FileKind(name="json", title=f"a JSON document with the keys {names}")


def _top_level_keys(text: str) -> dict[str, str]:
    """Return the keys of a JSON object, or of the first object of a list, with texts among values.

    The text may be cut off.
    """
    level = 2 if text.startswith("[") else 1
    keys: dict[str, str] = {}
    depth, last_string, key, previous = 0, "", "", ""
    for match in _JSON_TOKEN_PATTERN.finditer(text):
        token = match[0]
        if token in "{[":
            depth += 1
        elif token in "}]":
            depth -= 1
            if depth < level and keys:
                break
        elif token == ":":
            if depth == level:
                key = last_string
                keys[key] = ""
        elif token != ",":
            last_string = _strip_quotes(token)
            if previous == ":" and depth == level and key:
                keys[key] = last_string[:60]
        previous = token
    return keys


def _strip_quotes(token: str) -> str:
    try:
        return str(json.loads(token))
    except ValueError:
        return token[1:-1]


_PLY_SPLATS = re.compile(r"^property\s+\w+\s+(f_dc_0|scale_0|rot_0|opacity)\s*$", re.MULTILINE)
_PLY_ELEMENT = re.compile(r"^element\s+(\w+)\s+(\d+)", re.MULTILINE)


def ply_kind(head: bytes) -> FileKind:
    """Return the kind of a PLY file from its header: splats, a mesh, points or other rows."""
    header = head.partition(b"end_header")[0].decode("latin-1")
    counts = {match[1]: int(match[2]) for match in _PLY_ELEMENT.finditer(header)}
    if "property uint packed_position" in header:
        return FileKind(name="compressed-ply", title="a compressed PLY of splats", hint=SPLATS)
    if "f_offset_0" in header or "anchor" in header:
        hint = "`gsgen plugins` lists the methods whose checkpoints are exported."
        return FileKind(name="ply-anchors", title="a PLY of anchors, not splats", hint=hint)
    if _PLY_SPLATS.search(header):
        return FileKind(name="ply-splats", title="a PLY of splats", hint=SPLATS)
    if counts.get("face", 0) or counts.get("tristrips", 0):
        return FileKind(name="ply-mesh", title="a PLY mesh", hint=MESH_RENDER_HINT)
    if "vertex" in counts:
        hint = "Points with colours: `gsgen export static` makes splats of them."
        return FileKind(name="ply-points", title="a PLY point cloud", hint=hint)
    return FileKind(name="ply", title="a PLY file without vertices", hint=DOWNLOAD_AGAIN_HINT)
