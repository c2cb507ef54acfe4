"""Selects the tiles that a camera sees and needs, by their screen-space error."""

__all__ = ["TileCut", "cut_tree"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree


@final
@dataclass(frozen=True, slots=True, eq=False)
class TileCut:
    """The tiles that a camera sees, and the tiles to draw at the allowed pixel error.

    Attributes:
        seen: Tiles that meet the frustum and whose parents are all refined; from the root down.
        selected: The seen tiles that are not refined: the finest that are worth drawing.
        error: Screen-space error of every tile, in pixels; infinite where the camera is inside.
    """

    seen: Bool[np.ndarray, " n"]
    selected: Bool[np.ndarray, " n"]
    error: Float64[np.ndarray, " n"]


def cut_tree(
    tree: TileTree, frustum: Frustum, max_error: float, *, max_level: int | None = None
) -> TileCut:
    """Return the tiles that a frustum sees, refined where the screen-space error is too large.

    Args:
        tree: The tiles.
        frustum: In the root frame.
        max_error: In pixels; a tile with children is refined above it.
        max_level: The finest level; all if None.
    """
    distance = frustum.distances(tree.center, tree.half_axes)
    error = frustum.screen_space_error(tree.error, distance)
    is_refined = (error > max_error) & ~tree.is_leaf
    if max_level is not None:
        is_refined &= tree.level < max_level
    seen = frustum.intersects(tree.center, tree.half_axes)
    for rows in tree.rows_of_level[1:]:
        parent_rows = tree.parent[rows]
        seen[rows] &= seen[parent_rows] & is_refined[parent_rows]
    return TileCut(seen=seen, selected=seen & ~is_refined, error=error)
