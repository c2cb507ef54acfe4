"""Read and write GLB files with the glTF extension KHR_gaussian_splatting (Khronos, ratified).

A GLB is x left, y up, z forward where a PLY file is x right, y down, z forward.
"""

from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsgen.formats.glb.container import Container, build, members, parse
from gsgen.formats.glb.nodes import Matrix, meshes, moved
from gsgen.formats.glb.splats import (
    COLOR_SPACES,
    NAME,
    coefficient,
    is_splats,
    read_primitive,
)
from gsgen.formats.shared.axes import RDF_LUF, flip
from gsgen.formats.shared.bytes import MAX_BYTES, Data, contents
from gsgen.formats.shared.errors import (
    HeaderMalformed,
    PropertyMissing,
    SizeExceeded,
    ValueInvalid,
)
from gsgen.formats.shared.files import FilePath, naming, replacing
from gsgen.formats.shared.joined import joined
from gsgen.formats.shared.quantities import sigmoid, unit
from gsgen.formats.shared.splat_values import linear_scale, require_drawable
from gsgen.formats.shared.splats import Splats
from gsgen.formats.shared.values import require_rows

__all__ = ["read_glb", "write_glb"]

_LARGEST = 2**32 - 1
_HEADER_ROOM = 1 << 16
_FLOAT, _WIDTHS = 5126, {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_BYTES_EACH = 44  # of a splat in memory, less its harmonics


def read_glb(path: FilePath, *, max_bytes: int = MAX_BYTES) -> Splats:
    """Read the splats that the scene of the GLB file at ``path`` shows, as one set.

    Each is put where its node says; its harmonics turn along. Attributes of earlier drafts
    of the extension, and SPZ in a buffer view, are read too. Other meshes are passed over.

    Args:
        path: The file.
        max_bytes: What the splats of all nodes may take together; nodes can share a mesh.

    Raises:
        FileUnreadable: The file is missing, empty or closed to us.
        NotRecognised: It is no GLB file.
        NotSupported: It is of another version, or needs files beside it.
        HeaderMalformed: The JSON breaks the rules of glTF or of the extension.
        PropertyMissing: There are no splats, or an attribute of theirs is not there.
        FileTruncated: The file ends early.
        SizeExceeded: The splats would take more than ``max_bytes``.
        ValueInvalid: A value that cannot be drawn.
    """
    with contents(path) as data:
        splats = decode_glb(data, max_bytes)
        require_drawable(splats)
        return splats


def decode_glb(data: Data, max_bytes: int = MAX_BYTES) -> Splats:
    """Return the splats of the GLB file ``data``, with the axes of a PLY file."""
    glb = parse(data)
    parts: list[Splats] = []
    spent = 0
    for primitive, matrix, where in _primitives(glb):
        splats = read_primitive(glb, primitive, where, max_bytes - spent)
        require_rows(len(splats), where)
        spent += len(splats) * (_BYTES_EACH + 12 * splats.sh.shape[1])
        if spent > max_bytes:
            raise SizeExceeded(
                f"splats of {spent} bytes", where=where, expected=f"{max_bytes} or fewer"
            )
        parts.append(moved(splats, matrix))
    if not parts:
        raise PropertyMissing(
            "no splats in the scene", expected=f"a mesh of points with {NAME}"
        )
    spaces = {part.color_space for part in parts}
    if len(spaces) > 1:
        raise HeaderMalformed(
            "sRGB and linear colours", where="colorSpace", expected="one of them for all"
        )
    return flip(joined(parts), RDF_LUF)


def _primitives(glb: Container) -> Iterator[tuple[dict[str, Any], Matrix, str]]:
    for mesh, matrix in meshes(glb):
        found = members(glb.item("meshes", mesh, "nodes"), "primitives", f"meshes[{mesh}]")
        for index, primitive in enumerate(found):
            if isinstance(primitive, dict) and is_splats(primitive):
                yield primitive, matrix, f"meshes[{mesh}].primitives[{index}]"


def write_glb(path: FilePath, splats: Splats) -> None:
    """Write ``splats`` to ``path`` as a GLB file with the extension KHR_gaussian_splatting.

    All numbers are float32. Scales become linear, opacities shares and quaternions unit,
    which costs their last digits; an opacity that rounds to 1 comes back as infinite.
    The file appears whole or not at all.

    Raises:
        ValueInvalid: ``splats`` is empty, holds values that cannot be drawn, or needs more
            than the 4 GiB that a GLB file can be.
        FileUnwritable: The file could not be written or put in place.
    """
    with naming(path):
        require_drawable(splats)
        arrays = _attributes(flip(splats, RDF_LUF))
        size = sum(array.nbytes for array in arrays.values())
        if size > _LARGEST - _HEADER_ROOM:
            raise ValueInvalid(
                f"{size} bytes",
                where="arrays",
                expected="less than 4 GiB, as of a GLB file",
            )
    with replacing(path) as file:
        file.write(build(_document(arrays, splats), size))
        for array in arrays.values():
            file.write(np.ascontiguousarray(array, "<f4").data)


def _attributes(splats: Splats) -> dict[str, Float32[np.ndarray, "n w"]]:
    rotation = unit(splats.rotation)[:, [1, 2, 3, 0]]
    arrays = {
        "POSITION": splats.position,
        f"{NAME}:ROTATION": rotation,
        f"{NAME}:SCALE": linear_scale(splats),
        f"{NAME}:OPACITY": sigmoid(splats.logit_opacity)[:, None],
    }
    bands = range(splats.degree + 1)
    pairs = [(band, index) for band in bands for index in range(2 * band + 1)]
    for column, pair in enumerate(pairs):
        arrays[coefficient(*pair)] = splats.sh[:, column]
    return arrays


def _document(
    arrays: dict[str, Float32[np.ndarray, "n w"]], splats: Splats
) -> dict[str, Any]:
    views, accessors, at = [], [], 0
    for index, (name, array) in enumerate(arrays.items()):
        views.append({"buffer": 0, "byteOffset": at, "byteLength": array.nbytes})
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
        at += array.nbytes
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
        "extensions": {NAME: extension},
    }
    return {
        "asset": {"version": "2.0", "generator": f"gsgen {version('gsgen')}"},
        "extensionsUsed": [NAME],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": at}],
        "bufferViews": views,
        "accessors": accessors,
    }
