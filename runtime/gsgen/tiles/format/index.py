"""Writes the ``tileset.json`` of a tileset, and the record of the build.

Equal tiles give equal bytes: keys are sorted, numbers are written in full, no time is noted.
"""

__all__ = [
    "BUILD_RECORD",
    "ContentRecord",
    "TileRecord",
    "content_uri",
    "json_bytes",
    "morton",
    "tileset_document",
    "write_build_record",
    "write_document",
]

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.formats.glb.splats import EXTENSION_NAME
from gsgen.formats.shared.files import replace_file
from gsgen.formats.shared.morton import interleave_bits
from gsgen.formats.shared.origins import Origin
from gsgen.tiles.format.extensions import CONTENT_EXTENSION, SPZ_EXTENSION, CodecName
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.format.metadata import FILES_PROPERTY, TILE_CLASS, TILESET_CLASS, metadata_schema
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION as NEURAL

BUILD_RECORD: Final = "gsgen.tiles.json"
"""Name of the file beside ``tileset.json`` that lists every file with its digest."""

BoxCorner = Float64[np.ndarray, " 3"]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ContentRecord:
    """A written content file of a tile at one quality.

    Attributes:
        uri: Relative to the index.
        size: Bytes of the file.
        low: Lower corner of its splats at 3σ, in the root frame.
        high: Upper corner of the same.
        worth: Similarity of its splats to those of the scene, 0 to 1.
        error: Geometric error of drawing it, in units of the root frame.
        sha256: Of the file; empty where nothing asks for it.
    """

    uri: str
    size: int
    low: BoxCorner
    high: BoxCorner
    worth: float = 1.0
    error: float = 0.0
    sha256: str = ""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TileRecord:
    """A tile to write into ``tileset.json``, with its descendants.

    The index gets boxes that hold the content and all tiles below, and ``low`` and ``high``
    are grown where necessary.

    Attributes:
        level: 0 for the root.
        coordinates: Of the octree's cell (x, y, z), 0 to 2^level − 1 each.
        low: Lower corner of the tile, in the root frame.
        high: Upper corner.
        geometric_error: In units of the root frame; 0 for a leaf.
        cell: Side of the cells in which splats were merged; 0 for a leaf.
        splats: Number of splats of the content; 0 without content.
        contents: One a quality, finest first; empty for a tile without content.
        children: The tiles below, in the order of the index.
        refine: ``REPLACE``: the children take the place of the content; ``ADD``: they join it.
        oversized: The tile holds splats too large for cells; it is outside the octree.
        neural: The object of the extension GSGEN_neural_tile, if there is one.
    """

    level: int
    coordinates: tuple[int, int, int]
    low: BoxCorner
    high: BoxCorner
    geometric_error: float
    cell: float = 0.0
    splats: int = 0
    contents: tuple[ContentRecord, ...] = ()
    children: tuple["TileRecord", ...] = ()
    refine: str = "REPLACE"
    oversized: bool = False
    neural: Mapping[str, object] | None = None


@final
@dataclass(frozen=True, slots=True)
class _WrittenTile:
    """The JSON of a tile in ``tileset.json``, and the tile's bounding box."""

    document: JsonDict = field(repr=False)
    low: BoxCorner
    high: BoxCorner


def morton(coordinates: tuple[int, int, int]) -> int:
    """Return an octree cell's Morton code, where x gives the lowest of each three bits."""
    return int(interleave_bits(*np.array(coordinates, np.uint64)))


def content_uri(level: int, coordinates: tuple[int, int, int], data: bytes) -> str:
    """Return the file name of a tile's content, with a digest of its bytes for caching."""
    digest = hashlib.sha256(data).hexdigest()[:8]
    return f"t/{level}/{morton(coordinates)}-{digest}.glb"


def tileset_document(
    root: TileRecord,
    *,
    source_splats: int,
    sh_degree: int,
    codec: CodecName = "spz",
    quality: int = 0,
    transform: Float64[np.ndarray, "4 4"] | None = None,
    origin: Origin | None = None,
) -> JsonDict:
    """Return the ``tileset.json`` of a tree of tiles as a JSON object.

    Args:
        root: The tree; the contents' uris are relative to the folder of the index.
        source_splats: How many splats the scene has: as many as all leaves together.
        sh_degree: The highest degree of the contents.
        codec: Of the contents.
        quality: Which of each tile's contents the index names; the last where it has fewer.
        transform: From the root frame to the globe (ECEF) or the world; identity where absent.
        origin: The point of the scene that is 0, 0, 0 in the root frame; None for 0, 0, 0.
    """
    root_record = _tile(root, quality)
    tree = root_record.document
    if transform is not None:
        tree["transform"] = [float(value) for value in transform.T.ravel()]
    diagonal_length = float(np.linalg.norm(root_record.high - root_record.low))
    needed = [EXTENSION_NAME, SPZ_EXTENSION] if codec == "spz" else [EXTENSION_NAME]
    neural = [NEURAL] if _has_neural(root) else []
    return {
        "asset": {"version": "1.1", "generator": "gsgen"},
        "extensions": {CONTENT_EXTENSION: {"extensionsRequired": needed, "extensionsUsed": needed}},
        "extensionsRequired": [CONTENT_EXTENSION],
        "extensionsUsed": [CONTENT_EXTENSION, *neural],
        "geometricError": max(diagonal_length, root.geometric_error),
        "metadata": {
            "class": TILESET_CLASS,
            "properties": {
                "quality": quality,
                "sh_degree": sh_degree,
                "source_splats": source_splats,
                **({} if origin is None else {"origin": list(origin)}),
            },
        },
        "root": {**tree, "refine": root.refine},
        "schema": metadata_schema(has_origin=origin is not None),
    }


def _has_neural(tile: TileRecord) -> bool:
    return tile.neural is not None or any(map(_has_neural, tile.children))


def _tile(tile: TileRecord, quality: int) -> _WrittenTile:
    children = [_tile(child, quality) for child in tile.children]
    low, high = (np.asarray(tile.low, np.float64), np.asarray(tile.high, np.float64))
    document: JsonDict = {"geometricError": float(tile.geometric_error)}
    if tile.contents:
        content = tile.contents[min(quality, len(tile.contents) - 1)]
        volume = box_numbers(content.low, content.high)
        document["content"] = {"boundingVolume": {"box": volume}, "uri": content.uri}
        document["metadata"] = {"class": TILE_CLASS, "properties": _metadata_properties(tile)}
        low, high = np.minimum(low, content.low), np.maximum(high, content.high)
    for child in children:
        low, high = np.minimum(low, child.low), np.maximum(high, child.high)
    document["boundingVolume"] = {"box": box_numbers(low, high)}
    if children:
        document["children"] = [child.document for child in children]
        document["refine"] = tile.refine
    if tile.neural is not None:
        document["extensions"] = {NEURAL: dict(tile.neural)}
    return _WrittenTile(document, low, high)


def _metadata_properties(tile: TileRecord) -> JsonDict:
    properties: JsonDict = {
        "bytes": [content.size for content in tile.contents],
        "cell": float(tile.cell),
        "error": [float(np.float32(content.error)) for content in tile.contents],
        "splats": tile.splats,
    }
    if len(tile.contents) > 1:
        properties[FILES_PROPERTY] = [content.uri for content in tile.contents]
        properties["worth"] = [float(np.float32(content.worth)) for content in tile.contents]
    return properties


def box_numbers(low: BoxCorner, high: BoxCorner) -> list[float]:
    """Return an axis-aligned box as 3D Tiles encodes it: the centre, and three half axes."""
    half_axes = np.diag((np.asarray(high) - low) / 2)
    return [float(value) for value in [*((np.asarray(high) + low) / 2), *half_axes.ravel()]]


def write_build_record(
    path: Path, *, key: str, source_splats: int, files: Mapping[str, bytes | tuple[int, str]]
) -> None:
    """Write a tileset's build record: the size and SHA-256 of every file, for the validator.

    Args:
        path: ``gsgen.tiles.json`` beside the index.
        key: Digest of the inputs and parameters of the build.
        source_splats: How many splats went in.
        files: Relative uri → the bytes of the file, or its size and SHA-256 in hexadecimal.
    """
    file_entries = {}
    for uri, entry in files.items():
        if isinstance(entry, bytes):
            entry = len(entry), hashlib.sha256(entry).hexdigest()
        file_entries[uri] = {"bytes": entry[0], "sha256": entry[1]}
    document = {
        "files": file_entries,
        "generator": "gsgen",
        "key": key,
        "source_splats": source_splats,
        "version": 1,
    }
    write_document(path, document)


def write_document(path: Path, document: Mapping[str, object]) -> None:
    """Write a JSON object into a file, atomically; raise FileUnwritable if that fails."""
    with replace_file(path) as file:
        file.write(json_bytes(document))


def json_bytes(document: Mapping[str, object]) -> bytes:
    """Return JSON as bytes with sorted keys and no spaces, the same on every machine."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode() + b"\n"
