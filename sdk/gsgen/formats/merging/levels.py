"""Levels of detail: chooses grid cells in which a tile's splats are merged, and merges them."""

__all__ = ["Level", "choose_cells", "geometric_error", "merge_level", "stored_degree"]

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt64

from gsgen.formats.merging.mixture import Mixture
from gsgen.formats.merging.moments import merge_clusters, squared_shift
from gsgen.formats.merging.morton import DEPTH, cell_codes, separation_depths
from gsgen.formats.shared.splats import SH_COUNTS

LEVEL_REDUCTION: Final = 4
"""How many splats of the finer level one splat of a level replaces, on average."""

BAND_ENERGY: Final = 0.01
"""Harmonics of a degree that holds less than this share of the energy are not stored."""

RETAINED_MASS: Final = 0.5
"""Coarser cells are chosen where the unmerged splats beside them hold this share of the mass."""


ERROR_PER_SHIFT: Final = 11.0
"""Geometric error, in the root of the mean squared shift of the splats that were merged.

Rendered views of a town reach SSIM 0.95 where a cell in which splats are merged is 4 pixels (8 give
0.90), and merging moves them by 0.36 of a cell. Viewers refine at 16 pixels of error unless told
otherwise, so that eleven shifts make that the default.
"""


def geometric_error(squared_shift: float) -> float:
    """Return the geometric error of splats that merging has moved, in scene units."""
    return ERROR_PER_SHIFT * math.sqrt(squared_shift)


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Level:
    """The merged splats of a tile, for one level of detail.

    Attributes:
        mixture: The splats.
        depth: Of the cells in which they were merged.
        squared_shift: How far merging moved the children's splats, in scene units².
    """

    mixture: Mixture
    depth: int
    squared_shift: float


def choose_cells(
    code: UInt64[np.ndarray, " n"], depth: int, target: float
) -> tuple[int, Int64[np.ndarray, " m"]]:
    """Choose a grid cell size with which splats occupy about ``target`` cells.

    The side of a cell is that of the tile divided by a power of two: lattices of tiles nest, and
    no cell crosses the edge of a tile.

    Returns:
        The depth of the cells, and the first row of each occupied one.
    """
    separation = np.maximum(separation_depths(code), depth)
    # Rows that begin a cell at depth d are those that separate at d or before.
    started_cells = np.cumsum(np.bincount(separation, minlength=DEPTH + 2))[: DEPTH + 1]
    cell_counts = 1 + started_cells[depth:]
    if depth < DEPTH:  # at the depth of the tile itself there is one cell
        cell_counts[0] = 1
    cell_depth = depth + int(np.argmin(np.abs(np.log(cell_counts / target))))
    starts = np.flatnonzero(separation <= cell_depth) + 1
    if cell_depth == depth:
        starts = starts[:0]
    return cell_depth, np.concatenate([np.zeros(1, np.int64), starts])


def merge_level(mixture: Mixture, depth: int, most: int) -> Level:
    """Merge the splats of a tile's children into the splats of the tile.

    Args:
        mixture: All splats that the children show, sorted by code.
        depth: Of the tile.
        most: Splats to aim at, at most.
    """
    target = max(1.0, min(len(mixture) / LEVEL_REDUCTION, most))
    mass = mixture.mass
    # 1. Cells: as many as the level should have splats, within what powers of two allow.
    cell_depth, starts = choose_cells(mixture.code, depth, target)
    retained_mask = _select_largest_splats(mass, starts, int(target))
    # 2. Where these cells are too many, coarser ones leave room for the largest splats. They are
    #    better where these splats are most of what is seen: merging large splats blurs most.
    if len(starts) > target and cell_depth > depth:
        coarse_starts = _cell_starts(cell_codes(mixture.code, cell_depth - 1))
        is_unmerged = _select_largest_splats(mass, coarse_starts, int(target))
        if float(mass[is_unmerged].sum()) > RETAINED_MASS * float(mass.sum()):
            cell_depth, starts, retained_mask = cell_depth - 1, coarse_starts, is_unmerged
    # 3. The largest splats stay as they are: each becomes a cluster of its own.
    if retained_mask.any():
        cells = _cell_numbers(starts, len(mixture))
        number = np.where(retained_mask, np.arange(1, len(mixture) + 1), 0)
        order = np.lexsort((number, cells))
        mixture, cells, number = mixture.rows(order), cells[order], number[order]
        is_new_cluster = (cells[1:] != cells[:-1]) | (number[1:] != number[:-1])
        starts = np.concatenate([np.zeros(1, np.int64), np.flatnonzero(is_new_cluster) + 1])
    merged_mixture, shift = merge_clusters(mixture, starts), squared_shift(mixture, starts)
    # 4. A retained splat may have a code before that of the cluster beside it.
    merged_mixture = merged_mixture.rows(np.argsort(merged_mixture.code, kind="stable"))
    return Level(mixture=merged_mixture, depth=cell_depth, squared_shift=shift)


def _cell_starts(cells: UInt64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    """Return the index of the first row of each grid cell, in rows sorted by cell."""
    return np.concatenate([np.zeros(1, np.int64), np.flatnonzero(cells[1:] != cells[:-1]) + 1])


def _cell_numbers(starts: Int64[np.ndarray, " m"], count: int) -> Int64[np.ndarray, " n"]:
    """Return the index of each splat's grid cell, for splats that are sorted by grid cell."""
    return np.repeat(np.arange(len(starts)), np.diff(starts, append=count))


def _select_largest_splats(
    mass: Float64[np.ndarray, " n"], starts: Int64[np.ndarray, " m"], count: int
) -> Bool[np.ndarray, " n"]:
    """Return the mask of the largest splats to keep unmerged, for a level of ``count`` splats.

    A splat that stays adds one to the level, except the last of its cell.

    Args:
        mass: Opacity times surface of each splat.
        starts: First row of each cell.
        count: Splats of the level, those of the cells included.
    """
    retained_mask = np.zeros(len(mass), bool)
    if count <= len(starts):
        return retained_mask
    # 1. No more than ``count`` can stay: sort these alone.
    threshold = np.partition(mass, len(mass) - count)[len(mass) - count]
    rows = np.flatnonzero(mass >= threshold)
    rows = rows[np.argsort(-mass[rows], kind="stable")[:count]]
    # 2. How many of its cell have gone before each row.
    cell = _cell_numbers(starts, len(mass))[rows]
    order_by_cell = np.argsort(cell, kind="stable")
    run = _cell_starts(cell[order_by_cell])
    rank = np.empty(len(rows), np.int64)
    rank[order_by_cell] = np.arange(len(rows)) - np.repeat(run, np.diff(run, append=len(rows)))
    is_candidate_added = rank + 1 < np.diff(starts, append=len(mass))[cell]
    # 3. As many as there is room for.
    retained_count = np.searchsorted(
        np.cumsum(is_candidate_added), count - len(starts), side="right"
    )
    retained_mask[rows[:retained_count]] = True
    return retained_mask


def stored_degree(mixture: Mixture) -> int:
    """Return the SH degree worth storing: higher bands hold less than 1 % of the energy."""
    squares = np.square(mixture.sh, dtype=np.float64).sum(axis=2)
    sh_energy = (squares * mixture.mass[:, None]).sum(axis=0)  # no BLAS: its order may vary
    total = float(sh_energy.sum())
    degree = SH_COUNTS.index(mixture.sh.shape[1])
    while degree and float(sh_energy[SH_COUNTS[degree - 1] :].sum()) < BAND_ENERGY * total:
        degree -= 1
    return degree
