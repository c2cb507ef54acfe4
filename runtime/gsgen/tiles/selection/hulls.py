"""Upper concave hulls of tile qualities: the upgrades worth their bytes, by gain per cost."""

__all__ = ["OptionHulls", "upper_hulls"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

Table = Float64[np.ndarray, "n m"]


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OptionHulls:
    """The worthwhile quality upgrades of many tiles: edges of concave hulls of value over cost.

    A step leads from one option on a tile's hull to the next; the first of each tile leads from
    nothing (cost 0, value 0). Steps of a tile follow each other with falling efficiency.

    Attributes:
        tile: Tile of each step, ascending.
        option: The option that the step leads to.
        cost: What the step costs more than the option before.
        value: What it is worth more, before the weight of the tile.
        costs: Of each tile's options; before them stands nothing, which costs 0.
        values: Of each tile's options, before the weight of the tile; nothing is worth 0.
    """

    tile: Int64[np.ndarray, " s"]
    option: Int64[np.ndarray, " s"]
    cost: Float64[np.ndarray, " s"]
    value: Float64[np.ndarray, " s"]
    costs: Table
    values: Table

    @property
    def count(self) -> int:
        """The number of tiles whose quality upgrades are listed."""
        return len(self.costs)

    @classmethod
    def of_options(cls, cost: Table, value: Table) -> "OptionHulls":
        """Find the worthwhile quality upgrades of many tiles, by concave hulls of value over cost.

        Args:
            cost: Of each option, ≥ 0; infinite for options that a tile does not have.
            value: Of each option, before the weight of the tile.
        """
        count = len(cost)
        nothing = np.zeros((count, 1))
        costs, values = table = np.hstack([nothing, cost]), np.hstack([nothing, value])
        order, on_hull = upper_hulls(costs, values)
        rows = np.arange(count)[:, None]
        costs, values = costs[rows, order], values[rows, order]
        tile, column = np.nonzero(on_hull)
        option = order[tile, column] - 1
        is_first = np.r_[True, tile[1:] != tile[:-1]]
        picked_cost, picked_value = costs[tile, column], values[tile, column]
        # The first point of a hull is where it begins: nothing, or an option that is free.
        step_cost = np.diff(picked_cost, prepend=0.0)
        step_value = np.diff(picked_value, prepend=0.0)
        step_cost[is_first], step_value[is_first] = picked_cost[is_first], picked_value[is_first]
        is_step = option >= 0
        return cls(
            tile=tile[is_step],
            option=option[is_step],
            cost=step_cost[is_step],
            value=step_value[is_step],
            costs=table[0],
            values=table[1],
        )


def upper_hulls(
    cost: Table, value: Table
) -> tuple[Int64[np.ndarray, "n m"], Bool[np.ndarray, "n m"]]:
    """Return the upper concave hull of each row of (cost, value) points, up to the greatest value.

    Args:
        cost: x of the points; infinite for absent points.
        value: y of the points.

    Returns:
        The order of each row's points by cost, and which of those lie on the hull: costs and
        values ascend strictly along it, slopes descend strictly.
    """
    rows = np.arange(len(cost))[:, None]
    exists = np.isfinite(cost)
    x, y = np.where(exists, cost, np.inf), np.where(exists, value, -np.inf)
    order = np.lexsort((-y, x), axis=1)
    x, y = x[rows, order], y[rows, order]
    alive = np.isfinite(x)
    columns = np.arange(cost.shape[1])
    while True:
        # The neighbours of each point among those that are left.
        before = np.maximum.accumulate(np.where(alive, columns, -1), axis=1)
        before = np.hstack([np.full((len(cost), 1), -1), before[:, :-1]])
        after = np.where(alive, columns, len(columns))[:, ::-1]
        after = np.minimum.accumulate(after, axis=1)[:, ::-1]
        after = np.hstack([after[:, 1:], np.full((len(cost), 1), len(columns))])
        has_before, has_after = before >= 0, after < len(columns)
        left, right = np.maximum(before, 0), np.minimum(after, len(columns) - 1)
        with np.errstate(invalid="ignore"):
            rise_left, run_left = y - y[rows, left], x - x[rows, left]
            rise_right, run_right = y[rows, right] - y, x[rows, right] - x
            # Case 1: not worth more than a cheaper point.
            dominated = has_before & (rise_left <= 0)
            # Case 2: on or below the line between two neighbours.
            below = has_before & has_after & (rise_left * run_right <= rise_right * run_left)
        removed = alive & (dominated | below)
        if not removed.any():
            return np.asarray(order), np.asarray(alive)
        alive &= ~removed
