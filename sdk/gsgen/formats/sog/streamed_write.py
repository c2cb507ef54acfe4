"""Writes streamed SOG: levels of detail in several SOG files, and a lod-meta.json of their rows.

The format is that of PlayCanvas (playcanvas/splat-transform, "Streamed SOG", version 1). Splats lie
in Morton order, so that each leaf of the tree is a range of them; its coarser levels are the same
splats, merged.
"""

__all__ = ["Chunks", "write_levels"]

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt64

from gsgen.contract.file_kinds.names import META_FILE
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.formats.shared.files import FilePath, make_folder, replace_file
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.splats import Splats

_TOP_BIT: Final = 47  # of a Morton code of three 16-bit numbers
_SPLAT_RATIO_OF_LEVELS: Final = 4  # splats of a level for each splat of the next one
_BOUND_DEVIATIONS: Final = 3

WriteSplats = Callable[[Path, Splats], None]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Chunks:
    """The number of levels of a streamed SOG, and the sizes of its files and leaves.

    Attributes:
        levels: Number of levels of detail; each has a quarter of the splats of the finer one.
        file_rows: Largest number of splats in a file.
        leaf_rows: Nodes of the tree with no more splats are leaves, however large.
        leaf_size: Largest side of other leaves, in scene units.
    """

    levels: int = 4
    file_rows: int = 1 << 19
    leaf_rows: int = 1 << 13
    leaf_size: float = 16.0


@dataclass(slots=True)
class _LeafNode:
    """A leaf of the tree: its entry in lod-meta.json, and a range of Morton-sorted splats."""

    node: dict[str, Any]
    splats: Splats


def write_levels(
    path: FilePath,
    splats: Splats,
    codes: UInt64[np.ndarray, " n"],
    write: WriteSplats,
    chunks: Chunks = Chunks(),
) -> None:
    """Write lod-meta.json, and before it the SOG files of all levels, in folders beside it.

    Args:
        path: The file lod-meta.json.
        splats: The finest level, valid and in the order of ``codes``.
        codes: Ascending Morton codes of the splats, of 48 bits.
        write: Writes the SOG of a meta.json, with the splats in their order.
        chunks: Levels and sizes.

    Raises:
        FileUnwritable: A file cannot be written.
    """
    leaves: list[_LeafNode] = []
    root = _node(splats, codes, _TOP_BIT, chunks, leaves)
    names: list[str] = []
    counts: list[int] = []
    for level in range(chunks.levels):
        counts.append(0)
        for index, members in enumerate(_files(leaves, level, chunks.file_rows)):
            offset = 0
            for leaf, part in members:
                entry = {"file": len(names), "offset": offset, "count": len(part)}
                leaf.node["lods"][str(level)] = entry
                offset += len(part)
            names.append(f"{level}_{index}/{META_FILE}")
            file = Path(path).parent / names[-1]
            make_folder(file)
            write(file, join_splats([part for _, part in members]))
            counts[-1] += offset
    document = {
        "version": 1,
        "asset": {
            "generator": "gsgen",
            "chunkGaussians": chunks.file_rows,
            "chunkExtent": chunks.leaf_size,
            "chunkMinGaussians": chunks.leaf_rows,
        },
        "count": sum(counts),
        "counts": counts,
        "lodLevels": chunks.levels,
        "filenames": names,
        "tree": root,
    }
    with replace_file(path) as stream:
        stream.write(json.dumps(document, separators=(",", ":")).encode())


def _node(
    splats: Splats,
    codes: UInt64[np.ndarray, " n"],
    bit: int,
    chunks: Chunks,
    leaves: list[_LeafNode],
) -> dict[str, Any]:
    """Return the tree's node of Morton-sorted splats; its leaves are appended to ``leaves``."""
    extent = np.ptp(splats.position, axis=0).max()
    is_large = len(splats) > chunks.leaf_rows and extent > chunks.leaf_size
    split_row = 0
    while (
        (is_large or len(splats) > chunks.file_rows) and bit >= 0 and not 0 < split_row < len(codes)
    ):
        # The cells that the next bit separates; a bit that all splats share separates none.
        split_row = int(np.searchsorted(codes >> np.uint64(bit) & np.uint64(1), 1))
        bit -= 1
    node: dict[str, Any] = {"bound": _bound(splats)}
    if 0 < split_row < len(codes):
        half_slices = (slice(None, split_row), slice(split_row, None))
        node["children"] = [
            _node(splats[half_slice], codes[half_slice], bit, chunks, leaves)
            for half_slice in half_slices
        ]
    else:
        node["lods"] = {}
        leaves.append(_LeafNode(node, splats))
    return node


def _files(
    leaves: Sequence[_LeafNode], level: int, file_rows: int
) -> Iterator[list[tuple[_LeafNode, Splats]]]:
    """Yield the leaves of each file of a level, with their splats at that level."""
    from gsgen.formats.merging.decimation import decimate

    members: list[tuple[_LeafNode, Splats]] = []
    file_splats = 0
    for leaf in leaves:
        if level:
            leaf.splats = decimate(leaf.splats, max(1, len(leaf.splats) // _SPLAT_RATIO_OF_LEVELS))
        if members and file_splats + len(leaf.splats) > file_rows:
            yield members
            members, file_splats = [], 0
        members.append((leaf, leaf.splats))
        file_splats += len(leaf.splats)
    yield members


def _bound(splats: Splats) -> dict[str, list[float]]:
    """Return the box of all splats' ellipsoids at three standard deviations."""
    variance = covariance_upper(np.exp(splats.log_scale), splats.rotation)[:, [0, 3, 5]]
    extents = _BOUND_DEVIATIONS * np.sqrt(variance)
    low, high = (splats.position - extents).min(axis=0), (splats.position + extents).max(axis=0)
    return {"min": low.astype(float).tolist(), "max": high.astype(float).tolist()}
