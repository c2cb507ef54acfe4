"""Levels of detail: chooses the cells in which a tile's splats are merged, and merges them."""

__all__ = ["Level", "choose_cells", "merge_level", "stored_degree"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Int64, UInt64

from gsgen.formats.shared.splats import SH_COUNTS
from gsgen.tiles.build.merging.mixture import Mixture
from gsgen.tiles.build.merging.moments import merge_clusters
from gsgen.tiles.build.merging.morton import DEPTH, cell_codes, separation_depths

REDUCTION: Final = 4
"""How many splats of the finer level one splat of a level replaces, on average."""

BAND_ENERGY: Final = 0.01
"""Harmonics of a degree that holds less than this share of the energy are not stored."""


RETAINED_SIZE: Final = 0.5
"""Splats whose standard deviation is more than this share of a cell may stay unmerged."""


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Level:
    """The merged splats of a tile, for one level of detail."""

    mixture: Mixture
    depth: int


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
    begun = np.cumsum(np.bincount(separation, minlength=DEPTH + 2))[: DEPTH + 1]
    occupied = 1 + begun[depth:]
    if depth < DEPTH:  # at the depth of the tile itself there is one cell
        occupied[0] = 1
    cell_depth = depth + int(np.argmin(np.abs(np.log(occupied / target))))
    starts = np.flatnonzero(separation <= cell_depth) + 1
    if cell_depth == depth:
        starts = starts[:0]
    return cell_depth, np.concatenate([np.zeros(1, np.int64), starts])


def merge_level(mixture: Mixture, depth: int, most: int, side: float) -> Level:
    """Merge the splats of a tile's children into the splats of the tile.

    Args:
        mixture: All splats that the children show, sorted by code.
        depth: Of the tile.
        most: Splats to aim at, at most.
        side: Of the root cube, in scene units.
    """
    target = max(1.0, min(len(mixture) / REDUCTION, most))
    # 1. Cells: as many as the level should have splats, within what powers of two allow.
    cell_depth, starts = choose_cells(mixture.code, depth, target)
    # 2. Where there are fewer cells, the largest splats stay as they are: merging splats
    #    as large as a cell saves little and blurs most.
    room = int(target) - len(starts)
    retained = _largest(mixture, side / (1 << cell_depth), room) if room > 0 else None
    if retained is not None and retained.any():
        cells = cell_codes(mixture.code, cell_depth)
        number = np.where(retained, np.arange(1, len(mixture) + 1), 0)
        order = np.lexsort((number, cells))
        mixture, cells, number = mixture.rows(order), cells[order], number[order]
        new = (cells[1:] != cells[:-1]) | (number[1:] != number[:-1])
        starts = np.concatenate([np.zeros(1, np.int64), np.flatnonzero(new) + 1])
    merged = merge_clusters(mixture, starts)
    # 3. A retained splat may have a code before that of the cluster beside it.
    merged = merged.rows(np.argsort(merged.code, kind="stable"))
    return Level(mixture=merged, depth=cell_depth)


def _largest(mixture: Mixture, cell: float, count: int) -> Bool[np.ndarray, " n"]:
    """Return the mask of at most ``count`` splats, the largest, that are large for a grid cell."""
    x, y, z = mixture.scale.T
    size = np.maximum(np.maximum(x, y), z)
    order = np.argsort(-size, kind="stable")[:count]
    retained = np.zeros(len(mixture), bool)
    retained[order] = size[order] > RETAINED_SIZE * cell
    return retained


def stored_degree(mixture: Mixture) -> int:
    """Return the SH degree worth storing: higher bands hold less than 1 % of the energy."""
    squares = np.square(mixture.sh, dtype=np.float64).sum(axis=2)
    energy = (squares * mixture.mass[:, None]).sum(axis=0)  # no BLAS: its order may vary
    total = float(energy.sum())
    degree = SH_COUNTS.index(mixture.sh.shape[1])
    while degree and float(energy[SH_COUNTS[degree - 1] :].sum()) < BAND_ENERGY * total:
        degree -= 1
    return degree
