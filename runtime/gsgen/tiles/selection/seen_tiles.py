"""Formulates the optimisation problem of detail levels and file qualities for visible tiles.

The files of tiles above others are requested before those of finer levels: a finer level costs all
missing files above it, too. A tile with seen children therefore has one child more in this problem,
which stands for its own file.
"""

__all__ = ["SeenTiles"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.quality_ladder import QualityLadder
from gsgen.tiles.selection.cut import Cut
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.selection.tree_choice import CutOptions

_HALF_WORTH: Final = 228.0
"""Screen-space error in pixels that halves the worth of a tile: 12 pixels leave 0.95 of it."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenTiles:
    """The problem of choosing files of visible tiles within limits on bytes and Gaussians.

    Attributes:
        options: Costs in bytes, and utilities, of each quality; the last option draws nothing.
        splats: Gaussians of each option.
        tile: Tile of each node.
    """

    options: CutOptions
    splats: Int64[np.ndarray, "n q"]
    tile: Int64[np.ndarray, " n"]

    @classmethod
    def of_cut(
        cls,
        tree: TileTree,
        ladder: QualityLadder,
        cut: Cut,
        weight: Float64[np.ndarray, " m"],
        held: Int64[np.ndarray, " t"],
        dead: Bool[np.ndarray, " t"],
    ) -> "SeenTiles":
        """Formulate the optimisation problem of detail levels and qualities of visible tiles.

        Args:
            tree: The tiles.
            ladder: Their files.
            cut: Of the camera.
            weight: Share of the picture of each seen tile, in order of their keys.
            held: Quality of the file that is there or is on its way; -1 for none.
            dead: Tiles whose files cannot be had.
        """
        rows = np.flatnonzero(cut.seen)
        position = np.full(len(tree), -1)
        position[rows] = np.arange(len(rows))
        parent = np.where(tree.parent[rows] >= 0, position[tree.parent[rows]], -1)
        is_inner = np.bincount(parent[1:], minlength=len(rows)) > 0
        inner, adds = np.flatnonzero(is_inner), is_inner & tree.adds[rows]
        files = _file_costs(ladder.size[rows], held[rows], dead[rows])
        area = np.where(is_inner, 0.0, weight)
        for row in range(len(rows) - 1, 0, -1):
            area[parent[row]] += area[row]  # a tile covers what the seen tiles below it cover
        error = np.where(tree.is_leaf[rows], 0.0, cut.error[rows])
        splats = np.repeat(tree.splats[rows, None], files.shape[1], axis=1)
        # 1. Tiles are drawn at a quality, or not at all. Those that others join have no choice.
        tiles = _with_nothing(
            np.where(adds[:, None], np.inf, files),
            (area / (1 + error / _HALF_WORTH))[:, None] * ladder.worth,
            splats,
        )
        # 2. The file of a tile above others: drawn beside them, or the coarsest that is needed.
        above = _with_nothing(
            np.where(adds[:, None], files, np.inf)[inner],
            weight[inner, None] * ladder.worth,
            splats[inner],
        )
        coarsest = np.where(held[rows] >= 0, 0.0, files[:, -1])[inner]
        is_needed = ~adds[inner] & np.isfinite(coarsest)
        above[0][is_needed, -1] = coarsest[is_needed]
        above[2][is_needed, -1] = splats[inner[is_needed], 0]
        cost, utility, counts = (np.vstack(pair) for pair in zip(tiles, above, strict=True))
        return cls(
            options=CutOptions(np.concatenate([parent, inner]), cost, utility),
            splats=counts,
            tile=np.concatenate([rows, rows[inner]]),
        )


def _file_costs(
    size: Float64[np.ndarray, "m q"], held: Int64[np.ndarray, " m"], dead: Bool[np.ndarray, " m"]
) -> Float64[np.ndarray, "m q"]:
    """Return the bytes still to load for each file quality of tiles; infinite if unavailable."""
    cost = np.where(((held >= 0) | dead)[:, None], np.inf, size)
    rows = np.flatnonzero(held >= 0)
    cost[rows, held[rows]] = 0
    return np.asarray(cost)


def _with_nothing(
    cost: Float64[np.ndarray, "m q"],
    utility: Float64[np.ndarray, "m q"],
    splats: Int64[np.ndarray, "m q"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add the option of drawing nothing, without cost, to each tile's file qualities."""
    column = ((0, 0), (0, 1))
    return np.pad(cost, column), np.pad(utility, column), np.pad(splats, column)
