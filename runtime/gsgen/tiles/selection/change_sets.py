"""Finds a few changes of the chosen tiles that together fit a budget and add most utility."""

__all__ = ["CORE_CHANGES", "LEAST_GAIN", "MOST_ROUNDS", "best_changes"]

from typing import Final

import numpy as np
from jaxtyping import Bool, Float64

CORE_CHANGES: Final = 64
"""Changes that are combined: their 2,000 pairs take half a millisecond."""

MOST_ROUNDS: Final = 12
"""Rounds after which a choice is not improved further."""

LEAST_GAIN: Final = 1e-12
"""Gain of a set of changes, as a share of the utility, below which it is rounding."""


def best_changes(
    cost: Float64[np.ndarray, " m"],
    utility: Float64[np.ndarray, " m"],
    is_apart: Bool[np.ndarray, "m m"],
    left: float,
    least_gain: float,
) -> list[int]:
    """Return up to four changes of chosen tiles that add most utility within the remaining budget.

    The four are two pairs: sorted sums give each pair the best other pair that the rest of the
    budget holds (Horowitz and Sahni 1974). Where both share a tile, the pair stays alone: the
    result is at least the best pair, and mostly the best four.

    Args:
        cost: What each change costs; negative for savings.
        utility: What it gains.
        is_apart: Which changes touch different tiles, so that both can be made.
        left: The most that they may cost together.
        least_gain: Utility that they gain at least.
    """
    # The change 0 is none at all, so that pairs are single changes, too.
    cost, utility = np.append(0.0, cost), np.append(0.0, utility)
    is_apart = np.pad(is_apart, (1, 0), constant_values=True)
    first, second = np.nonzero(np.triu(is_apart))
    pair_cost, pair_utility = cost[first] + cost[second], utility[first] + utility[second]
    # 1. Pairs by rising cost, and the best pair of each cost or less.
    order = np.argsort(pair_cost, kind="stable")
    is_record = pair_utility[order] >= np.maximum.accumulate(pair_utility[order])
    records = np.maximum.accumulate(np.where(is_record, np.arange(len(order)), 0))
    # 2. The partner of each pair; none (the pair 0) if both share a tile.
    last = np.searchsorted(pair_cost[order], left - pair_cost, side="right") - 1
    partner = order[records[last]]
    for own in (first, second):
        for other in (first, second):
            partner[~is_apart[own, other[partner]]] = 0
    fits = pair_cost + pair_cost[partner] <= left
    gain = np.where(fits, pair_utility + pair_utility[partner], -np.inf)
    pair = int(gain.argmax())
    if gain[pair] <= least_gain:
        return []
    pairs = np.array([pair, partner[pair]])
    return [int(change) - 1 for change in {*first[pairs], *second[pairs]} if change]
