"""Scans scene files in chunks: bounding box, splat count and digest, splats per octree cell.

A splat is *anchored* at the deepest level whose tiles are at least twice as long as its radius
of 3σ; there it stays, in an extra leaf, so that it is not in a tile far smaller than itself.
"""

__all__ = ["ChunkFacts", "anchor_depths", "count_cells", "location_codes", "scan_chunk"]

import hashlib
import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float32, Int64, UInt64

from gsgen.formats import Splats
from gsgen.formats.merging.morton import DEPTH, Cube, cell_codes, morton_codes
from gsgen.formats.shared.splat_values import valid_rows
from gsgen.formats.shared.splats import SPLAT_ARRAY_NAMES
from gsgen.tiles.build.source import BLOCK_ROWS, Chunk, read_chunk
from gsgen.tiles.gltf.encoding import EXTENT_SIGMAS

_SMALLEST_LOG_SCALE: Final = -1e3  # e^-1000 is 0, and JSON has no infinity


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkFacts:
    """The bounding box, the splat counts and the digests of a chunk of a scene file.

    Attributes:
        index: Of the chunk.
        count: Splats that can be drawn.
        skipped: Rows that cannot, which are left out.
        first_skipped: The first of them, as a row of the file; −1 without any.
        low: Least coordinates of the centres.
        high: Greatest coordinates of the centres.
        largest_scale: Logarithm of the largest standard deviation, −1000 or more.
        digests: SHA-256 of the values of every ``BLOCK_ROWS`` rows; independent of the chunk size.
    """

    index: int
    count: int
    skipped: int
    first_skipped: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    largest_scale: float
    digests: tuple[str, ...]


def scan_chunk(chunk: Chunk) -> ChunkFacts:
    """Read a chunk of a scene file; return its bounding box, splat counts and SHA-256 digests."""
    splats = read_chunk(chunk)
    valid_mask = valid_rows(splats)
    count = int(np.count_nonzero(valid_mask))
    low = high = np.zeros(3)
    largest_scale = 0.0
    if count:
        largest_scale = max(float(column[valid_mask].max()) for column in splats.log_scale.T)
        position = splats.position[valid_mask]
        columns = np.ascontiguousarray(position.T)
        low, high = columns.min(axis=1), columns.max(axis=1)
    skipped = len(valid_mask) - count
    return ChunkFacts(
        index=chunk.index,
        count=count,
        skipped=skipped,
        first_skipped=chunk.first + int(np.argmin(valid_mask)) if skipped else -1,
        low=(float(low[0]), float(low[1]), float(low[2])),
        high=(float(high[0]), float(high[1]), float(high[2])),
        largest_scale=max(largest_scale, _SMALLEST_LOG_SCALE),
        digests=tuple(_digest(splats, first) for first in range(0, len(splats), BLOCK_ROWS)),
    )


def _digest(splats: Splats, first: int) -> str:
    digest = hashlib.sha256()
    for name in SPLAT_ARRAY_NAMES:
        block = getattr(splats, name)[first : first + BLOCK_ROWS]
        digest.update(np.ascontiguousarray(block).data)
    return digest.hexdigest()


def anchor_depths(log_scale: Float32[np.ndarray, "n 3"], cube: Cube) -> Int64[np.ndarray, " n"]:
    """Return each splat's deepest octree level: the last whose tiles are at least 6σ long."""
    x, y, z = log_scale.T  # a maximum along rows of three would take ten times as long
    largest_scale = np.maximum(np.maximum(x, y), z).astype(np.float64)
    ratio = math.log(cube.side / (2 * EXTENT_SIGMAS)) - largest_scale
    with np.errstate(invalid="ignore"):
        depth = np.floor(ratio / math.log(2))
    return np.asarray(np.clip(depth, 0, DEPTH), np.int64)


def location_codes(
    codes: UInt64[np.ndarray, " n"], anchors: Int64[np.ndarray, " n"], depth: int
) -> UInt64[np.ndarray, " n"]:
    """Return each splat's octree cell: a 1, then a Morton code; large splats stay in coarse cells.

    The leading 1 makes the number name the depth, too (I. Gargantini 1982, "An effective way to
    represent quadtrees", in three dimensions).
    """
    levels = np.minimum(anchors, depth).astype(np.uint64)
    shift = np.uint64(3) * (np.uint64(DEPTH) - levels)
    return np.asarray(codes >> shift | np.uint64(1) << np.uint64(3) * levels)


def count_cells(
    chunk: Chunk,
    cube: Cube,
    depth: int,
    parent_cells: UInt64[np.ndarray, " c"] | None,
    parent_depth: int,
    *,
    is_anchored: bool,
) -> tuple[UInt64[np.ndarray, " m"], Int64[np.ndarray, " m"]]:
    """Count the splats of a scene chunk in each octree cell.

    Args:
        chunk: To be read.
        cube: The root cube.
        depth: Of the cells.
        parent_cells: Count only in these cells, sorted codes at ``parent_depth``; None for all.
        parent_depth: See ``parent_cells``.
        is_anchored: Whether large splats stay at the depth of their anchor.

    Returns:
        Location codes, increasing, and the count of each.
    """
    splats = read_chunk(chunk)
    valid_mask = valid_rows(splats)
    codes = morton_codes(splats.position[valid_mask], cube)
    anchors = (
        anchor_depths(splats.log_scale[valid_mask], cube)
        if is_anchored
        else np.full(len(codes), DEPTH, np.int64)
    )
    if parent_cells is not None:
        is_in_parent_cell = np.isin(cell_codes(codes, parent_depth), parent_cells)
        is_in_parent_cell &= anchors >= parent_depth
        codes, anchors = codes[is_in_parent_cell], anchors[is_in_parent_cell]
    cells, counts = np.unique(location_codes(codes, anchors, depth), return_counts=True)
    return cells, counts.astype(np.int64)
