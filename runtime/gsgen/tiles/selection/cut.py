"""Selects the tiles that a camera sees and needs, by their screen-space error."""

__all__ = ["Cut", "cut_tree", "cut_tree_often"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.selection.frustum import Frustum, box_distances
from gsgen.tiles.selection.tile_tree import TileTree


@final
@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """The tiles that a camera sees, and the tiles to draw at the allowed pixel error.

    Attributes:
        seen: Tiles that meet the frustum and whose parents are all refined; from the root down.
        wanted: The seen tiles that are not refined: the finest that are worth drawing.
        error: Screen-space error of every tile, in pixels; infinite where the camera is inside.
    """

    seen: Bool[np.ndarray, " n"]
    wanted: Bool[np.ndarray, " n"]
    error: Float64[np.ndarray, " n"]


def cut_tree(
    tree: TileTree, frustum: Frustum, max_error: float, *, max_level: int | None = None
) -> Cut:
    """Return the tiles that a frustum sees, refined where the screen-space error is too large.

    Args:
        tree: The tiles.
        frustum: In the root frame.
        max_error: In pixels; a tile with children is refined above it.
        max_level: The finest level; all if None.
    """
    distance = frustum.distances(tree.center, tree.half_axes)
    error = frustum.screen_space_error(tree.error, distance)
    refined = (error > max_error) & ~tree.is_leaf
    if max_level is not None:
        refined &= tree.level < max_level
    seen = frustum.meets(tree.center, tree.half_axes)
    for rows in tree.rows_of_level[1:]:
        above = tree.parent[rows]
        seen[rows] &= seen[above] & refined[above]
    return Cut(seen=seen, wanted=seen & ~refined, error=error)


def cut_tree_often(
    tree: TileTree, frusta: Sequence[Frustum], max_error: float
) -> tuple[Int64[np.ndarray, " m"], Bool[np.ndarray, "f m"]]:
    """Return which tiles each of several frustums sees, testing only children of seen tiles.

    Args:
        tree: The tiles.
        frusta: Of perspective cameras with the same focal length and number of planes.
        max_error: In pixels.

    Returns:
        Rows of the tree, ascending within a level, and for each frustum which of them it sees.
    """
    planes = np.stack([frustum.planes for frustum in frusta])
    eyes = np.stack([frustum.eye for frustum in frusta])
    all_rows: list[Int64[np.ndarray, " m"]] = []
    all_seen: list[Bool[np.ndarray, "f m"]] = []
    refined = np.zeros((len(frusta), len(tree)), bool)
    for rows in tree.rows_of_level:
        open_below = np.ones((len(frusta), len(rows)), bool)
        if tree.parent[rows[0]] >= 0:
            open_below = refined[:, tree.parent[rows]]
            reached = open_below.any(axis=0)
            rows, open_below = rows[reached], open_below[:, reached]
        if not len(rows):
            break
        center, half = tree.center[rows], tree.half_axes[rows]
        vectors = np.concatenate([center[:, None], half], axis=1).reshape(-1, 3)
        products = vectors @ planes[:, :, :3].reshape(-1, 3).T
        products = products.reshape(len(rows), 4, *planes.shape[:2])
        reach = products[:, 0] + planes[:, :, 3] + np.abs(products[:, 1:]).sum(axis=1)
        seen = (reach >= 0).all(axis=2).T & open_below
        error = frusta[0].screen_space_error(tree.error[rows], box_distances(eyes, center, half))
        refined[:, rows] = seen & (error > max_error) & ~tree.is_leaf[rows]
        all_rows.append(rows)
        all_seen.append(seen)
    return np.concatenate(all_rows), np.concatenate(all_seen, axis=1)
