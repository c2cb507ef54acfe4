"""Reads streamed SOG: a lod-meta.json whose tree refers to rows of several SOG files.

The format is that of PlayCanvas (playcanvas/splat-transform, "Streamed SOG", version 1). A leaf
of the tree names the rows of a file for each level of detail; level 0 is the finest.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final, final

import numpy as np

from gsgen.contract.file_kinds.names import STREAMED_META
from gsgen.formats.shared.errors import HeaderMalformed, SizeExceeded, quoted
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.splats import SPLAT_ARRAY_NAMES, Splats

STREAMED_KEYS: Final = frozenset(
    {
        "asset",
        "count",
        "counts",
        "environment",
        "filenames",
        "lodErrors",
        "lodLevels",
        "tree",
        "version",
    }
)
"""The keys of a lod-meta.json that the tree needs, or that repeat its numbers."""

_MAX_DEPTH: Final = 64
_MAX_LEAVES: Final = 1 << 20


def is_streamed(data: dict[str, Any]) -> bool:
    """Return whether a parsed JSON object is the lod-meta.json of a streamed SOG."""
    return "lodLevels" in data or "tree" in data


@final
@dataclass(frozen=True, slots=True)
class LevelRows:
    """The rows of a SOG file that are a leaf at one level of detail."""

    file: int
    offset: int
    count: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StreamedLeaf:
    """A leaf of a streamed SOG's tree.

    Attributes:
        levels: Level → its rows, finest level first; at least one.
        bound: The lists ``min`` and ``max`` as the file has them.
        errors: The relative error of each level as the file has it: squared differences of
            pictures over their squares, 0 for the finest; None where it is not told.
    """

    levels: dict[int, LevelRows]
    bound: object
    errors: object


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StreamedTree:
    """The files and leaves of a streamed SOG; names are relative to the folder of its JSON.

    Attributes:
        files: The SOG files.
        leaves: Of the tree, depth first.
        environment: The SOG file that is always drawn; None for none.
    """

    files: tuple[str, ...]
    leaves: tuple[StreamedLeaf, ...]
    environment: str | None


def read_tree(data: dict[str, Any]) -> StreamedTree:
    """Return the files and leaves that a parsed lod-meta.json names.

    Raises:
        HeaderMalformed: The tree breaks the rules of the format.
    """
    names = data.get("filenames")
    if not isinstance(names, list) or not all(_is_inside(name) for name in names):
        raise HeaderMalformed(
            quoted(str(names)),
            where=f"{STREAMED_META}, filenames",
            expected="names below its folder",
        )
    environment = data.get("environment")
    if environment is not None and not _is_inside(environment):
        raise HeaderMalformed(quoted(str(environment)), where=f"{STREAMED_META}, environment")
    leaves = tuple(
        StreamedLeaf(
            levels=_levels(node.get("lods"), len(names)),
            bound=node.get("bound"),
            errors=node.get("errors"),
        )
        for node in _leaves(data.get("tree"))
    )
    return StreamedTree(files=tuple(names), leaves=leaves, environment=environment)


def read_levels(data: dict[str, Any], read: Callable[[str, int], Splats], max_bytes: int) -> Splats:
    """Return the splats of a streamed SOG at the finest level of detail.

    Args:
        data: The parsed lod-meta.json.
        read: Reads the SOG of a name, if it takes no more than so many bytes.
        max_bytes: The limit of the memory of all splats, in bytes.

    Raises:
        HeaderMalformed: The tree breaks the rules of the format.
        SizeExceeded: The splats need more than ``max_bytes``.
    """
    tree = read_tree(data)
    names = tree.files
    ranges: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for leaf in tree.leaves:
        finest = next(iter(leaf.levels.values()))
        ranges[finest.file].append((finest.offset, finest.count))
    parts: list[Splats] = []
    for index in sorted(ranges):
        used_bytes = sum(_splat_bytes(part) for part in parts)
        splats = read(names[index], max_bytes - used_bytes)
        rows = [np.arange(offset, offset + count) for offset, count in sorted(ranges[index])]
        selected = np.concatenate(rows)
        where = f"{STREAMED_META}, tree"
        if selected[-1] >= len(splats):
            raise HeaderMalformed(
                f"the level-of-detail tree lists splat {selected[-1]} of {quoted(names[index])}",
                where=where,
                expected=f"splats from 0 to {len(splats) - 1}, as that file has",
            )
        if len(np.unique(selected)) < len(selected):
            raise HeaderMalformed(
                f"the level-of-detail tree lists splats of {quoted(names[index])} twice",
                where=where,
                expected="each splat once",
            )
        parts.append(splats[selected])
    if tree.environment is not None:
        parts.append(read(tree.environment, max_bytes - sum(_splat_bytes(part) for part in parts)))
    if sum(_splat_bytes(part) for part in parts) > max_bytes:
        raise SizeExceeded(
            "the splats of all files take more memory than allowed",
            expected=f"{max_bytes} bytes or fewer",
        )
    return join_splats(parts)


def _splat_bytes(splats: Splats) -> int:
    return sum(getattr(splats, name).nbytes for name in SPLAT_ARRAY_NAMES)


def _is_inside(name: object) -> bool:
    """Return whether a file name is a relative path inside the folder."""
    if not isinstance(name, str) or not name or "\0" in name or "\\" in name:
        return False
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and ":" not in path.parts[0]


def _leaves(root: object) -> Iterator[dict[str, Any]]:
    nodes: list[tuple[object, int]] = [(root, 0)]
    count = 0
    while nodes:
        node, depth = nodes.pop()
        count += 1
        where = f"{STREAMED_META}, tree"
        if not isinstance(node, dict):
            actual = f"node {count} of the tree is a {type(node).__name__}"
            raise HeaderMalformed(actual, where=where, expected="an object")
        if depth > _MAX_DEPTH:
            actual = f"node {count} of the tree is at depth {depth}"
            raise HeaderMalformed(actual, where=where, expected=f"a depth of {_MAX_DEPTH} or less")
        if count > _MAX_LEAVES:
            actual = f"the tree has {count:,} nodes or more"
            raise HeaderMalformed(actual, where=where, expected=f"at most {_MAX_LEAVES:,}")
        children = node.get("children")
        if isinstance(children, list) and children:
            nodes += [(child, depth + 1) for child in reversed(children)]
        else:
            yield node


def _levels(lods: object, files: int) -> dict[int, LevelRows]:
    """Return the rows of each level of a leaf, finest level first; levels without rows are left out."""
    levels: dict[int, LevelRows] = {}
    entries = lods if isinstance(lods, dict) else {}
    for key in sorted(filter(str.isdecimal, entries), key=int):
        entry = entries[key]
        values: list[int] = []
        if isinstance(entry, dict):
            members = [entry.get(name) for name in ("file", "offset", "count")]
            values = [value for value in members if type(value) is int and value >= 0]
        if len(values) != 3 or values[0] >= files or sum(values[1:]) >= 1 << 31:
            raise HeaderMalformed(
                quoted(str(entry)),
                where=f"{STREAMED_META}, lods",
                expected=f"file, offset and count of a level, in one of {files} files",
            )
        if values[2]:
            levels[int(key)] = LevelRows(*values)
    if not levels:
        raise HeaderMalformed(
            quoted(str(lods)), where=f"{STREAMED_META}, lods", expected="a level with rows"
        )
    return levels
