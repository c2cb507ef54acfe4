"""Improves a set of drawn tiles by exchanges: bytes saved on some tiles pay for finer other tiles.

A greedy choice leaves a part of the budget that no single step fits. Each round, in this order:

1. List the changes of tiles: another quality, the best tiles below in a tile's place, or a tile in
   place of all that are drawn below it.
2. Keep the changes that lose least at the price of a byte, as the linear relaxation gives it: only
   those can be part of a better choice.
3. Make up to four changes that together fit the budget and gain most.
"""

__all__ = ["exchange_tiles"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.selection.change_sets import CORE_CHANGES, LEAST_GAIN, MOST_ROUNDS, best_changes
from gsgen.tiles.selection.choose import Choice
from gsgen.tiles.selection.tree_choice import CutOptions

Rows = Int64[np.ndarray, " m"]
Amounts = Float64[np.ndarray, " m"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Changes:
    """Possible changes of the set of drawn tiles; each replaces the drawn tiles of one subtree.

    Attributes:
        node: The tile.
        option: The quality that the tile gets; −1 for the best tiles below it.
        cost: What the change costs.
        utility: What it gains.
    """

    node: Rows
    option: Rows
    cost: Amounts
    utility: Amounts

    def core(self, price: float) -> "_Changes":
        """Return the changes of drawn tiles with the most utility gain minus ``price`` × bytes."""
        loss = price * self.cost - self.utility
        if len(loss) <= CORE_CHANGES:
            return self
        rows = np.argpartition(loss, CORE_CHANGES)[:CORE_CHANGES]
        return _Changes(self.node[rows], self.option[rows], self.cost[rows], self.utility[rows])


def exchange_tiles(
    options: CutOptions, choice: Choice, budget: float, price: float, tolerance: float
) -> Choice:
    """Return a choice of tiles within a byte budget, with at least the utility of ``choice``.

    Args:
        options: Of the problem.
        choice: Of each path's tile and quality.
        budget: The most that a choice may cost.
        price: Utility of a byte: the slope of the tree's frontier at the budget.
        tolerance: Gap to the bound, as a share of it, that is not worth closing.
    """
    exchange = _Exchange(options, choice.option, price)
    for _ in range(MOST_ROUNDS):
        cost, utility = exchange.totals()
        is_close = utility >= choice.bound * (1 - tolerance)
        if is_close or not exchange.improve(budget - cost, LEAST_GAIN * abs(utility)):
            break
    cost, utility = exchange.totals()
    if cost > budget or utility <= choice.utility:
        return choice
    return Choice(exchange.option, utility, cost, max(choice.bound, utility))


@final
class _Exchange:
    """A choice of drawn tiles, improved step by step, with costs and utilities of all tiles."""

    def __init__(self, options: CutOptions, option: Int64[np.ndarray, " n"], price: float) -> None:
        self.option = option.copy()
        self._parent, self._price = options.parent, price
        self._exists = np.isfinite(options.cost)
        self._cost = np.where(self._exists, options.cost, 0.0)
        self._utility = np.where(self._exists, options.utility, 0.0)
        depth = options.depths()
        order = np.argsort(depth, kind="stable")
        limits = np.searchsorted(depth[order], np.arange(1, int(depth.max()) + 1))
        self._levels = np.split(order, limits)
        self._has_children = np.zeros(len(option), bool)
        self._has_children[self._parent[self._parent >= 0]] = True
        self._solve_at_price()

    def _solve_at_price(self) -> None:
        """Choose the tiles to draw in every subtree that maximise utility minus price × bytes."""
        count = len(self.option)
        rows = np.arange(count)
        profit = np.where(self._exists, self._utility - self._price * self._cost, -np.inf)
        self._best = profit.argmax(axis=1)
        own = np.stack([table[rows, self._best] for table in (self._cost, self._utility, profit)])
        self._is_drawn = np.zeros(count, bool)
        self._split = np.zeros((3, count))  # cost, utility and profit of the best tiles below
        for nodes in reversed(self._levels):
            below = np.where(self._has_children[nodes], self._split[2, nodes], -np.inf)
            self._is_drawn[nodes] = own[2, nodes] >= below
            subtree = np.where(self._is_drawn[nodes], own[:, nodes], self._split[:, nodes])
            self._add_to_parents(self._split, nodes, subtree)

    def _add_to_parents(
        self, sums: Float64[np.ndarray, "c n"], nodes: Rows, values: Float64[np.ndarray, "c m"]
    ) -> None:
        """Add each node's values to the sums of the node above it in the tile tree."""
        is_child = self._parent[nodes] >= 0
        for row, added in zip(sums, values, strict=True):
            np.add.at(row, self._parent[nodes[is_child]], added[is_child])

    def totals(self) -> tuple[float, float]:
        """Return the total size in bytes, and the total utility, of the chosen tiles."""
        rows = np.flatnonzero(self.option >= 0)
        columns = self.option[rows]
        return float(self._cost[rows, columns].sum()), float(self._utility[rows, columns].sum())

    def improve(self, left: float, least_gain: float) -> bool:
        """Apply up to four tile changes that add most utility; return whether there were any."""
        changes = self._changes().core(self._price)
        is_apart = self._are_apart(changes.node)
        rows = best_changes(changes.cost, changes.utility, is_apart, left, least_gain)
        for row in rows:
            self._make(int(changes.node[row]), int(changes.option[row]))
        return bool(rows)

    def _changes(self) -> _Changes:
        chosen = np.flatnonzero(self.option >= 0)
        column = self.option[chosen]
        drawn = np.zeros((3, len(self.option)))  # cost, utility and number of a subtree's tiles
        drawn[0, chosen], drawn[1, chosen] = (
            self._cost[chosen, column],
            self._utility[chosen, column],
        )
        drawn[2, chosen] = 1
        for nodes in reversed(self._levels):
            self._add_to_parents(drawn, nodes, drawn[:, nodes])
        # Case 1: another quality of a drawn tile, or a tile in place of those below.
        tiles = np.flatnonzero(drawn[2])
        is_new = np.arange(self._exists.shape[1]) != self.option[tiles, None]
        row, quality = np.nonzero(self._exists[tiles] & is_new)
        node = tiles[row]
        # Case 2: the best tiles below, in place of a tile or of others below.
        can_split = self._has_children[tiles] & np.isfinite(self._split[2, tiles])
        split = tiles[can_split & (self._split[0, tiles] != drawn[0, tiles])]
        nodes = np.append(node, split)
        return _Changes(
            nodes,
            np.append(quality, np.full(len(split), -1)),
            np.append(self._cost[node, quality], self._split[0, split]) - drawn[0, nodes],
            np.append(self._utility[node, quality], self._split[1, split]) - drawn[1, nodes],
        )

    def _are_apart(self, node: Rows) -> Bool[np.ndarray, "m m"]:
        """Return which pairs of tile changes are in disjoint subtrees: both can be applied."""
        is_apart = np.ones((len(node), len(node)), bool)
        above = node
        while (above >= 0).any():
            is_apart &= above[:, None] != node
            above = np.where(above >= 0, self._parent[above], -1)
        return np.asarray(is_apart & is_apart.T)

    def _make(self, node: int, option: int) -> None:
        """Draw a tile in place of all tiles below it, or the best tiles below if ``option`` < 0."""
        opened, is_split = np.array([node]), np.array([option < 0])
        self.option[node] = option
        while len(opened):
            children = np.flatnonzero(np.isin(self._parent, opened))
            row = np.searchsorted(opened, self._parent[children])
            is_below_split = is_split[row]
            is_drawn = is_below_split & self._is_drawn[children]
            self.option[children] = np.where(is_drawn, self._best[children], -1)
            opened, is_split = children, is_below_split & ~is_drawn
