"""Improves a choice of drawn tiles by exchanges: one tile's change pays for another's.

A greedy choice leaves a part of the budget that no single step fits. Each round, in this order:

1. List the changes of single tiles: another quality, its children in its place, or the parent in
   place of its children.
2. Keep the changes that lose least at the price of a byte, as the linear relaxation gives it: only
   those can be part of a better choice.
3. Make the change, or the pair of changes, that fits the budget and gains most.
"""

__all__ = ["exchange_tiles"]

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.selection.choose import Choice
from gsgen.tiles.selection.tree_choice import CutOptions

_CORE: Final = 150  # changes of which pairs are tried: 22,500 pairs take a quarter of a millisecond
_MOST_ROUNDS: Final = 12
_LEAST_GAIN: Final = 1e-12  # of the utility: less is rounding

Rows = Int64[np.ndarray, " m"]
Amounts = Float64[np.ndarray, " m"]


class _Kind(IntEnum):
    QUALITY = 0
    SPLIT = 1
    MERGE = 2


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Changes:
    """Possible changes of a choice of tiles, each of one tile, or of a tile and its children.

    Attributes:
        kind: As ``_Kind``.
        node: The tile.
        option: The quality that the tile gets; −1 for a split.
        cost: What the change costs.
        utility: What it gains.
    """

    kind: Rows
    node: Rows
    option: Rows
    cost: Amounts
    utility: Amounts

    def core(self, price: float) -> "_Changes":
        """Return the changes of tiles that lose least at a given price per byte."""
        loss = price * self.cost - self.utility
        rows = np.argpartition(loss, _CORE)[:_CORE] if len(loss) > _CORE else np.arange(len(loss))
        return _Changes(
            kind=self.kind[rows],
            node=self.node[rows],
            option=self.option[rows],
            cost=self.cost[rows],
            utility=self.utility[rows],
        )


def exchange_tiles(
    options: CutOptions, choice: Choice, budget: float, price: float, tolerance: float
) -> Choice:
    """Return a choice of tiles within a cost budget, with at least the utility of ``choice``.

    Args:
        options: Of the problem.
        choice: Of each path's tile and quality.
        budget: The most that a choice may cost.
        price: Utility of a byte: the slope of the tree's frontier at the budget.
        tolerance: Gap to the bound, as a share of it, that is not worth closing.
    """
    exchange = _Exchange(options, choice.option, price)
    for _ in range(_MOST_ROUNDS):
        cost, utility = exchange.totals()
        is_close = utility >= choice.bound * (1 - tolerance)
        if is_close or not exchange.improve(budget - cost, _LEAST_GAIN * abs(utility)):
            break
    cost, utility = exchange.totals()
    if cost > budget or utility <= choice.utility:
        return choice
    return Choice(exchange.option, utility, cost, max(choice.bound, utility))


@final
class _Exchange:
    """A choice of tiles to be improved by exchanges, and the constants of the problem."""

    def __init__(self, options: CutOptions, option: Int64[np.ndarray, " n"], price: float) -> None:
        self.option = option.copy()
        self._parent, self._price = options.parent, price
        self._exists = np.isfinite(options.cost)
        self._cost = np.where(self._exists, options.cost, 0.0)
        self._utility = np.where(self._exists, options.utility, 0.0)
        count = len(option)
        self._child_count = np.bincount(self._parent[self._parent >= 0], minlength=count)
        # A split gives each child its best option at the price.
        profit = np.where(self._exists, self._utility - price * self._cost, -np.inf)
        self._best = profit.argmax(axis=1)
        rows = np.arange(count)
        can_stand = self._exists.any(axis=1)
        self._can_split = (self._child_count > 0) & (self._below(~can_stand) == 0)
        self._split_cost = self._below(self._cost[rows, self._best])
        self._split_utility = self._below(self._utility[rows, self._best])

    def _below(self, values: np.ndarray) -> Float64[np.ndarray, " n"]:
        """Return the sum of a value over the children of each tile."""
        is_child = self._parent >= 0
        sums = np.bincount(self._parent[is_child], values[is_child], len(self._parent))
        return np.asarray(sums, np.float64)

    def totals(self) -> tuple[float, float]:
        """Return the total cost and utility of the chosen tiles."""
        rows = np.flatnonzero(self.option >= 0)
        columns = self.option[rows]
        return float(self._cost[rows, columns].sum()), float(self._utility[rows, columns].sum())

    def improve(self, left: float, least_gain: float) -> bool:
        """Make the change or pair of changes that gains most; return whether one exists."""
        changes = self._changes().core(self._price)
        if not len(changes.node):
            return False
        single = np.where(changes.cost <= left, changes.utility, -np.inf)
        pair = np.where(
            (changes.cost[:, None] + changes.cost <= left) & self._are_apart(changes),
            changes.utility[:, None] + changes.utility,
            -np.inf,
        )
        gain, rows = float(pair.max()), list(divmod(int(pair.argmax()), len(single)))
        if single.max() >= gain:
            gain, rows = float(single.max()), [int(single.argmax())]
        if gain <= least_gain:
            return False
        for row in rows:
            self._make(changes, row)
        return True

    def _changes(self) -> _Changes:
        chosen = np.flatnonzero(self.option >= 0)
        column = self.option[chosen]
        cost, utility = self._cost[chosen, column], self._utility[chosen, column]
        # Case 1: another quality.
        is_other = self._exists[chosen] & (np.arange(self._exists.shape[1]) != column[:, None])
        row, quality = np.nonzero(is_other)
        lists = [
            (
                np.full(len(row), _Kind.QUALITY),
                chosen[row],
                quality,
                self._cost[chosen[row], quality] - cost[row],
                self._utility[chosen[row], quality] - utility[row],
            )
        ]
        # Case 2: the children instead of the tile.
        row = np.flatnonzero(self._can_split[chosen])
        node = chosen[row]
        lists.append(
            (
                np.full(len(node), _Kind.SPLIT),
                node,
                np.full(len(node), -1),
                self._split_cost[node] - cost[row],
                self._split_utility[node] - utility[row],
            )
        )
        # Case 3: the tile instead of its children, where all of those are chosen themselves.
        is_chosen = self.option >= 0
        is_parent = (self._child_count > 0) & (self._below(is_chosen) == self._child_count)
        node, quality = np.nonzero(self._exists & is_parent[:, None])
        drawn = np.zeros((2, len(self.option)))
        drawn[:, chosen] = cost, utility
        lists.append(
            (
                np.full(len(node), _Kind.MERGE),
                node,
                quality,
                self._cost[node, quality] - self._below(drawn[0])[node],
                self._utility[node, quality] - self._below(drawn[1])[node],
            )
        )
        kind, node, option, cost, utility = map(np.concatenate, zip(*lists, strict=True))
        return _Changes(kind=kind, node=node, option=option, cost=cost, utility=utility)

    def _are_apart(self, changes: _Changes) -> Bool[np.ndarray, "m m"]:
        """Return which pairs of changes touch different tiles only."""
        node, is_merge = changes.node, changes.kind == _Kind.MERGE
        family = np.where(is_merge, node, self._parent[node])
        shares_family = (family[:, None] == family) & (is_merge[:, None] | is_merge)
        return np.asarray(~((node[:, None] == node) | shares_family))

    def _make(self, changes: _Changes, row: int) -> None:
        node = int(changes.node[row])
        children = np.flatnonzero(self._parent == node)
        self.option[node] = changes.option[row]
        if changes.kind[row] == _Kind.SPLIT:
            self.option[children] = self._best[children]
        elif changes.kind[row] == _Kind.MERGE:
            self.option[children] = -1
