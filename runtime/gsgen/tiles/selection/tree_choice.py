"""Chooses tiles and qualities of a tile tree within a budget, by concave utility curves.

A node's frontier, its utility curve, is the upper hull of its own options and of what its children
give together: their first points added, then their steps by falling gain for cost. The root's
frontier is the linear relaxation of the problem: it gives a choice, and a bound on every other.
"""

__all__ = ["CutOptions", "TreeFrontier", "choose_cut"]

from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.selection.choose import Choice
from gsgen.tiles.selection.hulls import upper_hulls

Points = Float64[np.ndarray, " p"]
Rows = Int64[np.ndarray, " m"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class CutOptions:
    """Bytes and utilities of each tile's file qualities in a tile tree, and each tile's parent.

    Attributes:
        parent: Index of the node above; −1 for the root, which is alone.
        cost: Of each node at each quality; infinite for options that a node does not have.
        utility: What drawing the node at that quality is worth.
    """

    parent: Int64[np.ndarray, " n"]
    cost: Float64[np.ndarray, "n q"]
    utility: Float64[np.ndarray, "n q"]

    def depths(self) -> Int64[np.ndarray, " n"]:
        """Return the number of ancestors of each node of the tile tree."""
        depth = np.zeros(len(self.parent), np.int64)
        above = self.parent.copy()
        while (above >= 0).any():
            depth += above >= 0
            above = np.where(above >= 0, self.parent[above], -1)
        return depth


def _no_rows() -> Rows:
    return np.zeros(0, np.int64)


def _no_values() -> Points:
    return np.zeros(0)


@final
@dataclass(slots=True, kw_only=True, eq=False)
class _Level:
    """The concave curves of utility over download cost of all tile-tree nodes at one depth.

    Attributes:
        nodes: The nodes, ascending.
        owner: Position in ``nodes`` of each point.
        cost: Of each point.
        value: Of each point.
        option: The node's own quality; −1 for a point of its children.
        prefix: Number of steps of the children that a point of them takes.
        step_owner: Position in ``nodes`` of each step of the children, ascending.
        step_child: Position in the next level of the child whose step it is.
    """

    nodes: Rows
    owner: Rows = field(default_factory=_no_rows)
    cost: Points = field(default_factory=_no_values)
    value: Points = field(default_factory=_no_values)
    option: Rows = field(default_factory=_no_rows)
    prefix: Rows = field(default_factory=_no_rows)
    step_owner: Rows = field(default_factory=_no_rows)
    step_child: Rows = field(default_factory=_no_rows)

    def starts(self) -> Rows:
        """Return where each node's points begin in the concatenated utility curves of a level."""
        return np.searchsorted(self.owner, np.arange(len(self.nodes)))


@final
@dataclass(frozen=True, slots=True, eq=False)
class TreeFrontier:
    """The concave curves of utility over download cost of tile-tree nodes, the root's first.

    Attributes:
        levels: By depth.
        options: Of the problem.
    """

    levels: tuple[_Level, ...] = field(repr=False)
    options: CutOptions = field(repr=False)

    @classmethod
    def of_options(cls, options: CutOptions) -> "TreeFrontier":
        """Build the curves of utility over cost for a tile tree, level by level from the leaves."""
        depth = options.depths()
        order, on_hull = upper_hulls(options.cost, options.utility)
        levels: list[_Level] = []
        below: _Level | None = None
        position = np.zeros(len(depth), np.int64)
        for level in range(int(depth.max()), -1, -1):
            nodes = np.flatnonzero(depth == level)
            position[nodes] = np.arange(len(nodes))
            below = _build_level(options, nodes, below, position, (order, on_hull))
            levels.append(below)
        return cls(tuple(reversed(levels)), options)

    @property
    def costs(self) -> Points:
        """The download costs at the points of a tile tree's utility curve, in ascending order."""
        return self.levels[0].cost

    def bound(self, budget: float) -> float:
        """Return an upper bound of the tiles' utility in a budget, by linear relaxation."""
        return float(np.interp(budget, self.costs, self.levels[0].value))

    def price(self, budget: float) -> float:
        """Return the utility of one more byte at a budget: the slope of the utility curve."""
        after = int(np.searchsorted(self.costs, budget, side="right"))
        if not 0 < after < len(self.costs):
            return 0.0
        value, cost = self.levels[0].value, self.costs
        return float((value[after] - value[after - 1]) / (cost[after] - cost[after - 1]))

    def options_at(self, point: int) -> Int64[np.ndarray, " n"]:
        """Return tiles' file qualities at a point of the root's utility curve; −1: not drawn."""
        chosen = np.full(len(self.options.parent), -1, np.int64)
        points = np.array([point])
        for level, below in zip(self.levels, [*self.levels[1:], None], strict=True):
            is_open = points >= 0
            rows = level.starts() + np.maximum(points, 0)
            own = np.where(is_open, level.option[rows], -1)
            chosen[level.nodes] = own
            if below is None:
                break
            prefix = np.where(is_open & (own < 0), level.prefix[rows], -1)
            points = _points_below(level, below, prefix)
            # Children of a node that is drawn itself, or of none, stay closed.
            points[prefix[_owners(self.options, level, below)] < 0] = -1
        return chosen


def choose_cut(frontier: TreeFrontier, budget: float) -> Choice | None:
    """Choose tiles and file qualities: the last point within a budget on the root's utility curve.

    Returns:
        The choice; None where every cut costs more than ``budget``.
    """
    point = int(np.searchsorted(frontier.costs, budget, side="right")) - 1
    if point < 0:
        return None
    root = frontier.levels[0]
    utility, cost = float(root.value[point]), float(root.cost[point])
    bound = max(frontier.bound(budget), utility)
    return Choice(frontier.options_at(point), utility, cost, bound)


def _owners(options: CutOptions, level: _Level, below: _Level) -> Rows:
    """Return the position of each tile-tree node's parent in the level above."""
    return np.asarray(np.searchsorted(level.nodes, options.parent[below.nodes]))


def _points_below(level: _Level, below: _Level, prefix: Rows) -> Rows:
    """Count each child's steps among the first ``prefix`` steps of its parent's utility curve."""
    first = np.searchsorted(level.step_owner, np.arange(len(level.nodes)))
    rank = np.arange(len(level.step_owner)) - first[level.step_owner]
    is_taken = rank < prefix[level.step_owner]
    return np.asarray(np.bincount(level.step_child[is_taken], minlength=len(below.nodes)))


def _build_level(
    options: CutOptions,
    nodes: Rows,
    below: _Level | None,
    position: Rows,
    hulls: tuple[Int64[np.ndarray, "n q"], Bool[np.ndarray, "n q"]],
) -> _Level:
    """Return the curves of utility over cost of one tree level's tiles, each with its subtree."""
    level = _Level(nodes=nodes)
    if below is not None:
        _merge_children(level, below, position[options.parent[below.nodes]])
    order, on_hull = hulls
    rows = nodes[:, None]
    quality, is_option = order[nodes], on_hull[nodes]
    cost, value = options.cost[rows, quality], options.utility[rows, quality]
    for column in range(quality.shape[1]):
        owner = np.flatnonzero(is_option[:, column])
        if len(owner):
            option = quality[owner, column]
            _insert(level, owner, cost[owner, column], value[owner, column], option)
    return level


def _merge_children(level: _Level, below: _Level, parent: Rows) -> None:
    """Set each tile's utility curve to the merged curves of its children, for one tree level."""
    is_first = np.r_[True, below.owner[1:] != below.owner[:-1]]
    steps = np.flatnonzero(~is_first)
    cost = below.cost[steps] - below.cost[steps - 1]
    value = below.value[steps] - below.value[steps - 1]
    child, owner = below.owner[steps], parent[below.owner[steps]]
    order = np.lexsort((steps, -value / cost, owner))
    level.step_owner, level.step_child = owner[order], child[order]
    # A parent's points: the children's first points together, then one more for each step.
    parents, base_rows = np.unique(parent), np.flatnonzero(is_first)
    size = len(level.nodes)
    base_cost = np.bincount(parent, below.cost[base_rows], size)[parents]
    base_value = np.bincount(parent, below.value[base_rows], size)[parents]
    owners = np.concatenate([parents, level.step_owner])
    sort = np.argsort(owners, kind="stable")
    level.owner = owners[sort]
    level.cost = _running(np.concatenate([base_cost, cost[order]])[sort], level.owner)
    level.value = _running(np.concatenate([base_value, value[order]])[sort], level.owner)
    first = np.searchsorted(level.owner, level.owner)
    level.prefix = np.arange(len(level.owner)) - first
    level.option = np.full(len(level.owner), -1, np.int64)


def _running(values: Points, owner: Rows) -> Points:
    """Return cumulative sums of sorted values, which start again at each tile-tree node."""
    total = np.cumsum(values)
    first = np.searchsorted(owner, owner)
    return np.asarray(total - (total - values)[first])


def _insert(level: _Level, owner: Rows, cost: Points, value: Points, option: Rows) -> None:
    """Add a point to the utility curves of some tile-tree nodes, and drop dominated points.

    Frontiers stay strictly concave and ascending: the tangents from the new point on both
    sides end at the first points that remain.
    """
    size = len(level.nodes)
    x, y, exists = np.full(size, np.inf), np.zeros(size), np.zeros(size, bool)
    x[owner], y[owner], exists[owner] = cost, value, True
    px, py = x[level.owner], y[level.owner]
    left, right = level.cost < px, level.cost > px
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (py - level.value) / (px - level.cost)
    starts = level.starts()
    filled = np.diff(starts, append=len(level.owner)) > 0
    rise = _reduce(np.minimum, np.where(left, slope, np.inf), starts, filled, np.inf)
    fall = _reduce(np.maximum, np.where(right, slope, 0.0), starts, filled, 0.0)
    equal = ~left & ~right
    over = _reduce(np.maximum, np.where(equal, level.value, -np.inf), starts, filled, -np.inf)
    joins = exists & (rise > fall) & (y > over)
    # Beside a point that joins, rows stay up to the left tangent and from the right one on.
    limit = np.where(left & (slope <= rise[level.owner]), level.cost, np.inf)
    last = _reduce(np.minimum, limit, starts, filled, np.inf)
    limit = np.where(right & (slope >= fall[level.owner]) & (slope > 0), level.cost, -np.inf)
    next_cost = _reduce(np.maximum, limit, starts, filled, -np.inf)
    outside = np.where(
        left, level.cost <= last[level.owner], right & (level.cost >= next_cost[level.owner])
    )
    has_next = next_cost[level.owner] > -np.inf
    stays = ~joins[level.owner] | (outside & (left | has_next))
    new = np.flatnonzero(joins)
    options = np.zeros(size, np.int64)
    options[owner] = option
    merged = np.concatenate([level.owner[stays], new])
    costs = np.concatenate([level.cost[stays], x[new]])
    sort = np.lexsort((costs, merged))
    level.owner, level.cost = merged[sort], costs[sort]
    level.value = np.concatenate([level.value[stays], y[new]])[sort]
    level.option = np.concatenate([level.option[stays], options[new]])[sort]
    level.prefix = np.concatenate([level.prefix[stays], np.full(len(new), -1)])[sort]


def _reduce(
    operation: np.ufunc, values: Points, starts: Rows, filled: Bool[np.ndarray, " m"], empty: float
) -> Points:
    """Reduce each tree node's values by an operation such as minimum; without values, ``empty``."""
    result = np.full(len(starts), empty)
    if filled.any():
        result[filled] = operation.reduceat(values, starts[filled])
    return result
