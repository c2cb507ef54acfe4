"""Chooses the tiles to draw while better tiles arrive, without holes, and fades tiles."""

__all__ = ["FADE_SECONDS", "Fades", "drawable_tiles"]

from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.tiles.selection.cut import Cut
from gsgen.tiles.selection.tile_tree import TileTree

FADE_SECONDS: Final = 0.25
# A window that stood still draws its next frame late: a fade that begins then must not be over.
_LONGEST_STEP: Final = 1 / 15


def drawable_tiles(
    tree: TileTree, cut: Cut, resident: Bool[np.ndarray, " n"]
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
    seen, refined = cut.seen, cut.seen & ~cut.wanted
    # 1. From the leaves up: can all that is seen below a tile be shown, at some level?
    shown, below_shown = seen & resident, np.zeros(len(tree), bool)
    for rows in reversed(tree.rows_of_level[1:]):
        rows = rows[seen[rows]]
        above = tree.parent[rows]
        below_shown[above] = True
        below_shown[above[~shown[rows]]] = False
        shown[above] |= below_shown[above] & ~tree.adds[above]
    # 2. From the root down: a tile is passed over where the tiles below take its place.
    drawn = np.zeros(len(tree), bool)
    open_above = np.zeros(len(tree), bool)
    open_above[0] = True
    for rows in tree.rows_of_level:
        rows = rows[seen[rows] & open_above[rows]]
        steps_down = refined[rows] & (below_shown[rows] | ~resident[rows] | tree.adds[rows])
        drawn[rows] = resident[rows] & (~steps_down | tree.adds[rows])
        opened = rows[steps_down]
        if len(opened):
            below = np.zeros(len(tree), bool)
            below[opened] = True
            open_above |= (tree.parent >= 0) & below[tree.parent]
    return drawn


@final
class Fades:
    """Cross-fades tiles: new tiles fade in while the tiles that they replace fade out.

    A tile that merely comes into view is drawn at once, and one that leaves it is gone at once.

    Args:
        tree: The tiles.
        seconds: Of a fade; 0 for none.
    """

    def __init__(self, tree: TileTree, seconds: float) -> None:
        self._tree, self._seconds = tree, seconds
        self._fade: Float64[np.ndarray, " n"] = np.zeros(len(tree))
        self._time: float | None = None

    @property
    def values(self) -> Float64[np.ndarray, " n"]:
        """The opacity factor of every tile, in [0, 1]; 0 for tiles that are not drawn."""
        return np.asarray(self._fade)

    @property
    def is_settled(self) -> bool:
        """Whether no tile is fading in or out."""
        return bool(((self._fade == 0) | (self._fade == 1)).all())

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
            step = min(time - self._time, _LONGEST_STEP) / self._seconds
        self._time = time
        visible = self._fade > 0
        # Only a tile with a visible one above or below it takes the place of something.
        replaces = self._below(visible) | self._above(visible)
        enters = drawn & ~visible
        self._fade[enters & ~replaces] = 1.0
        # A drawn tile below or above another has taken its place.
        leaves = visible & ~drawn
        replaced = self._below(drawn) | self._above(drawn)
        self._fade[leaves & ~(replaced & self._in_view(seen))] = 0.0
        rising = drawn & (self._fade < 1) & (replaces | visible)
        falling = (self._fade > 0) & ~drawn
        self._fade[rising] = np.minimum(self._fade[rising] + step, 1.0)
        self._fade[falling] = np.maximum(self._fade[falling] - step, 0.0)

    def drop(self, tile: int) -> None:
        """Stop drawing a tile at once, without a fade."""
        self._fade[tile] = 0.0

    def _in_view(self, seen: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of the tiles that a camera sees, and all descendants of these tiles."""
        return np.asarray(seen | self._below(seen))

    def _below(self, tiles: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of all descendants of some tiles."""
        marked = np.zeros(len(tiles), bool)
        for rows in self._tree.rows_of_level[1:]:
            above = self._tree.parent[rows]
            marked[rows] = tiles[above] | marked[above]
        return marked

    def _above(self, tiles: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of all ancestors of some tiles."""
        marked = np.zeros(len(tiles), bool)
        for rows in reversed(self._tree.rows_of_level[1:]):
            marked[self._tree.parent[rows[tiles[rows] | marked[rows]]]] = True
        return marked
