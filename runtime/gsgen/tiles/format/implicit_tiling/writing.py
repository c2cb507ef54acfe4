"""Writes an implicit octree: subtrees of bits and tables instead of a long ``tileset.json``.

Every tile keeps its own box and error, as metadata with the semantics of the 3D Metadata
Specification: splats reach over the cells of an octree, and errors need not halve.
"""

__all__ = ["SUBTREE_LEVELS", "implicit_uri", "write_implicit_tileset"]

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.formats.shared.files import make_folder, replace_file
from gsgen.formats.shared.origins import Origin
from gsgen.tiles.format.extensions import CodecName
from gsgen.tiles.format.implicit_tiling.subtree import tile_count
from gsgen.tiles.format.index import (
    TileRecord,
    box_numbers,
    json_bytes,
    morton,
    tileset_document,
    write_document,
)
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.format.metadata import FILES_PROPERTY, TILE_CLASS, implicit_metadata_schema

SUBTREE_LEVELS: Final = 5
_CHILDREN_PER_TILE = 8
_SUBTREE_URI = "s/{level}/{x}_{y}_{z}.subtree"
_SUBTREE_HEADER = struct.Struct("<4sIQQ")
_VIEW_ALIGNMENT = 8


def implicit_uri(level: int, coordinates: tuple[int, int, int], quality: int = 0) -> str:
    """Return the uri of an implicit tileset's content, as its template requires."""
    x, y, z = coordinates
    return _content_template(quality).format(level=level, x=x, y=y, z=z)


def _content_template(quality: int) -> str:
    return f"t/{{level}}/{{x}}_{{y}}_{{z}}-q{quality}.glb"


def write_implicit_tileset(
    path: Path,
    root: TileRecord,
    *,
    source_splats: int,
    sh_degree: int,
    codec: CodecName = "spz",
    quality: int = 0,
    transform: Float64[np.ndarray, "4 4"] | None = None,
    origin: Origin | None = None,
    subtree_levels: int = SUBTREE_LEVELS,
) -> list[str]:
    """Write ``tileset.json`` and the subtree files of an implicit octree.

    Tiles of ``oversized_cells`` records become explicit tiles beside the tree. Contents have to lie
    where :func:`implicit_uri` says.

    Args:
        path: ``tileset.json``; subtrees are written below its folder.
        root: The tree; its low and high are those of the whole octree.
        source_splats: How many splats the scene has.
        sh_degree: The highest degree of the contents.
        codec: Of the contents.
        quality: Which of each tile's contents the index names.
        transform: From the root frame to the globe or the world.
        origin: The point of the scene that is 0, 0, 0 in the root frame; None for 0, 0, 0.
        subtree_levels: Levels of one subtree.

    Raises:
        ValueError: A content is not where its template says.
        FileUnwritable: A file could not be written.
    """
    tiles: list[_Cell] = []
    oversized_cells: list[TileRecord] = []
    low, high = _collect_cells(root, tiles, oversized_cells)
    wrapper_tile = TileRecord(
        level=0,
        coordinates=(0, 0, 0),
        low=low,
        high=high,
        geometric_error=max(root.geometric_error, float(np.linalg.norm(high - low))),
        children=tuple(replace(tile, children=()) for tile in oversized_cells),
    )
    document = tileset_document(
        wrapper_tile,
        source_splats=source_splats,
        sh_degree=sh_degree,
        codec=codec,
        quality=quality,
        transform=transform,
        origin=origin,
    )
    levels = 1 + max(cell.record.level for cell in tiles)
    counts = {len(cell.record.contents) for cell in tiles if cell.record.contents}
    quality_count = min(counts, default=1)
    document["schema"] = implicit_metadata_schema(
        has_origin=origin is not None, quality_count=quality_count
    )
    if quality_count > 1:
        templates = [_content_template(q) for q in range(quality_count)]
        document["metadata"]["properties"][FILES_PROPERTY] = templates
    tree = _implicit_root(root, low, high, quality, levels, subtree_levels)
    document["root"].setdefault("children", []).insert(0, tree)
    subtrees = dict(_subtrees(tiles, subtree_levels, quality_count))
    for uri, data in subtrees.items():
        make_folder(path.parent / uri)
        with replace_file(path.parent / uri) as file:
            file.write(data)
    write_document(path, document)
    return list(subtrees)


@final
@dataclass(frozen=True, slots=True)
class _Cell:
    """A tile of the octree with the bounding box of its content and descendants."""

    record: TileRecord
    low: Float64[np.ndarray, " 3"]
    high: Float64[np.ndarray, " 3"]


def _collect_cells(
    record: TileRecord, cells: list[_Cell], oversized_cells: list[TileRecord]
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
    """Append an octree tile and its descendants to ``cells``; return the tile's bounding box."""
    low, high = np.array(record.low, np.float64), np.array(record.high, np.float64)
    for quality, content in enumerate(record.contents):
        low, high = np.minimum(low, content.low), np.maximum(high, content.high)
        expected = implicit_uri(record.level, record.coordinates, quality)
        if not record.oversized and content.uri != expected:
            raise ValueError(f"the URI of a tile content is {content.uri}, expected {expected}")
    for child in record.children:
        if child.oversized:
            oversized_cells.append(child)
            below = np.array(child.low), np.array(child.high)
            for entry in child.contents:
                below = np.minimum(below[0], entry.low), np.maximum(below[1], entry.high)
        else:
            below = _collect_cells(child, cells, oversized_cells)
        low, high = np.minimum(low, below[0]), np.maximum(high, below[1])
    cells.append(_Cell(record, low, high))
    return low, high


def _implicit_root(
    root: TileRecord,
    low: Float64[np.ndarray, " 3"],
    high: Float64[np.ndarray, " 3"],
    quality: int,
    levels: int,
    subtree_levels: int,
) -> JsonDict:
    return {
        "boundingVolume": {"box": box_numbers(low, high)},
        "content": {"uri": _content_template(quality)},
        "geometricError": float(root.geometric_error),
        "implicitTiling": {
            "availableLevels": levels,
            "subdivisionScheme": "OCTREE",
            "subtreeLevels": subtree_levels,
            "subtrees": {"uri": _SUBTREE_URI},
        },
        "refine": root.refine,
    }


def _subtrees(cells: list[_Cell], levels: int, quality_count: int) -> Iterable[tuple[str, bytes]]:
    """Yield the URI and bytes of every subtree file of an implicit octree."""
    # 1. Group cells by the root of their subtree: its level, and its place on that level.
    groups: dict[tuple[int, tuple[int, int, int]], list[_Cell]] = {}
    for cell in cells:
        level = cell.record.level
        top = level - level % levels
        x, y, z = (value >> (level - top) for value in cell.record.coordinates)
        groups.setdefault((top, (x, y, z)), []).append(cell)
    # 2. Write each group with the subtrees that begin below its last level.
    for (top, (x, y, z)), members in sorted(groups.items()):
        below = [
            child
            for level, child in groups
            if level == top + levels and tuple(value >> levels for value in child) == (x, y, z)
        ]
        uri = _SUBTREE_URI.replace("{level}", str(top))
        for name, value in zip("xyz", (x, y, z), strict=True):
            uri = uri.replace(f"{{{name}}}", str(value))
        yield uri, _subtree((top, (x, y, z)), members, below, levels, quality_count)


def _subtree(
    origin: tuple[int, tuple[int, int, int]],
    members: list[_Cell],
    below: list[tuple[int, int, int]],
    levels: int,
    quality_count: int,
) -> bytes:
    top, corner = origin

    def index(level: int, coordinates: tuple[int, ...]) -> int:
        depth = level - top
        local = tuple(
            value - (base << depth) for value, base in zip(coordinates, corner, strict=True)
        )
        return tile_count(_CHILDREN_PER_TILE, depth) + morton((local[0], local[1], local[2]))

    # Bits and rows of property tables are in breadth-first order, in Morton order on each level.
    ordered_cells = sorted(
        members, key=lambda cell: index(cell.record.level, cell.record.coordinates)
    )
    indices = [index(cell.record.level, cell.record.coordinates) for cell in ordered_cells]
    content_cells = [cell for cell in ordered_cells if cell.record.contents]
    content_indices = [index(c.record.level, c.record.coordinates) for c in content_cells]
    first = tile_count(_CHILDREN_PER_TILE, levels)
    children = [index(top + levels, child) - first for child in below]
    writer = _SubtreeWriter()
    document: JsonDict = {
        "tileAvailability": writer.bits(indices, first),
        "contentAvailability": [writer.bits(content_indices, first)],
        "childSubtreeAvailability": writer.bits(children, _CHILDREN_PER_TILE**levels),
        "tileMetadata": 0,
        "propertyTables": [
            writer.table(
                TILE_CLASS, len(ordered_cells), _tile_columns(ordered_cells, quality_count)
            )
        ],
    }
    if content_cells:
        columns = _content_columns(content_cells)
        document["contentMetadata"] = [1]
        document["propertyTables"].append(
            writer.table(f"{TILE_CLASS}_content", len(content_cells), columns)
        )
    return writer.file(document)


def _tile_columns(cells: list[_Cell], quality_count: int) -> dict[str, np.ndarray]:
    records = [cell.record for cell in cells]
    told = np.zeros((len(cells), quality_count, 3))
    for row, record in enumerate(records):
        for column, entry in enumerate(record.contents[:quality_count]):
            told[row, column] = entry.size, entry.worth, entry.error
    return {
        "box": np.array([box_numbers(cell.low, cell.high) for cell in cells], "<f8"),
        "bytes": told[:, :, 0].astype("<u4"),
        "cell": np.array([record.cell for record in records], "<f4"),
        "error": told[:, :, 2].astype("<f4"),
        "geometric_error": np.array([r.geometric_error for r in records], "<f8"),
        "splats": np.array([record.splats for record in records], "<u4"),
        "worth": told[:, :, 1].astype("<f4"),
    }


def _content_columns(cells: list[_Cell]) -> dict[str, np.ndarray]:
    boxes = []
    for cell in cells:  # one box for all qualities, so that their indices share the subtrees
        contents = cell.record.contents
        low = np.min([entry.low for entry in contents], axis=0)
        boxes.append(box_numbers(low, np.max([entry.high for entry in contents], axis=0)))
    return {"content_box": np.array(boxes, "<f8")}


@final
class _SubtreeWriter:
    """Collects the bitstreams and property tables of an implicit subtree in one buffer."""

    def __init__(self) -> None:
        self._buffer_data = bytearray()
        self._buffer_views: list[dict[str, int]] = []

    def bits(self, indices: list[int], count: int) -> dict[str, int]:
        """Return the JSON of a subtree's availability bits: a constant, or a bitstream."""
        if len(indices) in (0, count):
            return {"constant": int(bool(indices))}
        flags = np.zeros(count, np.uint8)
        flags[indices] = 1
        packed = np.packbits(flags, bitorder="little").tobytes()
        return {"availableCount": len(indices), "bitstream": self._view(packed)}

    def table(self, name: str, count: int, columns: dict[str, np.ndarray]) -> JsonDict:
        """Append columns to a subtree's buffer, and return the JSON of their property table."""
        properties = {
            key: {"values": self._view(column.tobytes())} for key, column in columns.items()
        }
        return {"class": name, "count": count, "properties": properties}

    def _view(self, data: bytes) -> int:
        view = {"buffer": 0, "byteLength": len(data), "byteOffset": len(self._buffer_data)}
        self._buffer_views.append(view)
        self._buffer_data += data + bytes(-len(data) % _VIEW_ALIGNMENT)
        return len(self._buffer_views) - 1

    def file(self, document: JsonDict) -> bytes:
        """Return an implicit subtree as the bytes of a binary subtree file."""
        values = dict(document)
        if self._buffer_data:
            values["buffers"] = [{"byteLength": len(self._buffer_data)}]
            values["bufferViews"] = self._buffer_views
        text = json_bytes(values)
        text += b" " * (-len(text) % _VIEW_ALIGNMENT)
        header = _SUBTREE_HEADER.pack(b"subt", 1, len(text), len(self._buffer_data))
        return header + text + bytes(self._buffer_data)
