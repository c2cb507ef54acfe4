"""Sets of changes are compared with all sets of up to four."""

from itertools import combinations

import numpy as np
import pytest

from gsgen.tiles.selection.change_sets import best_changes
from gsgen.tiles.selection.choose import choose_options
from gsgen.tiles.selection.hulls import OptionHulls


def best_set(cost, utility, is_apart, left: float, sizes: range) -> float:
    """The most that changes of different tiles gain within a budget: all sets are tried."""
    best = 0.0
    for size in sizes:
        for changes in combinations(range(len(cost)), size):
            rows = list(changes)
            apart = all(is_apart[a, b] for a, b in combinations(changes, 2))
            if apart and cost[rows].sum() <= left:
                best = max(best, float(utility[rows].sum()))
    return best


@pytest.mark.parametrize("seed", range(40))
def test_changes_fit_and_gain_at_least_as_much_as_the_best_pair(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = int(rng.integers(0, 11))
    cost, utility = rng.normal(size=m).round(2), rng.normal(size=m)
    tile = rng.integers(0, 1 + m, m)
    is_apart = tile[:, None] != tile
    left = float(rng.normal())
    changes = best_changes(cost, utility, is_apart, left, 0.0)
    assert len(changes) == len(set(changes)) <= 4
    assert len({int(tile[change]) for change in changes}) == len(changes)
    gain = float(utility[changes].sum()) if changes else 0.0
    if changes:
        assert cost[changes].sum() <= left + 1e-12
        assert gain > 0
    assert gain >= best_set(cost, utility, is_apart, left, range(1, 3)) - 1e-12
    assert gain <= best_set(cost, utility, is_apart, left, range(1, 5)) + 1e-12


def test_changes_are_mostly_the_best_four() -> None:
    gains, best = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        cost, utility = rng.normal(size=9), rng.normal(size=9)
        is_apart = ~np.eye(9, dtype=bool)
        changes = best_changes(cost, utility, is_apart, 0.1, 0.0)
        gains.append(utility[changes].sum())
        best.append(best_set(cost, utility, is_apart, 0.1, range(1, 5)))
    assert np.mean(np.isclose(gains, best)) >= 0.5
    assert sum(gains) >= 0.9 * sum(best)


@pytest.mark.parametrize("seed", range(20))
def test_exchanges_keep_the_budget_and_never_lose(seed: int) -> None:
    """Few tiles and small budgets, where steps of hulls leave much unused; all choices are tried."""
    rng = np.random.default_rng(seed)
    cost = np.sort(rng.integers(1, 60, (5, 3)), axis=1).astype(float)
    value = np.sort(rng.uniform(0, 1, (5, 3)), axis=1)
    cost[rng.uniform(size=cost.shape) < 0.2] = np.inf
    weight, budget = rng.uniform(0, 2, 5), float(rng.uniform(10, 150))
    choice = choose_options(OptionHulls.of_options(cost, value), weight, budget)
    tables = [np.hstack([np.zeros((5, 1)), table]) for table in (cost, value * weight[:, None])]
    options = np.stack(np.meshgrid(*[np.arange(4)] * 5), axis=-1).reshape(-1, 5)
    costs, utilities = (table[np.arange(5), options].sum(axis=1) for table in tables)
    best = utilities[costs <= budget].max()
    rows = np.arange(5)
    assert tables[0][rows, choice.option + 1].sum() == pytest.approx(choice.cost)
    assert tables[1][rows, choice.option + 1].sum() == pytest.approx(choice.utility)
    assert choice.cost <= budget
    assert 0.97 * best <= choice.utility <= best + 1e-12
    assert choice.bound >= best - 1e-12
