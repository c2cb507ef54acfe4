"""Reads and writes GLB files with the glTF extension KHR_gaussian_splatting (Khronos, ratified).

The axes of a GLB are x left, y up, z forward; those of a PLY file are x right, y down, z forward.
"""

from collections.abc import Iterator
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, kind_of
from gsgen.formats.glb.container import (
    Container,
    array_member,
    build,
    parse,
    require_known_extensions,
)
from gsgen.formats.glb.gltf import parse_gltf
from gsgen.formats.glb.nodes import Matrix, meshes, transform_splats
from gsgen.formats.glb.splats import (
    COLOR_SPACES,
    EXTENSION_NAME,
    READABLE_EXTENSIONS,
    coefficient,
    is_splats,
    read_primitive,
)
from gsgen.formats.shared.axes import RDF_LUF, flip
from gsgen.formats.shared.bytes import MAX_BYTES, Data, contents, not_recognised
from gsgen.formats.shared.errors import (
    HeaderMalformed,
    PropertyMissing,
    SizeExceeded,
    ValueInvalid,
    quoted,
)
from gsgen.formats.shared.files import FilePath, file_beside, naming, open_file, replace_file
from gsgen.formats.shared.notices import MeshWarning, warn_unused
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.quantities import sigmoid, unit
from gsgen.formats.shared.splat_values import drawable, linear_scale, require_drawable
from gsgen.formats.shared.splats import Splats
from gsgen.formats.shared.values import require_rows

__all__ = ["decode_glb", "read_glb", "scene_primitives", "write_glb"]

_MAX_UINT32 = 2**32 - 1
_RESERVED_HEADER_BYTES = 1 << 16
_FLOAT, _WIDTHS = 5126, {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_BYTES_PER_SPLAT = 44  # of a splat in memory, less its harmonics


def read_glb(path: FilePath, *, max_bytes: int = MAX_BYTES, drop_invalid: bool = False) -> Splats:
    """Read all splats in the scene of the GLB or .gltf file at ``path`` as one set.

    The transforms of nodes are applied, to the harmonics too. Attributes of earlier drafts of
    the extension, and SPZ in a buffer view, are read too. Other meshes are left out, which a MeshWarning says;
    other unused parts are named in a FormatWarning.

    Args:
        path: The file.
        max_bytes: The limit of the memory for the splats of all nodes; nodes can share a mesh.
        drop_invalid: Drop rows that cannot be drawn, and warn about them.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not a GLB file.
        NotSupported: The file has another version, or requires an unknown extension.
        HeaderMalformed: The JSON breaks the rules of glTF or of the extension.
        PropertyMissing: The scene has no splats, or splats lack an attribute.
        FileTruncated: The file ends early.
        SizeExceeded: The splats would take more than ``max_bytes``.
        ValueInvalid: A value cannot be drawn.
    """
    with contents(path) as data:
        glb = _parse_any(data, path, max_bytes)
        splats = drawable(_decode(glb, max_bytes), path, drop_invalid=drop_invalid)
        warn_unused(path, _unused_parts(glb))
        warn_unused(path, _omitted_mesh_texts(glb), MeshWarning)
        return splats


def is_gltf_of_splats(head: bytes) -> bool:
    """Return whether a file begins as a .gltf file that uses KHR_gaussian_splatting."""
    if head.lstrip()[:1] != b"{":
        return False
    kind = kind_of(head)
    return kind is not None and kind.name == "gltf-splats"


def decode_glb(data: Data, max_bytes: int = MAX_BYTES) -> Splats:
    """Return the splats of the GLB file ``data``, in the coordinate axes of a PLY file."""
    return _decode(parse(data), max_bytes)


def _parse_any(data: Data, path: FilePath, max_bytes: int) -> Container:
    """Parse a GLB file, or a .gltf file with the files beside it."""
    head = bytes(data[:RECOGNITION_BYTES])
    if not head.lstrip().startswith(b"{"):
        return parse(data)
    kind = kind_of(head)
    if kind is None or not kind.name.startswith("gltf"):
        raise not_recognised(head, "a glTF file", head[:4].hex(" "))

    def fetch(name: str, size: int) -> bytes:
        folder = Path(path).parent
        file = folder / name
        if not file.resolve().is_relative_to(folder.resolve()):
            raise HeaderMalformed(quoted(name), where="uri", expected="a file in its folder")
        with open_file(file_beside(path, name)) as stream:
            return stream.read(size)

    return parse_gltf(bytes(data), fetch, max_bytes)


def _decode(glb: Container, max_bytes: int) -> Splats:
    parts: list[Splats] = []
    used_bytes = 0
    for primitive, matrix, where in scene_primitives(glb):
        splats = read_primitive(glb, primitive, where, max_bytes - used_bytes)
        require_rows(len(splats), where)
        used_bytes += len(splats) * (_BYTES_PER_SPLAT + 12 * splats.sh.shape[1])
        if used_bytes > max_bytes:
            raise SizeExceeded(
                f"the splats take {used_bytes} bytes",
                where=where,
                expected=f"{max_bytes} bytes or fewer",
            )
        parts.append(transform_splats(splats, matrix))
    if not parts:
        raise PropertyMissing(
            "the glTF scene holds no splats",
            expected=f"a mesh of points with {EXTENSION_NAME}",
            hint="`gsgen render` draws the meshes of a file.",
        )
    spaces = {part.color_space for part in parts}
    if len(spaces) > 1:
        raise HeaderMalformed(
            "some primitives have sRGB colours, others linear ones",
            where="colorSpace",
            expected="one colour space for all primitives",
        )
    return flip(join_splats(parts), RDF_LUF)


def _omitted_mesh_texts(glb: Container) -> list[str]:
    """Return the primitives of the scene that are no splats, with their numbers of vertices."""
    texts = []
    for mesh, _ in meshes(glb):
        primitives = glb.item("meshes", mesh, "nodes").get("primitives", [])
        for index, primitive in enumerate(primitives):
            if isinstance(primitive, dict) and not is_splats(primitive):
                attributes = primitive.get("attributes", {})
                accessor = glb.item("accessors", attributes.get("POSITION", 0), "POSITION")
                kind = "points" if primitive.get("mode", 4) == 0 else "a mesh"
                texts.append(
                    f"meshes[{mesh}].primitives[{index}], {kind} of {accessor.get('count')} vertices"
                )
    return list(dict.fromkeys(texts))


def _unused_parts(glb: Container) -> list[str]:
    """Return the declared parts of a glTF file that say nothing about splats."""
    document = glb.document
    names = [
        f"{len(document[key])} {key}"
        for key in ("animations", "skins", "cameras")
        if isinstance(document.get(key), list) and document[key]
    ]
    names += [
        f"extension {name}"
        for name in array_member(document, "extensionsUsed", "document")
        if not any(fnmatchcase(str(name), pattern) for pattern in READABLE_EXTENSIONS)
    ]
    trailing_byte_count = len(glb.data) - glb.length if glb.length else 0
    return names + (
        [f"{trailing_byte_count:,} bytes after the end of the file"]
        if trailing_byte_count > 0
        else []
    )


def scene_primitives(glb: Container) -> Iterator[tuple[dict[str, Any], Matrix, str]]:
    """Yield each splat primitive of a glTF scene with its transform and its JSON location."""
    require_known_extensions(glb.document, READABLE_EXTENSIONS)
    for mesh, matrix in meshes(glb):
        primitives = array_member(
            glb.item("meshes", mesh, "nodes"), "primitives", f"meshes[{mesh}]"
        )
        for index, primitive in enumerate(primitives):
            if isinstance(primitive, dict) and is_splats(primitive):
                yield primitive, matrix, f"meshes[{mesh}].primitives[{index}]"


def write_glb(path: FilePath, splats: Splats) -> None:
    """Write ``splats`` to ``path`` as a GLB file with the extension KHR_gaussian_splatting.

    All numbers are float32; the origin is the translation of the node. Scales become linear, opacities become fractions of 1 and quaternions
    are normalised, which costs their last digits. An opacity that rounds to 1 is infinite when
    read.
    The file is written completely or not at all.

    Raises:
        ValueInvalid: ``splats`` is empty, holds values that cannot be drawn, or needs more
            than the 4 GiB of a GLB file.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with naming(path):
        require_drawable(splats)
        turned_splats = flip(splats, RDF_LUF)
        arrays = _attributes(turned_splats)
        size = sum(array.nbytes for array in arrays.values())
        if size > _MAX_UINT32 - _RESERVED_HEADER_BYTES:
            raise ValueInvalid(
                f"the arrays take {size} bytes",
                where="arrays",
                expected="less than 4 GiB, the limit of GLB",
            )
    with replace_file(path) as file:
        file.write(build(_document(arrays, turned_splats), size))
        for array in arrays.values():
            file.write(np.ascontiguousarray(array, "<f4").data)


def _attributes(splats: Splats) -> dict[str, Float32[np.ndarray, "n w"]]:
    rotation = unit(splats.rotation)[:, [1, 2, 3, 0]]
    arrays = {
        "POSITION": splats.position,
        f"{EXTENSION_NAME}:ROTATION": rotation,
        f"{EXTENSION_NAME}:SCALE": linear_scale(splats),
        f"{EXTENSION_NAME}:OPACITY": sigmoid(splats.logit_opacity)[:, None],
    }
    bands = range(splats.degree + 1)
    pairs = [(band, index) for band in bands for index in range(2 * band + 1)]
    for column, pair in enumerate(pairs):
        arrays[coefficient(*pair)] = splats.sh[:, column]
    return arrays


def _document(arrays: dict[str, Float32[np.ndarray, "n w"]], splats: Splats) -> dict[str, Any]:
    views, accessors, offset = [], [], 0
    for index, (name, array) in enumerate(arrays.items()):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes})
        accessor: dict[str, Any] = {
            "bufferView": index,
            "componentType": _FLOAT,
            "count": len(array),
            "type": _WIDTHS[array.shape[1]],
        }
        if name == "POSITION":
            accessor["min"] = [float(value) for value in array.min(axis=0)]
            accessor["max"] = [float(value) for value in array.max(axis=0)]
        accessors.append(accessor)
        offset += array.nbytes
    names = {space: name for name, space in COLOR_SPACES.items()}
    extension = {
        "kernel": "ellipse",
        "colorSpace": names[splats.color_space],
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "mode": 0,
        "attributes": {name: index for index, name in enumerate(arrays)},
        "extensions": {EXTENSION_NAME: extension},
    }
    return {
        "asset": {"version": "2.0", "generator": f"gsgen {version('gsgen')}"},
        "extensionsUsed": [EXTENSION_NAME],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0} | ({"translation": splats.origin} if any(splats.origin) else {})],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
