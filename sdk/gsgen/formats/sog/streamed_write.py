"""Writes streamed SOG: levels of detail in several SOG files, and a lod-meta.json of their rows.

The format is that of PlayCanvas (playcanvas/splat-transform, "Streamed SOG", version 1). Splats lie
in Morton order, so that each leaf of the tree is a range of them; its coarser levels are the same
splats, merged. The error of a level is the square of its geometric error (see `geometric_error`) in
units of the leaf's diagonal: a reader takes it for the relative squared error of a picture.
"""

__all__ = ["Chunks", "LeafNode", "level_files", "streamed_document", "write_levels"]

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


@final
@dataclass(slots=True)
class LeafNode:
    """A leaf of the tree: its entry in lod-meta.json, and its splats at a level of detail.

    Attributes:
        node: The entry: bound, rows and error of each level.
        splats: Of the level that was written last; first those of the scene, in Morton order.
        squared_shift: How far merging has moved them, in scene units².
    """

    node: dict[str, Any]
    splats: Splats
    squared_shift: float = 0.0

    @classmethod
    def of_splats(cls, splats: Splats) -> "LeafNode":
        """Return the leaf of some splats, without levels."""
        return cls({"bound": _bound(splats), "errors": [], "lods": {}}, splats)

    def merge(self) -> None:
        """Replace the splats by those of the next coarser level."""
        from gsgen.formats.merging.decimation import decimate_measured

        count = max(1, len(self.splats) // _SPLAT_RATIO_OF_LEVELS)
        self.splats, squared_shift = decimate_measured(self.splats, count)
        self.squared_shift += squared_shift

    def add_level(self, level: int, file: int, offset: int) -> None:
        """Record that the splats are rows of a file from ``offset`` on."""
        from gsgen.formats.merging.levels import geometric_error

        low, high = (np.array(self.node["bound"][key]) for key in ("min", "max"))
        diagonal = float(np.linalg.norm(high - low))
        share = geometric_error(self.squared_shift) / diagonal if diagonal else 0.0
        self.node["errors"].append(float(f"{share**2:.7g}"))
        rows = {"file": file, "offset": offset, "count": len(self.splats)}
        self.node["lods"][str(level)] = rows


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
    leaves: list[LeafNode] = []
    root = _node(splats, codes, _TOP_BIT, chunks, leaves)
    names: list[str] = []
    counts: list[int] = []
    for level in range(chunks.levels):
        counts.append(0)
        for index, splats in enumerate(level_files(leaves, level, len(names), chunks.file_rows)):
            names.append(f"{level}_{index}/{META_FILE}")
            file = Path(path).parent / names[-1]
            make_folder(file)
            write(file, splats)
            counts[-1] += len(splats)
    with replace_file(path) as stream:
        stream.write(streamed_document(root, names, counts, chunks))


def streamed_document(
    root: dict[str, Any], names: list[str], counts: list[int], chunks: Chunks
) -> bytes:
    """Return a lod-meta.json.

    Args:
        root: The tree.
        names: The SOG files, relative to its folder.
        counts: Splats of each level.
        chunks: Levels and sizes.
    """
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
        "lodErrors": True,
        "filenames": names,
        "tree": root,
    }
    return json.dumps(document, separators=(",", ":")).encode()


def _node(
    splats: Splats,
    codes: UInt64[np.ndarray, " n"],
    bit: int,
    chunks: Chunks,
    leaves: list[LeafNode],
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
    if 0 < split_row < len(codes):
        half_slices = (slice(None, split_row), slice(split_row, None))
        children = [
            _node(splats[half_slice], codes[half_slice], bit, chunks, leaves)
            for half_slice in half_slices
        ]
        return {"bound": _bound(splats), "children": children}
    leaves.append(LeafNode.of_splats(splats))
    return leaves[-1].node


def level_files(
    leaves: Sequence[LeafNode], level: int, first_file: int, file_rows: int
) -> Iterator[Splats]:
    """Yield the splats of each file of a level, whose rows and errors the leaves record.

    Args:
        leaves: With their splats of the level before; of level 0, of the scene.
        level: 0 is the finest.
        first_file: Number of the first file.
        file_rows: Largest number of splats in a file; a leaf may have more.
    """
    file, members, offset = first_file, list[Splats](), 0
    for leaf in leaves:
        if level:
            leaf.merge()
        if members and offset + len(leaf.splats) > file_rows:
            yield join_splats(members)
            file, members, offset = file + 1, [], 0
        leaf.add_level(level, file, offset)
        members.append(leaf.splats)
        offset += len(leaf.splats)
    yield join_splats(members)


def _bound(splats: Splats) -> dict[str, list[float]]:
    """Return the box of all splats' ellipsoids at three standard deviations."""
    variance = covariance_upper(np.exp(splats.log_scale), splats.rotation)[:, [0, 3, 5]]
    extents = _BOUND_DEVIATIONS * np.sqrt(variance)
    low, high = (splats.position - extents).min(axis=0), (splats.position + extents).max(axis=0)
    return {"min": low.astype(float).tolist(), "max": high.astype(float).tolist()}
