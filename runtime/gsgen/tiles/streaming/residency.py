"""Chooses which streamed tiles stay in GPU memory (the splat pool), and which are evicted."""

__all__ = ["ResidentTiles"]

from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.selection.tile_tree import TileTree


@final
class ResidentTiles:
    """The streamed tiles in GPU memory (splat pool), whose Gaussians never exceed its capacity.

    A tile leaves that is not needed: the least recently used, the finest first. The root, tiles that are needed and all tiles above them stay.

    Attributes:
        resident: Whether each tile is there.
        used_slots: Slots of all resident tiles.

    Args:
        tree: The tiles.
        slots: Slots that each tile needs.
        capacity: Slots of the pool.
    """

    def __init__(self, tree: TileTree, slots: Int64[np.ndarray, " n"], capacity: int) -> None:
        self._tree, self._slots, self._capacity = tree, slots, capacity
        self.resident: Bool[np.ndarray, " n"] = np.zeros(len(tree), bool)
        self.used_slots = 0
        self._last_use_time: Float64[np.ndarray, " n"] = np.full(len(tree), -np.inf)
        self._protected_tiles: Bool[np.ndarray, " n"] = np.zeros(len(tree), bool)

    def frame(self, time: float, needed: Bool[np.ndarray, " n"]) -> None:
        """Record the tiles that a frame needs, which are evicted from GPU memory last.

        Args:
            time: In seconds.
            needed: Tiles that are drawn, or will be as soon as they are there.
        """
        self._protected_tiles = self.with_ancestors(needed)
        self._last_use_time[self._protected_tiles] = time

    def with_ancestors(self, tiles: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return a mask of the given tiles, all their ancestors, and the root."""
        kept_mask = self._tree.with_ancestors(tiles)
        kept_mask[0] = True
        return kept_mask

    def admit_tile(self, tile: int, time: float) -> tuple[int, ...] | None:
        """Record that a streamed tile is in the renderer's GPU memory (splat pool) from now on.

        Returns:
            The tiles that leave for it; None where it does not fit beside those that stay.
        """
        if self.resident[tile]:
            return ()
        missing_slots = self.used_slots + int(self._slots[tile]) - self._capacity
        evicted = self._tiles_to_evict(missing_slots)
        if evicted is None:
            return None
        for evicted_tile in evicted:
            self.remove(evicted_tile)
        self.resident[tile] = True
        self.used_slots += int(self._slots[tile])
        self._last_use_time[tile] = time
        return evicted

    def protect(self, tile: int) -> None:
        """Keep a tile in GPU memory until the next frame, regardless of other tiles."""
        self._protected_tiles[tile] = True

    def remove(self, tile: int) -> None:
        """Remove a streamed tile from the renderer's GPU memory (splat pool)."""
        self.resident[tile] = False
        self.used_slots -= int(self._slots[tile])

    def _tiles_to_evict(self, missing_slots: int) -> tuple[int, ...] | None:
        """Return tiles whose eviction frees ``missing_slots`` slots of GPU memory; None if impossible."""
        if missing_slots <= 0:
            return ()
        rows = np.flatnonzero(self.resident & ~self._protected_tiles)
        order = np.lexsort((-rows, -self._tree.level[rows], self._last_use_time[rows]))
        rows = rows[order]
        freed_slots = np.cumsum(self._slots[rows])
        if not len(freed_slots) or freed_slots[-1] < missing_slots:
            return None
        return tuple(rows[: int(np.searchsorted(freed_slots, missing_slots)) + 1].tolist())
