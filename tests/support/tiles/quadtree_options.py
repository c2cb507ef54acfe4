"""A quadtree of tiles, each with three qualities, to choose levels and qualities of."""

__all__ = ["QuadtreeOptions"]

from dataclasses import dataclass

import numpy as np

from gsgen.tiles.selection.tree_choice import CutOptions

_LEVELS = 5


@dataclass(frozen=True, slots=True, eq=False)
class QuadtreeOptions:
    """The options of each tile; a tile covers what its children cover.

    Attributes:
        options: Bytes and utility of each quality.
        splats: Gaussians of each tile.
        is_leaf: Whether a tile is of the finest level.
    """

    options: CutOptions
    splats: np.ndarray
    is_leaf: np.ndarray

    @classmethod
    def random(cls, seed: int) -> "QuadtreeOptions":
        rng = np.random.default_rng(seed)
        parents = (4 ** (_LEVELS - 1) - 1) // 3
        parent = np.r_[-1, np.repeat(np.arange(parents), 4)]
        level = np.repeat(np.arange(_LEVELS), 4 ** np.arange(_LEVELS))
        is_leaf = level == _LEVELS - 1
        area = np.where(is_leaf, rng.exponential(1, len(parent)), 0.0)
        for node in range(len(parent) - 1, 0, -1):
            area[parent[node]] += area[node]
        splats = rng.integers(5_000, 20_000, len(parent))
        cost = splats[:, None] * np.array([6.0, 9, 14])
        utility = ((1 - 0.5 ** (level + 1)) * area)[:, None] * np.array([0.9, 0.97, 1])
        return cls(CutOptions(parent, cost, utility), splats, is_leaf)

    def budgets(self, bytes_share: float, splat_share: float) -> dict[str, float]:
        """Return the limits on bytes and Gaussians as shares of what all leaves need."""
        return {
            "byte_budget": bytes_share * float(self.options.cost[self.is_leaf, 2].sum()),
            "splat_budget": splat_share * float(self.splats[self.is_leaf].sum()),
        }

    @property
    def splat_table(self) -> np.ndarray:
        """The Gaussians of each tile at each quality."""
        return np.repeat(self.splats[:, None], 3, axis=1)
