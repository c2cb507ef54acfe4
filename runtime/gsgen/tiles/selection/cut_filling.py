"""Improves a choice of drawn tiles by spending the unused part of the byte budget.

Where tiles are worth what they are independently of the tiles below them, a step of the root's
frontier may cost a large part of the budget: it opens a whole subtree. The last point within the
budget then leaves much unused, which smaller steps below the hull can use. Exchanges of tiles close
most of the gap that is still there.
"""

__all__ = ["fill_cut"]

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np
from jaxtyping import Int64

from gsgen.tiles.selection.choose import TOLERANCE, Choice
from gsgen.tiles.selection.cut_exchange import exchange_tiles
from gsgen.tiles.selection.tree_choice import TreeFrontier

MAX_DEPTH: Final = 128
"""Depth of a tile tree above which choices stay as they are, since subtrees are recursive."""


def fill_cut(frontier: TreeFrontier, choice: Choice, budget: float) -> Choice:
    """Improve a choice of tiles greedily within a byte budget, without losing utility.

    A node takes its best option that fits, or the steps of its children by falling gain for cost,
    whichever is worth more; a child whose next step does not fit is solved the same way, with
    what is left. Then tiles are exchanged. The bound stays.
    """
    if choice.certificate <= TOLERANCE:
        return choice
    if len(frontier.levels) <= MAX_DEPTH:
        choice = _refined(frontier, choice, budget)
    if choice.certificate <= TOLERANCE:
        return choice
    price = frontier.price(budget)
    return exchange_tiles(frontier.options, choice, budget, price, TOLERANCE)


def _refined(frontier: TreeFrontier, choice: Choice, budget: float) -> Choice:
    """Spend the bytes that a choice of tiles leaves unused on subtrees, if that adds utility."""
    solver = _SubtreeSolver(frontier, TOLERANCE * choice.bound)
    solution = solver.solve(0, 0, budget)
    if solution is None or solution.utility <= choice.utility:
        return choice
    option = np.full(len(choice.option), -1, np.int64)
    for node, quality in solution.chosen:
        option[node] = quality
    rows = np.flatnonzero(option >= 0)
    cost = float(frontier.options.cost[rows, option[rows]].sum())
    utility = float(frontier.options.utility[rows, option[rows]].sum())
    if cost > budget or utility <= choice.utility:
        return choice
    return Choice(option, utility, cost, max(choice.bound, utility))


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Chosen tiles of a subtree: bytes, utility, and each tile with its chosen file quality."""

    cost: float
    utility: float
    chosen: list[tuple[int, int]]


@final
class _SubtreeSolver:
    """Chooses tiles of a tile tree's subtrees within budgets, by a greedy search."""

    def __init__(self, frontier: TreeFrontier, tolerance: float) -> None:
        self._levels, self._options = frontier.levels, frontier.options
        self._tolerance = tolerance
        self._starts = [
            np.append(level.starts(), len(level.owner)).tolist() for level in self._levels
        ]
        self._costs: list[list[float]] = [level.cost.tolist() for level in self._levels]
        self._values: list[list[float]] = [level.value.tolist() for level in self._levels]
        self._steps = [
            np.searchsorted(level.step_owner, np.arange(len(level.nodes) + 1)).tolist()
            for level in self._levels
        ]
        self._children = [self._children_of(depth) for depth in range(len(self._levels) - 1)]

    def _children_of(self, depth: int) -> list[Int64[np.ndarray, " m"]]:
        """Return the children of all tile-tree nodes of a depth, as indices into the next depth."""
        level, below = self._levels[depth], self._levels[depth + 1]
        owner = np.searchsorted(level.nodes, self._options.parent[below.nodes])
        order = np.argsort(owner, kind="stable")
        limits = np.searchsorted(owner[order], np.arange(len(level.nodes) + 1))
        return [order[start:end] for start, end in pairwise(limits)]

    def solve(self, depth: int, position: int, budget: float) -> _Solution | None:
        """Choose tiles of a tree node's subtree greedily; None if all choices exceed the budget."""
        node = int(self._levels[depth].nodes[position])
        best: _Solution | None = None
        # 1. The node's own best option.
        fits = self._options.cost[node] <= budget
        if fits.any():
            quality = int(np.argmax(np.where(fits, self._options.utility[node], -np.inf)))
            best = _Solution(
                float(self._options.cost[node, quality]),
                float(self._options.utility[node, quality]),
                [(node, quality)],
            )
        # 2. Its children.
        together = self._solve_children(depth, position, budget)
        if together and (best is None or together.utility > best.utility):
            best = together
        return best

    def _solve_children(self, depth: int, position: int, budget: float) -> _Solution | None:
        if depth == len(self._children) or not len(self._children[depth][position]):
            return None
        children: list[int] = self._children[depth][position].tolist()
        starts, costs = self._starts[depth + 1], self._costs[depth + 1]
        point = {child: starts[child] for child in children}
        left = budget - sum(costs[row] for row in point.values())
        if left < 0:
            return None
        # 1. Steps by falling gain for cost, as long as those of a child fit.
        steps = slice(*self._steps[depth][position : position + 2])
        blocked: set[int] = set()
        for child in self._levels[depth].step_child[steps].tolist():
            row = point[child]
            if child in blocked or costs[row + 1] - costs[row] > left:
                blocked.add(child)
                continue
            left -= costs[row + 1] - costs[row]
            point[child] = row + 1
        # 2. What is left goes to the children whose next step does not fit, the best first.
        solutions: dict[int, _Solution] = {}
        potential = {
            child: self._potential(depth + 1, child, point, left) for child in sorted(blocked)
        }
        for child in sorted(potential, key=lambda child: -potential[child]):
            if self._potential(depth + 1, child, point, left) <= self._tolerance:
                continue
            row = point[child]
            better = self.solve(depth + 1, child, costs[row] + left)
            if better and better.utility > self._values[depth + 1][row]:
                solutions[child] = better
                left -= better.cost - costs[row]
        parts = [
            solutions.get(child) or self._at_point(depth + 1, child, point[child])
            for child in children
        ]
        return _Solution(
            sum(part.cost for part in parts),
            sum(part.utility for part in parts),
            [pair for part in parts for pair in part.chosen],
        )

    def _potential(self, depth: int, child: int, point: dict[int, int], left: float) -> float:
        """Estimate a child tile's gain from ``left`` bytes at its next upgrade's gain per byte."""
        row, costs, values = point[child], self._costs[depth], self._values[depth]
        return (values[row + 1] - values[row]) * left / (costs[row + 1] - costs[row])

    def _at_point(self, depth: int, position: int, row: int) -> _Solution:
        """Return the tiles chosen at one point of a tree node's curve of utility over cost."""
        level = self._levels[depth]
        cost, value = self._costs[depth][row], self._values[depth][row]
        if level.option[row] >= 0:
            return _Solution(cost, value, [(int(level.nodes[position]), int(level.option[row]))])
        start = self._steps[depth][position]
        steps = level.step_child[start : start + int(level.prefix[row])]
        chosen: list[tuple[int, int]] = []
        for child in self._children[depth][position].tolist():
            below = self._starts[depth + 1][child] + int(np.count_nonzero(steps == child))
            chosen += self._at_point(depth + 1, child, below).chosen
        return _Solution(cost, value, chosen)
