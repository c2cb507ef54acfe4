"""Chooses the tiles to draw while better tiles arrive, without holes, and fades tiles."""

__all__ = ["FADE_SECONDS", "TileFades", "drawable_tiles"]

from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.tiles.selection.cut import TileCut
from gsgen.tiles.selection.tile_tree import TileTree

FADE_SECONDS: Final = 0.25
MAX_STEP_SECONDS: Final = 1 / 15
"""Of a frame: a window that stood still draws its next one late, and a fade is not over then."""


def drawable_tiles(
    tree: TileTree, cut: TileCut, resident: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return the loaded tiles to draw in place of the wanted tiles, so that no hole appears.

    Tiles below replace a tile only when all of them that are seen can be shown: by themselves, or
    by tiles below them. Where neither a tile nor all below it are there, those that are there are
    drawn: a part is better than a hole.

    Args:
        tree: The tiles.
        cut: Of the camera.
        resident: Tiles that are there; those without content always are.
    """
    seen, is_refined = cut.seen, cut.seen & ~cut.selected
    # 1. From the leaves up: can all that is seen below a tile be shown, at some level?
    is_drawable, are_children_drawable = seen & resident, np.zeros(len(tree), bool)
    for rows in reversed(tree.rows_of_level[1:]):
        rows = rows[seen[rows]]
        parent_rows = tree.parent[rows]
        are_children_drawable[parent_rows] = True
        are_children_drawable[parent_rows[~is_drawable[rows]]] = False
        is_drawable[parent_rows] |= (
            are_children_drawable[parent_rows] & ~tree.is_additive[parent_rows]
        )
    # 2. From the root down: a tile is passed over where the tiles below take its place.
    drawn = np.zeros(len(tree), bool)
    is_reached = np.zeros(len(tree), bool)
    is_reached[0] = True
    for rows in tree.rows_of_level:
        rows = rows[seen[rows] & is_reached[rows]]
        is_passed_over = is_refined[rows] & (
            are_children_drawable[rows] | ~resident[rows] | tree.is_additive[rows]
        )
        drawn[rows] = resident[rows] & (~is_passed_over | tree.is_additive[rows])
        opened_rows = rows[is_passed_over]
        if len(opened_rows):
            is_parent_opened = np.zeros(len(tree), bool)
            is_parent_opened[opened_rows] = True
            is_reached |= (tree.parent >= 0) & is_parent_opened[tree.parent]
    return drawn


@final
class TileFades:
    """Cross-fades tiles: new tiles fade in while the tiles that they replace fade out.

    A tile that merely comes into view is drawn at once, and one that leaves it is gone at once.

    Args:
        tree: The tiles.
        seconds: Of a fade; 0 for none.
    """

    def __init__(self, tree: TileTree, seconds: float) -> None:
        self._tree, self._seconds = tree, seconds
        self._fade_by_tile: Float64[np.ndarray, " n"] = np.zeros(len(tree))
        self._time: float | None = None

    @property
    def values(self) -> Float64[np.ndarray, " n"]:
        """The opacity factor of every tile, in [0, 1]; 0 for tiles that are not drawn."""
        return np.asarray(self._fade_by_tile)

    @property
    def is_settled(self) -> bool:
        """Whether no tile is fading in or out."""
        return bool(((self._fade_by_tile == 0) | (self._fade_by_tile == 1)).all())

    def frame(
        self, time: float, drawn: Bool[np.ndarray, " n"], seen: Bool[np.ndarray, " n"]
    ) -> None:
        """Advance the fades of all tiles to ``time``.

        Args:
            time: In seconds.
            drawn: Tiles that should be drawn.
            seen: Tiles that meet the frustum.
        """
        step = 1.0
        if self._seconds > 0 and self._time is not None:
            step = min(time - self._time, MAX_STEP_SECONDS) / self._seconds
        self._time = time
        visible = self._fade_by_tile > 0
        # Only a tile with a visible one above or below it takes the place of something.
        has_drawn_relative = self._descendants(visible) | self._ancestors(visible)
        is_entering_tile = drawn & ~visible
        self._fade_by_tile[is_entering_tile & ~has_drawn_relative] = 1.0
        # A drawn tile below or above another has taken its place.
        is_leaving_tile = visible & ~drawn
        is_replaced = self._descendants(drawn) | self._ancestors(drawn)
        self._fade_by_tile[is_leaving_tile & ~(is_replaced & self._tiles_in_view(seen))] = 0.0
        is_fading_in = drawn & (self._fade_by_tile < 1) & (has_drawn_relative | visible)
        is_fading_out = (self._fade_by_tile > 0) & ~drawn
        self._fade_by_tile[is_fading_in] = np.minimum(self._fade_by_tile[is_fading_in] + step, 1.0)
        self._fade_by_tile[is_fading_out] = np.maximum(
            self._fade_by_tile[is_fading_out] - step, 0.0
        )

    def drop(self, tile: int) -> None:
        """Stop drawing a tile at once, without a fade."""
        self._fade_by_tile[tile] = 0.0

    def _tiles_in_view(self, seen: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of the tiles that a camera sees, and all descendants of these tiles."""
        return np.asarray(seen | self._descendants(seen))

    def _descendants(self, tiles: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of all descendants of some tiles."""
        mask = np.zeros(len(tiles), bool)
        for rows in self._tree.rows_of_level[1:]:
            parent_rows = self._tree.parent[rows]
            mask[rows] = tiles[parent_rows] | mask[parent_rows]
        return mask

    def _ancestors(self, tiles: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of all ancestors of some tiles."""
        mask = np.zeros(len(tiles), bool)
        for rows in reversed(self._tree.rows_of_level[1:]):
            mask[self._tree.parent[rows[tiles[rows] | mask[rows]]]] = True
        return mask
