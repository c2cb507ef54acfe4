"""Reads streamed SOG: a lod-meta.json whose tree refers to rows of several SOG files.

The format is that of PlayCanvas (playcanvas/splat-transform, "Streamed SOG", version 1). A leaf
of the tree names the rows of a file for each level of detail; level 0 is the finest.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import PurePosixPath
from typing import Any, Final

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
    names = data.get("filenames")
    if not isinstance(names, list) or not all(_is_inside(name) for name in names):
        raise HeaderMalformed(
            quoted(str(names)),
            where=f"{STREAMED_META}, filenames",
            expected="names below its folder",
        )
    ranges: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for leaf in _leaves(data.get("tree")):
        index, offset, count = _finest_leaf_range(leaf, len(names))
        ranges[index].append((offset, count))
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
    environment = data.get("environment")
    if environment is not None:
        if not _is_inside(environment):
            raise HeaderMalformed(quoted(str(environment)), where=f"{STREAMED_META}, environment")
        parts.append(read(environment, max_bytes - sum(_splat_bytes(part) for part in parts)))
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


def _finest_leaf_range(leaf: dict[str, Any], files: int) -> tuple[int, int, int]:
    """Return file index, first row and row count of the finest level of a streamed SOG's leaf."""
    levels = leaf.get("lods")
    numbers = [key for key in levels if key.isdecimal()] if isinstance(levels, dict) else []
    entry = levels[min(numbers, key=int)] if isinstance(levels, dict) and numbers else None
    values: list[int] = []
    if isinstance(entry, dict):
        members = [entry.get(key) for key in ("file", "offset", "count")]
        values = [value for value in members if type(value) is int and value >= 0]
    if len(values) != 3:
        raise HeaderMalformed(
            quoted(str(levels)),
            where=f"{STREAMED_META}, lods",
            expected="file, offset and count of a level",
        )
    index, offset, count = values
    if index >= files or count < 1 or offset + count >= 1 << 31:
        raise HeaderMalformed(
            quoted(str(entry)),
            where=f"{STREAMED_META}, lods",
            expected=f"one of {files} files, and rows",
        )
    return index, offset, count
