"""Chooses one quality per tile within a byte budget, by concave hulls and a prefix sum."""

__all__ = ["TOLERANCE", "Choice", "choose_options"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float64, Int64

from gsgen.tiles.selection.change_sets import CORE_CHANGES, LEAST_GAIN, MOST_ROUNDS, best_changes
from gsgen.tiles.selection.hulls import OptionHulls

TOLERANCE: Final = 1e-3
"""Gap between utility and upper bound, as a share of the bound, that is not worth closing."""

_STEPS_BEYOND: Final = 64  # steps after the budget's end: each costs a microsecond


@final
@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The chosen file quality of each tile, and how far the choice can be from the optimum.

    Attributes:
        option: Of each tile; −1 for none.
        utility: Sum of the chosen options' weighted values.
        cost: Sum of their costs.
        bound: No choice within the budget has more utility.
    """

    option: Int64[np.ndarray, " n"]
    utility: float
    cost: float
    bound: float

    @property
    def certificate(self) -> float:
        """An upper bound of the utility that the chosen tiles lack, relative to the optimum."""
        return (self.bound - self.utility) / self.bound if self.bound > 0 else 0.0


def choose_options(hulls: OptionHulls, weight: Float64[np.ndarray, " n"], budget: float) -> Choice:
    """Choose a file quality for each tile, of large total value within a byte budget.

    The linear relaxation of the multiple-choice knapsack takes steps of the hulls by falling
    gain for cost (Sinha and Zoltners 1979). Its last, partial step gives the bound; then every
    later step that still fits is taken whole. Where that leaves more than a thousandth to the
    bound, tiles are exchanged.

    Args:
        hulls: Of all tiles.
        weight: Factor on each tile's values, ≥ 0.
        budget: The most that the choice may cost.
    """
    gain = hulls.value * weight[hulls.tile]
    with np.errstate(divide="ignore", invalid="ignore"):
        efficiency = np.where(hulls.cost > 0, gain / hulls.cost, np.inf)
    # Stable: the steps of a tile stay in their order, also where its weight is 0.
    order = np.argsort(-efficiency, kind="stable")
    cost, gain = hulls.cost[order], gain[order]
    total = np.cumsum(cost)
    fitting = int(np.searchsorted(total, budget, side="right"))
    utility, spent = float(gain[:fitting].sum()), float(total[fitting - 1]) if fitting else 0.0
    bound = utility
    if fitting < len(order):
        bound += float(gain[fitting] * (budget - spent) / cost[fitting])
    is_taken = np.zeros(len(order), bool)
    is_taken[order[:fitting]] = True
    later = order[fitting:][cost[fitting:] <= budget - spent][:_STEPS_BEYOND]
    for step in later.tolist():
        tile = hulls.tile[step]
        is_next = step == 0 or hulls.tile[step - 1] != tile or is_taken[step - 1]
        if is_next and spent + hulls.cost[step] <= budget:
            is_taken[step] = True
            spent += float(hulls.cost[step])
            utility += float(hulls.value[step] * weight[tile])
    option = np.full(hulls.count, -1, np.int64)
    # Steps ascend within a tile, so that the last one that is assigned is the highest.
    chosen = np.flatnonzero(is_taken)
    option[hulls.tile[chosen]] = hulls.option[chosen]
    choice = Choice(option, utility, spent, max(bound, utility))
    if choice.certificate <= TOLERANCE or fitting == len(order):
        return choice
    return _exchanged(hulls, weight, choice, budget, float(gain[fitting] / cost[fitting]))


def _exchanged(
    hulls: OptionHulls,
    weight: Float64[np.ndarray, " n"],
    choice: Choice,
    budget: float,
    price: float,
) -> Choice:
    """Exchange file qualities, up to four at a time, for more utility within the byte budget."""
    value = hulls.values * weight[:, None]
    exists = np.isfinite(hulls.costs)
    cost = np.where(exists, hulls.costs, 0.0)
    profit = np.where(exists, value - price * cost, -np.inf)
    rows, columns = np.arange(len(cost)), choice.option + 1
    for _ in range(MOST_ROUNDS):
        spent, utility = cost[rows, columns].sum(), value[rows, columns].sum()
        loss = profit[rows, columns][:, None] - profit
        loss[rows, columns] = np.inf  # no change
        core = np.argpartition(loss, min(CORE_CHANGES, loss.size) - 1, axis=None)[:CORE_CHANGES]
        tile, column = np.divmod(core[np.isfinite(loss.ravel()[core])], cost.shape[1])
        changes = best_changes(
            cost[tile, column] - cost[tile, columns[tile]],
            value[tile, column] - value[tile, columns[tile]],
            tile[:, None] != tile,
            budget - spent,
            LEAST_GAIN * utility,
        )
        columns[tile[changes]] = column[changes]
        if not changes or value[rows, columns].sum() >= choice.bound * (1 - TOLERANCE):
            break
    spent, utility = float(cost[rows, columns].sum()), float(value[rows, columns].sum())
    return Choice(columns - 1, utility, spent, max(choice.bound, utility))
