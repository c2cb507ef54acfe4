"""Chooses tiles exactly: Pareto fronts for tile trees, dynamic programming for deadlines."""

__all__ = ["DeadlineTile", "choose_cut_exactly", "choose_until_deadlines"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float64, Int64

from gsgen.tiles.selection.choose import Choice
from gsgen.tiles.selection.cut_filling import fill_cut
from gsgen.tiles.selection.tree_choice import CutOptions, TreeFrontier, choose_cut

_TOLERANCE = 1e-9  # of the utility: sums in another order differ by less


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Front:
    """The Pareto-optimal choices (bytes, utility) of a tile-tree node, by ascending bytes.

    Attributes:
        cost: Of each point.
        utility: Of each point.
        option: The node's own quality; −1 where its children are drawn.
        source: Of a point of the children, its row in the last of ``merges``.
        merges: For each child but the first, rows of the merge before it and of the child's front.
    """

    cost: Float64[np.ndarray, " p"]
    utility: Float64[np.ndarray, " p"]
    option: Int64[np.ndarray, " p"]
    source: Int64[np.ndarray, " p"]
    merges: tuple[tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]], ...]


@final
class _FrontMerger:
    """Merges the Pareto fronts of a tile tree's nodes from leaves to root, and prunes points.

    With a price on cost, a point whose priced utility lacks more than ``slack`` of the best
    point of its node cannot be part of a cut above the known one: the relaxation already says
    what all other nodes give at most.
    """

    def __init__(self, budget: float, price: float, slack: float) -> None:
        self._budget, self._price, self._slack = budget, price, slack

    def rows(
        self, cost: Float64[np.ndarray, " p"], utility: Float64[np.ndarray, " p"]
    ) -> Int64[np.ndarray, " m"]:
        """Return rows of the Pareto-optimal choices (cost, utility) of tiles, by ascending cost."""
        if not len(cost):
            return np.zeros(0, np.int64)
        priced = utility - self._price * cost
        candidates = np.flatnonzero((cost <= self._budget) & (priced >= priced.max() - self._slack))
        candidates = candidates[np.lexsort((-utility[candidates], cost[candidates]))]
        best = np.maximum.accumulate(utility[candidates])
        rises = np.r_[True, best[1:] > best[:-1]][: len(candidates)]
        return np.asarray(candidates[rises])


def choose_cut_exactly(options: CutOptions, budget: float) -> Choice | None:
    """Choose the tiles of greatest utility within a byte budget; None if every choice costs more.

    Args:
        options: Of the nodes; fronts grow with their number, though relaxation and price keep
            them short.
        budget: The most that all chosen options may cost together.
    """
    frontier = TreeFrontier.of_options(options)
    known = choose_cut(frontier, budget)
    if known is None:
        return None
    known = fill_cut(frontier, known, budget)  # a better choice keeps the fronts shorter
    root = frontier.levels[0]
    point = int(np.searchsorted(root.cost, budget, side="right")) - 1
    price = 0.0
    if point + 1 < len(root.cost):
        rise = root.value[point + 1] - root.value[point]
        price = float(rise / (root.cost[point + 1] - root.cost[point]))
    scale = float(np.abs(options.utility[np.isfinite(options.cost)]).sum())
    slack = known.bound - known.utility + _TOLERANCE * max(scale, 1.0)
    merger = _FrontMerger(budget, price, slack)
    fronts: list[_Front | None] = [None] * len(options.parent)
    children = _children(options.parent)
    for node in np.argsort(-options.depths(), kind="stable").tolist():
        fronts[node] = _front(options, node, [fronts[child] for child in children[node]], merger)
    best = fronts[int(np.flatnonzero(options.parent < 0)[0])]
    assert best is not None
    assert len(best.cost)
    chosen = _trace(options, fronts, children)
    nodes = np.flatnonzero(chosen >= 0)
    utility = float(options.utility[nodes, chosen[nodes]].sum())
    cost = float(options.cost[nodes, chosen[nodes]].sum())
    return Choice(chosen, utility, cost, max(known.bound, utility))


def _children(parent: Int64[np.ndarray, " n"]) -> list[list[int]]:
    children: list[list[int]] = [[] for _ in parent]
    for node, above in enumerate(parent.tolist()):
        if above >= 0:
            children[above].append(node)
    return children


def _front(
    options: CutOptions, node: int, below: list[_Front | None], merger: _FrontMerger
) -> _Front:
    """Return the Pareto front (cost, utility) of a tile-tree node, from its files and children."""
    own = np.flatnonzero(np.isfinite(options.cost[node]))
    cost, utility = options.cost[node, own], options.utility[node, own]
    option, source = own, np.full(len(own), -1)
    merges: list[tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]]] = []
    fronts = [front for front in below if front is not None]
    if fronts:
        together, gain = fronts[0].cost, fronts[0].utility
        for front in fronts[1:]:
            costs = (together[:, None] + front.cost).ravel()
            gains = (gain[:, None] + front.utility).ravel()
            rows = merger.rows(costs, gains)
            merges.append((rows // len(front.cost), rows % len(front.cost)))
            together, gain = costs[rows], gains[rows]
        cost, utility = np.r_[cost, together], np.r_[utility, gain]
        option = np.r_[option, np.full(len(together), -1)]
        source = np.r_[source, np.arange(len(together))]
    rows = merger.rows(cost, utility)
    return _Front(
        cost=cost[rows],
        utility=utility[rows],
        option=option[rows],
        source=source[rows],
        merges=tuple(merges),
    )


def _trace(
    options: CutOptions, fronts: list[_Front | None], children: list[list[int]]
) -> Int64[np.ndarray, " n"]:
    """Return which file of each tile (-1: none) the best choice within the byte budget downloads."""
    root = int(np.flatnonzero(options.parent < 0)[0])
    chosen = np.full(len(fronts), -1, np.int64)
    last = fronts[root]
    assert last is not None
    pending = [(root, len(last.cost) - 1)]
    while pending:
        node, row = pending.pop()
        front = fronts[node]
        assert front is not None
        if front.option[row] >= 0:
            chosen[node] = front.option[row]
            continue
        row = int(front.source[row])
        for child, (before, own) in zip(
            reversed(children[node][1:]), reversed(front.merges), strict=True
        ):
            pending.append((child, int(own[row])))
            row = int(before[row])
        pending.append((children[node][0], row))
    return chosen


@final
@dataclass(frozen=True, slots=True, eq=False)
class DeadlineTile:
    """A tile that has to arrive by a deadline.

    Attributes:
        slots: Time slots that each option takes on the link.
        utility: What each option is worth.
        deadline: The last slot in which it may end.
    """

    slots: Int64[np.ndarray, " m"]
    utility: Float64[np.ndarray, " m"]
    deadline: int


def choose_until_deadlines(tiles: list[DeadlineTile]) -> Choice:
    """Choose the optimal file quality of each tile, or none, so that all arrive by their deadlines.

    U(i,t) = max(U(i−1,t), U(i,t−1), max_j U(i−1,t−d_ij) + u_ij for t ≤ deadline_i), where
    U(i,t) is the best of the first i tiles when the link is free again at slot t.
    """
    end = max((tile.deadline for tile in tiles), default=0)
    best = np.zeros(end + 1)
    tables: list[tuple[Float64[np.ndarray, " t"], Int64[np.ndarray, " t"]]] = []
    for tile in tiles:
        before, option = best, np.full(end + 1, -1, np.int64)
        best = before.copy()
        for index, (slots, utility) in enumerate(zip(tile.slots, tile.utility, strict=True)):
            span = slice(int(slots), tile.deadline + 1)
            if slots > tile.deadline:
                continue
            gain = before[: tile.deadline + 1 - slots] + utility
            better = gain > best[span]
            best[span] = np.where(better, gain, best[span])
            option[span] = np.where(better, index, option[span])
        best = np.maximum.accumulate(best)
        tables.append((best, option))
    return _trace_deadlines(tiles, tables, end)


def _trace_deadlines(
    tiles: list[DeadlineTile],
    tables: list[tuple[Float64[np.ndarray, " t"], Int64[np.ndarray, " t"]]],
    end: int,
) -> Choice:
    chosen, slot, cost = np.full(len(tiles), -1, np.int64), end, 0
    for index in range(len(tiles) - 1, -1, -1):
        best, option = tables[index]
        # An idle link: the value was there at an earlier slot.
        slot = int(np.searchsorted(best, best[slot], side="left"))
        chosen[index] = option[slot]
        if chosen[index] >= 0:
            slot -= int(tiles[index].slots[chosen[index]])
            cost += int(tiles[index].slots[chosen[index]])
    picked = [(tile, o) for tile, o in zip(tiles, chosen.tolist(), strict=True) if o >= 0]
    utility = float(sum(tile.utility[o] for tile, o in picked))
    return Choice(chosen, utility, float(cost), utility)
