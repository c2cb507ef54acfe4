"""Reads subtrees of implicit tilesets: the availability of tiles, contents and subtrees.

3D Tiles 1.1, section "Implicit Tiling", "Subtrees". A subtree of L levels over a tree whose
tiles have N children holds a bit for each of (N^L − 1) / (N − 1) tiles, level by level, within
a level along Morton's curve; bits are packed lowest first.
"""

__all__ = ["Subtree", "read_subtree", "tile_count"]

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool

from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.implicit_tiling.property_table import PropertyClass, read_property_table
from gsgen.tiles.format.json_values import MAX_JSON, JsonDict, JsonObject, parse_object

MAX_BITS: Final = 1 << 24
"""How many tiles a subtree may have."""

_SUBTREE_HEADER = struct.Struct("<4sIQQ")
_SUBTREE_MAGIC = b"subt"
_SUBTREE_VERSION = 1

BitArray = Bool[np.ndarray, " n"]
ReadBuffer = Callable[[str, str, int], bytes]
"""Takes a uri, the location it stands at and the bytes that are needed."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Subtree:
    """The availability and the metadata of the tiles of an implicit subtree.

    Attributes:
        tiles: Which tiles there are.
        contents: The same of each of a tile's contents.
        subtrees: Which further subtrees hang below the last level.
        properties: Property or semantic name → values of the tiles that there are.
        content_properties: The same of each of the contents that there are.
    """

    tiles: BitArray
    contents: tuple[BitArray, ...]
    subtrees: BitArray
    properties: dict[str, np.ndarray]
    content_properties: tuple[dict[str, np.ndarray], ...]


def tile_count(branching: int, levels: int) -> int:
    """Return the number of tiles of a full quadtree or octree subtree of some levels."""
    return int((branching**levels - 1) // (branching - 1))


def read_subtree(
    data: bytes,
    location: str,
    *,
    branching: int,
    levels: int,
    classes: dict[str, PropertyClass],
    read_buffer: ReadBuffer,
    inspect: Callable[[JsonObject], None],
) -> Subtree:
    """Read a subtree of an implicit tileset, binary or JSON.

    Args:
        data: The file.
        location: The file's name, for errors.
        branching: Children of a tile: 4 or 8.
        levels: Of a subtree, as the tileset says.
        classes: The metadata classes of the tileset.
        read_buffer: Reads a buffer that lies in a file of its own.
        inspect: Called with the subtree's JSON before it is read.
    """
    document, binary = _split_chunks(data, location)
    inspect(document)
    reader = _Reader(document, binary, read_buffer)
    count = tile_count(branching, levels)
    tiles = reader.availability(document.child("tileAvailability"), count)
    contents = tuple(
        reader.availability(entry, count) for entry in document.objects("contentAvailability")
    )
    below = reader.availability(document.child("childSubtreeAvailability"), branching**levels)
    _check_tree(document, tiles, contents, below, branching)
    tables = list(document.objects("propertyTables"))
    return Subtree(
        tiles=tiles,
        contents=contents,
        subtrees=below,
        properties=reader.table(tables, document, "tileMetadata", int(tiles.sum()), classes),
        content_properties=_content_tables(reader, tables, document, contents, classes),
    )


def _content_tables(
    reader: "_Reader",
    tables: list[JsonObject],
    document: JsonObject,
    contents: tuple[BitArray, ...],
    classes: dict[str, PropertyClass],
) -> tuple[dict[str, np.ndarray], ...]:
    indices = document.values.get("contentMetadata", [])
    if not isinstance(indices, list) or len(indices) not in (0, len(contents)):
        document.refuse("contentMetadata", "a property table for each of the contents")
    return tuple(
        reader.table(
            tables,
            JsonObject({"table": index}, document.at("contentMetadata"), Fault.SUBTREE),
            "table",
            int(bits.sum()),
            classes,
        )
        for index, bits in zip(indices, contents, strict=False)
    )


def _split_chunks(data: bytes, location: str) -> tuple[JsonObject, bytes]:
    """Return the JSON and the binary chunk of a subtree file."""
    if data[:4] != _SUBTREE_MAGIC:
        document = parse_object(data, f"{location}, ", fault=Fault.SUBTREE)
        return document, b""
    if len(data) < _SUBTREE_HEADER.size:
        raise _mismatch_error(
            f"the subtree file has {len(data)} bytes",
            location,
            f"a header of {_SUBTREE_HEADER.size}",
        )
    _, version, json_size, binary_size = _SUBTREE_HEADER.unpack_from(data)
    if version != _SUBTREE_VERSION:
        raise _mismatch_error(
            f"the subtree version is {version}", f"{location}, byte 4", f"{_SUBTREE_VERSION}"
        )
    whole = _SUBTREE_HEADER.size + json_size + binary_size
    if whole != len(data) or json_size > MAX_JSON:
        raise _mismatch_error(
            f"the subtree file has {len(data)} bytes",
            f"{location}, byte 8",
            f"{whole}: the header, {json_size} of JSON and {binary_size} of data",
        )
    start = _SUBTREE_HEADER.size + json_size
    document = parse_object(
        data[_SUBTREE_HEADER.size : start], f"{location}, ", fault=Fault.SUBTREE
    )
    return document, data[start:]


def _mismatch_error(actual: str, location: str, expected: str) -> TilesetInvalid:
    return TilesetInvalid(actual, location=location, expected=expected, fault=Fault.SUBTREE)


def _check_tree(
    document: JsonObject,
    tiles: BitArray,
    contents: tuple[BitArray, ...],
    below: BitArray,
    branching: int,
) -> None:
    """Raise for subtree tiles without a parent, and contents or subtrees of unavailable tiles."""
    location = document.location.removesuffix(", ")
    if not tiles[0]:
        raise _mismatch_error(
            "the root tile of the subtree is not available", location, "a subtree with a root"
        )
    parents = (np.arange(1, len(tiles)) - 1) // branching
    orphan_tiles = np.flatnonzero(tiles[1:] & ~tiles[parents])
    if len(orphan_tiles):
        raise _mismatch_error(
            f"tile {orphan_tiles[0] + 1} is available, but its parent is not",
            document.at("tileAvailability"),
            "a tree",
        )
    for bits in contents:
        orphan_contents = np.flatnonzero(bits & ~tiles)
        if len(orphan_contents):
            raise _mismatch_error(
                f"content {orphan_contents[0]} is available, but its tile is not",
                document.at("contentAvailability"),
                "content of available tiles only",
            )
    last = tiles[-(len(below) // branching) :]
    orphan_subtrees = np.flatnonzero(below & ~np.repeat(last, branching))
    if len(orphan_subtrees):
        raise _mismatch_error(
            f"child subtree {orphan_subtrees[0]} is below a tile that is not available",
            document.at("childSubtreeAvailability"),
            "subtrees of available tiles only",
        )


@final
class _Reader:
    """Reads the buffers, buffer views, bitstreams and tables of one implicit subtree."""

    def __init__(self, document: JsonObject, binary: bytes, read: ReadBuffer) -> None:
        self._binary, self._read = binary, read
        self._buffers = list(document.objects("buffers"))
        self._buffer_views = list(document.objects("bufferViews"))
        self._loaded_buffers: dict[int, bytes] = {}

    def availability(self, entry: JsonObject, count: int) -> BitArray:
        """Read ``count`` availability bits of a subtree, stored as one constant or a bitstream."""
        if count > MAX_BITS:
            raise _mismatch_error(
                f"the subtree has {count:,} tiles", entry.location, f"{MAX_BITS:,} or fewer"
            )
        if "constant" in entry:
            return np.full(count, bool(entry.whole("constant", most=1)))
        key = "bitstream" if "bitstream" in entry else "bufferView"  # of drafts
        data = self.view(entry, key)
        size = (count + 7) // 8
        if len(data) < size:
            actual = f"the bitstream has {len(data)} bytes"
            raise _mismatch_error(actual, entry.at(key), f"{size}, a bit for each of {count}")
        packed = np.frombuffer(data[:size], np.uint8)
        bits = np.unpackbits(packed, bitorder="little")[:count].astype(bool)
        if "availableCount" in entry:
            declared = entry.whole("availableCount")
            if declared != int(bits.sum()):
                actual = f"availableCount is {declared}"
                raise _mismatch_error(
                    actual, entry.at("availableCount"), f"{int(bits.sum())} set bits"
                )
        return np.asarray(bits)

    def view(self, entry: JsonObject, key: str) -> bytes:
        """Return the bytes of a subtree's buffer view, whose number is the JSON member ``key``."""
        index = entry.whole(key)
        if index >= len(self._buffer_views):
            entry.refuse(key, f"less than {len(self._buffer_views)}, the number of buffer views")
        view = self._buffer_views[index]
        start, size = view.whole("byteOffset"), view.whole("byteLength")
        data = self._read_buffer(view)
        if start + size > len(data):
            raise _mismatch_error(
                f"the buffer view ends at byte {start + size}",
                view.location,
                f"{len(data)} or less",
            )
        return data[start : start + size]

    def _read_buffer(self, view: JsonObject) -> bytes:
        index = view.whole("buffer")
        if index >= len(self._buffers):
            view.refuse("buffer", f"less than {len(self._buffers)}, the number of buffers")
        if index not in self._loaded_buffers:
            entry = self._buffers[index]
            size = entry.whole("byteLength")
            data = self._binary
            if "uri" in entry:
                data = self._read(entry.text("uri"), entry.at("uri"), size)
            if len(data) < size:
                raise _mismatch_error(
                    f"the buffer of the subtree has {len(data)} bytes", entry.location, f"{size}"
                )
            self._loaded_buffers[index] = data[:size]
        return self._loaded_buffers[index]

    def table(
        self,
        tables: list[JsonObject],
        parent_object: JsonObject,
        key: str,
        count: int,
        classes: dict[str, PropertyClass],
    ) -> dict[str, np.ndarray]:
        """Return the columns of a subtree's property table; empty if there is no property table."""
        if key not in parent_object:
            return {}
        index = parent_object.whole(key)
        if index >= len(tables):
            parent_object.refuse(key, f"less than {len(tables)}, the number of property tables")
        columns: JsonDict = read_property_table(tables[index], count, classes, self.view)
        return columns
