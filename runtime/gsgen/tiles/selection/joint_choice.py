"""Chooses tiles and file qualities of a tile tree within limits on bytes and Gaussians."""

__all__ = ["choose_jointly"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Int64

from gsgen.tiles.selection.choose import Choice, choose_options
from gsgen.tiles.selection.cut_filling import fill_cut
from gsgen.tiles.selection.hulls import OptionHulls
from gsgen.tiles.selection.tree_choice import CutOptions, TreeFrontier, choose_cut

_MOST_DOUBLINGS: Final = 40
_BISECTIONS: Final = 10


def choose_jointly(
    options: CutOptions,
    splats: Int64[np.ndarray, "n q"],
    *,
    byte_budget: float,
    splat_budget: float,
) -> Choice | None:
    """Choose tiles and file qualities of greatest utility, within limits on bytes and Gaussians.

    The limit on Gaussians becomes a price of each (Lagrangian relaxation): at a price p, the tree's
    frontier maximises utility − p · Gaussians within the bytes. Each price gives an upper bound of
    the utility, its relaxation's value + p · ``splat_budget``.

    1. Where no level is left to choose, tiles are independent: hulls and a prefix sum suffice.
    2. Without a price the choice usually keeps the limit.
    3. Otherwise, double the price until the choice keeps it.
    4. Bisect between the last two prices: lower prices lose less utility.

    Args:
        options: Of the problem; costs are bytes.
        splats: Gaussians of each option.
        byte_budget: The most bytes of a choice.
        splat_budget: The most Gaussians of a choice.

    Returns:
        The choice; None where no choice was found within both limits.
    """
    is_parent = np.isin(np.arange(len(options.parent)), options.parent)
    if _is_independent(options, is_parent) and float(splats.max(axis=1).sum()) <= splat_budget:
        return _independent_choice(options, is_parent, byte_budget)
    search = _PriceSearch(options, splats, byte_budget, splat_budget)
    if search.keeps_limit(0.0) or search.best is None:
        return search.choice()
    low, high = 0.0, search.first_price()
    for _ in range(_MOST_DOUBLINGS):
        if search.keeps_limit(high):
            break
        low, high = high, 2 * high
    else:
        return None
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if search.keeps_limit(middle) else (middle, high)
    return search.choice()


def _is_independent(options: CutOptions, is_parent: Bool[np.ndarray, " n"]) -> bool:
    """Return whether only leaf tiles have utility; drawing one tile then never excludes another."""
    draws = np.isfinite(options.cost) & (options.utility > 0)
    is_nothing = (options.cost[:, -1] == 0) & (options.utility[:, -1] == 0)
    return bool(is_nothing.all()) and not bool(draws[is_parent].any())


def _independent_choice(
    options: CutOptions, is_parent: Bool[np.ndarray, " n"], budget: float
) -> Choice:
    hulls = OptionHulls.of_options(options.cost, options.utility)
    choice = choose_options(hulls, np.ones(len(options.parent)), budget)
    nothing = options.cost.shape[1] - 1
    option = np.where(choice.option < 0, nothing, choice.option)
    return Choice(np.where(is_parent, -1, option), choice.utility, choice.cost, choice.bound)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    option: Int64[np.ndarray, " n"]
    utility: float
    cost: float
    splats: int


@final
class _PriceSearch:
    """Searches Lagrange prices per Gaussian for the best tiles within byte and Gaussian limits."""

    def __init__(
        self,
        options: CutOptions,
        splats: Int64[np.ndarray, "n q"],
        byte_budget: float,
        splat_budget: float,
    ) -> None:
        self._options, self._splats = options, splats
        self._byte_budget, self._splat_budget = byte_budget, splat_budget
        self._bound = np.inf
        # Within the bytes; the first one also with too many Gaussians.
        self.best: _Candidate | None = None

    def keeps_limit(self, price: float) -> bool:
        """Choose tiles by utility − ``price`` × Gaussians; return whether these fit the budget."""
        priced = self._options.utility - price * self._splats
        options = CutOptions(self._options.parent, self._options.cost, priced)
        frontier = TreeFrontier.of_options(options)
        choice = choose_cut(frontier, self._byte_budget)
        if choice is None:
            return False
        self._bound = min(self._bound, choice.bound + price * self._splat_budget)
        keeps_limit = self._offer(choice)
        if keeps_limit:
            self._offer(fill_cut(frontier, choice, self._byte_budget))
        return keeps_limit

    def _offer(self, choice: Choice) -> bool:
        rows = np.flatnonzero(choice.option >= 0)
        candidate = _Candidate(
            choice.option,
            float(self._options.utility[rows, choice.option[rows]].sum()),
            choice.cost,
            int(self._splats[rows, choice.option[rows]].sum()),
        )
        best, limit = self.best, self._splat_budget
        keeps_limit = candidate.splats <= limit
        is_better = best is None or best.splats > limit or candidate.utility > best.utility
        if best is None or (keeps_limit and is_better):
            self.best = candidate
        return keeps_limit

    def first_price(self) -> float:
        """Return the Lagrange price to try first: mean utility per Gaussian of the best choice."""
        assert self.best is not None
        return max(self.best.utility, 1e-12) / max(self.best.splats, 1)

    def choice(self) -> Choice | None:
        """Return the best tiles within byte and Gaussian limits, and a bound of their utility."""
        best = self.best
        if best is None or best.splats > self._splat_budget:
            return None
        return Choice(best.option, best.utility, best.cost, max(self._bound, best.utility))
