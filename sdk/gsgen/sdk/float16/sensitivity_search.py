"""Which of many parts can be given up together: search by measuring, within a budget."""

__all__ = ["Search", "Sensitivity", "max_quantizable"]

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

# A part that uses up no more than this share of what is allowed need not be looked into.
_HARMLESS = 0.02


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """What giving up some units, and no others, costs.

    Attributes:
        units: Their numbers, neighbours in the graph.
        excess: The error over what is allowed.
        field: Where the error is largest.
    """

    units: tuple[int, ...]
    excess: float
    field: str


@dataclass(frozen=True, slots=True)
class Search:
    """What was found.

    Attributes:
        quantized: Numbers of the units that can all be given up at once.
        kept: The others, each group with what it would have cost alone.
        measured: How many choices were measured.
    """

    quantized: frozenset[int]
    kept: tuple[Sensitivity, ...]
    measured: int


Measure = Callable[[Collection[int]], tuple[float, str]]


def max_quantizable(
    units: Sequence[int], measure: Measure, *, budget: int = 200, allowed: float = 1.0
) -> Search:
    """Find many units that can be given up together with an excess of at most ``allowed``.

    First groups of neighbours are measured alone and halved, the most costly first, until each is a
    single unit or costs next to nothing. Then they are given up in the order of their cost: as many
    as possible at once (found by bisection), and of the rest every one that still fits.

    Args:
        units: Numbers of the units, neighbours in the graph side by side.
        measure: Returns the excess of giving up these units, and the field it is seen in.
        budget: How many choices may be measured; the last stage ends early beyond it.
        allowed: The largest excess of the result.
    """
    count = 0

    def costs(group: Collection[int]) -> tuple[float, str]:
        nonlocal count
        count += 1
        return measure(group)

    if not units:
        return Search(frozenset(), (), 0)
    excess, field = costs(units)
    if excess <= allowed:
        return Search(frozenset(units), (), count)
    groups = [Sensitivity(tuple(units), excess, field)]
    while count + 2 <= budget // 2:
        costly = [
            g for g in groups if len(g.units) > 1 and not g.excess <= _HARMLESS * allowed
        ]
        if not costly:
            break
        worst = max(costly, key=lambda g: g.excess)
        groups.remove(worst)
        middle = len(worst.units) // 2
        for half in (worst.units[:middle], worst.units[middle:]):
            groups.append(Sensitivity(half, *costs(half)))
    groups.sort(key=lambda g: (g.excess, g.units))
    return _fill(groups, costs, allowed, lambda: count, budget)


def _fill(
    groups: list[Sensitivity],
    costs: Measure,
    allowed: float,
    counted: Callable[[], int],
    budget: int,
) -> Search:
    low, high = 0, sum(group.excess <= allowed for group in groups)
    while low < high:  # the first `low` groups fit, by what was measured
        middle = (low + high + 1) // 2
        if costs(_joined(groups[:middle]))[0] <= allowed:
            low = middle
        else:
            high = middle - 1
    given, kept = list(groups[:low]), []
    for group in groups[low:]:
        fits = group.excess <= allowed and counted() < budget
        if fits and costs(_joined([*given, group]))[0] <= allowed:
            given.append(group)
        else:
            kept.append(group)
    return Search(frozenset(_joined(given)), tuple(kept), counted())


def _joined(groups: Sequence[Sensitivity]) -> list[int]:
    return [unit for group in groups for unit in group.units]
