"""Writes the content of a tile: splats as a GLB file that 3D Tiles viewers draw.

Equal splats give equal bytes, on any machine.
"""

__all__ = ["CODECS", "EXTENT_SIGMAS", "SPZ_QUALITIES", "EncodedContent", "write_content"]

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.formats.glb.container import build
from gsgen.formats.glb.splats import COLOR_SPACES, EXTENSION_NAME, coefficient
from gsgen.formats.shared.quantities import sigmoid, unit
from gsgen.formats.shared.splat_values import linear_scale, require_drawable
from gsgen.formats.shared.splats import SH_COUNTS, Splats
from gsgen.tiles.format.extensions import SPZ_EXTENSION, CodecName
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.format.tileset import Z_UP_FROM_Y_UP
from gsgen.tiles.gltf.axes import to_content_axes
from gsgen.tiles.gltf.file_worth import compare_stored
from gsgen.tiles.gltf.spz_quality import SPZ_QUALITIES, encode_spz

EXTENT_SIGMAS: Final = 3.0
"""Standard deviations that the volumes of tiles hold of each splat."""

_DIAGONAL_INDICES = [0, 3, 5]  # xx, yy and zz of an upper triangle
_FLOAT_COMPONENT, _UNSIGNED_BYTE = 5126, 5121
_TYPE_BY_WIDTH = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_EncodedParts = tuple[JsonDict, bytes, Splats]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class EncodedContent:
    """An encoded tile content, and the box, number and SH degree of its stored splats.

    Attributes:
        data: The GLB file.
        low: Lower corner of all stored splats at 3σ, in the root frame.
        high: Upper corner of the same.
        splats: How many splats are stored.
        sh_degree: Degree of the spherical harmonics that are stored.
        worth: How like the splats the stored ones are, 0 to 1.
        squared_shift: How far the stored ones are from the splats, in scene units².
    """

    data: bytes
    low: Float64[np.ndarray, " 3"]
    high: Float64[np.ndarray, " 3"]
    splats: int
    sh_degree: int
    worth: float
    squared_shift: float


def write_content(
    splats: Splats, center: Float64[np.ndarray, " 3"], *, codec: CodecName = "spz", quality: int = 0
) -> EncodedContent:
    """Encode the splats of one tile as a GLB file.

    The splats are stored relative to ``center``, which goes into the matrix of the node. SPZ
    reorders splats of degree 0. Harmonics above degree 3 are dropped: the extension has no names
    for them.

    Args:
        splats: In the root tile's frame, z up; at least one.
        center: A point near the splats, in the same frame.
        codec: ``spz`` for SPZ version 2, ``khr`` for plain float32 accessors.
        quality: 0 is the finest, 4 the smallest; ``khr`` has one quality only.

    Raises:
        ValueInvalid: The splats are empty or cannot be drawn, or lie too far from ``center``.
    """
    require_drawable(splats)
    position = splats.position.astype(np.float64) - center
    truncated_sh = splats.sh[:, : SH_COUNTS[min(splats.degree, MAX_DEGREE)]]
    local = to_content_axes(
        replace(splats, position=position.astype(np.float32), sh=np.ascontiguousarray(truncated_sh))
    )
    document, binary, stored_splats = CODECS[codec](local, quality)
    document["nodes"] = [{"matrix": _translation(center), "mesh": 0}]
    low, high = _extent(stored_splats)
    is_exact = stored_splats is local
    worth, shift = (1.0, 0.0) if is_exact else compare_stored(local, stored_splats)
    padded = binary + bytes(-len(binary) % 4)
    return EncodedContent(
        data=build(document, len(padded)) + padded,
        low=low + center,
        high=high + center,
        splats=len(stored_splats),
        sh_degree=stored_splats.degree,
        worth=worth,
        squared_shift=shift,
    )


def _translation(center: Float64[np.ndarray, " 3"]) -> list[float]:
    """Return the column-major glTF matrix that translates a tile's content to its centre."""
    matrix = np.eye(4)
    matrix[:3, 3] = Z_UP_FROM_Y_UP[:3, :3].T @ center + 0.0
    return [float(value) for value in matrix.T.ravel()]


def _extent(stored_splats: Splats) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
    """Return the bounding box of splats at 3σ, rotated from glTF axes to the tile's axes."""
    scale = np.exp(stored_splats.log_scale.astype(np.float64))
    variance = covariance_upper(scale, stored_splats.rotation)[:, _DIAGONAL_INDICES]
    reach = EXTENT_SIGMAS * np.sqrt(variance)
    low = (stored_splats.position - reach).min(axis=0)
    high = (stored_splats.position + reach).max(axis=0)
    x, y, z = range(3)
    return (np.array([low[x], -high[z], low[y]]), np.array([high[x], -low[z], high[y]]))


def _encode_spz_splats(local: Splats, quality: int) -> _EncodedParts:
    packed, stored_splats = encode_spz(local, quality)
    count = len(stored_splats)
    low, high = stored_splats.position.min(axis=0), stored_splats.position.max(axis=0)
    accessors: dict[str, JsonDict] = {
        "POSITION": _accessor("VEC3", count)
        | {"min": [float(v) for v in low], "max": [float(v) for v in high]},
        "COLOR_0": {**_accessor("VEC4", count, _UNSIGNED_BYTE), "normalized": True},
        f"{EXTENSION_NAME}:SCALE": _accessor("VEC3", count),
        f"{EXTENSION_NAME}:ROTATION": _accessor("VEC4", count),
    }
    for band in range(1, stored_splats.degree + 1):
        for index in range(2 * band + 1):
            accessors[coefficient(band, index)] = _accessor("VEC3", count)
    document = _document(accessors, [len(packed)], stored_splats)
    extension = document["meshes"][0]["primitives"][0]["extensions"][EXTENSION_NAME]
    extension["extensions"] = {SPZ_EXTENSION: {"bufferView": 0}}
    for key in ("extensionsUsed", "extensionsRequired"):
        document[key] = [EXTENSION_NAME, SPZ_EXTENSION]
    return document, packed, stored_splats


def _encode_float_splats(local: Splats, quality: int) -> _EncodedParts:
    del quality  # floats have one
    arrays = {
        "POSITION": local.position,
        f"{EXTENSION_NAME}:ROTATION": unit(local.rotation)[:, [1, 2, 3, 0]],
        f"{EXTENSION_NAME}:SCALE": linear_scale(local),
        f"{EXTENSION_NAME}:OPACITY": sigmoid(local.logit_opacity)[:, None],
    }
    pairs = [(band, n) for band in range(local.degree + 1) for n in range(2 * band + 1)]
    for column, pair in enumerate(pairs):
        arrays[coefficient(*pair)] = local.sh[:, column]
    accessors = {}
    for index, (name, array) in enumerate(arrays.items()):
        accessors[name] = _accessor(_TYPE_BY_WIDTH[array.shape[1]], len(array))
        accessors[name]["bufferView"] = index
    low, high = local.position.min(axis=0), local.position.max(axis=0)
    accessors["POSITION"]["min"] = [float(value) for value in low]
    accessors["POSITION"]["max"] = [float(value) for value in high]
    document = _document(accessors, [array.nbytes for array in arrays.values()], local)
    document["extensionsUsed"] = document["extensionsRequired"] = [EXTENSION_NAME]
    binary = b"".join(np.ascontiguousarray(array, "<f4").tobytes() for array in arrays.values())
    return document, binary, local


def _accessor(width: str, count: int, component_type: int = _FLOAT_COMPONENT) -> JsonDict:
    return {"componentType": component_type, "count": count, "type": width}


def _document(accessors: dict[str, JsonDict], sizes: list[int], splats: Splats) -> JsonDict:
    spaces = {space: name for name, space in COLOR_SPACES.items()}
    extension: JsonDict = {
        "kernel": "ellipse",
        "colorSpace": spaces[splats.color_space],
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    view_starts = [sum(sizes[:index]) for index in range(len(sizes))]
    primitive = {
        "mode": 0,
        "attributes": {name: index for index, name in enumerate(accessors)},
        "extensions": {EXTENSION_NAME: extension},
    }
    return {
        "asset": {"version": "2.0", "generator": "gsgen"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": sum(sizes)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": size}
            for start, size in zip(view_starts, sizes, strict=True)
        ],
        "accessors": list(accessors.values()),
    }


CODECS: Final[dict[str, Callable[[Splats, int], _EncodedParts]]] = {
    "spz": _encode_spz_splats,
    "khr": _encode_float_splats,
}
"""Codec name → function of splats with glTF axes to JSON, binary chunk and the stored splats."""
