"""Searches for many nodes or weights that can be quantized together, with few measurements."""

__all__ = ["Sensitivity", "SensitivitySearch", "max_quantizable"]

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

# A group that uses at most this share of the tolerance is not split further.
_NEGLIGIBLE_SHARE = 0.02


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """The output error if only the listed nodes or weight tables are quantized."""

    units: tuple[int, ...]  # indices of the units, neighbours in the graph
    excess: float  # the error as a share of the tolerance
    field: str  # the field with the largest error


@dataclass(frozen=True, slots=True)
class SensitivitySearch:
    """The result of a sensitivity search: the nodes or weights to quantize, and the errors."""

    quantized: frozenset[int]  # indices of the units that can be quantized together
    # the other units, in groups, each with its error if quantized alone
    retained: tuple[Sensitivity, ...]
    measured: int  # number of measured choices


MeasureError = Callable[[Collection[int]], tuple[float, str]]


def max_quantizable(
    units: Sequence[int], measure: MeasureError, *, budget: int = 200, allowed: float = 1.0
) -> SensitivitySearch:
    """Find many nodes or weight tables to quantize together within an allowed output error.

    Step 1: all units together.
    Step 2: groups of neighbours are measured alone and halved, the most costly first, until each
    is a single unit or costs next to nothing.
    Step 3: as many groups as possible are quantized at once, in the order of their cost, by
    bisection.
    Step 4: each of the other groups is added if the error stays small enough.

    ``measure`` returns the error, as a share of the tolerance, and the field that has it.
    ``budget`` limits its calls; step 4 ends early beyond it.
    """
    count = 0

    def measure_cost(group: Collection[int]) -> tuple[float, str]:
        nonlocal count
        count += 1
        return measure(group)

    if not units:
        return SensitivitySearch(frozenset(), (), 0)
    excess, field = measure_cost(units)
    if excess <= allowed:
        return SensitivitySearch(frozenset(units), (), count)
    groups = [Sensitivity(tuple(units), excess, field)]
    while count + 2 <= budget // 2:
        costly_groups = [
            g for g in groups if len(g.units) > 1 and not g.excess <= _NEGLIGIBLE_SHARE * allowed
        ]
        if not costly_groups:
            break
        worst_group = max(costly_groups, key=lambda g: g.excess)
        groups.remove(worst_group)
        midpoint = len(worst_group.units) // 2
        for half_of_units in (worst_group.units[:midpoint], worst_group.units[midpoint:]):
            groups.append(Sensitivity(half_of_units, *measure_cost(half_of_units)))
    groups.sort(key=lambda g: (g.excess, g.units))
    return _choose_groups(groups, measure_cost, allowed, lambda: count, budget)


def _choose_groups(
    groups: list[Sensitivity],
    measure_cost: MeasureError,
    allowed: float,
    call_count: Callable[[], int],
    budget: int,
) -> SensitivitySearch:
    low, high = 0, sum(group.excess <= allowed for group in groups)
    # Step 3: the first `low` groups together were measured to fit.
    while low < high:
        midpoint = (low + high + 1) // 2
        if measure_cost(_units_of_groups(groups[:midpoint]))[0] <= allowed:
            low = midpoint
        else:
            high = midpoint - 1
    quantized, retained = list(groups[:low]), []
    for group in groups[low:]:
        is_group_allowed = group.excess <= allowed and call_count() < budget
        if is_group_allowed and measure_cost(_units_of_groups([*quantized, group]))[0] <= allowed:
            quantized.append(group)
        else:
            retained.append(group)
    return SensitivitySearch(frozenset(_units_of_groups(quantized)), tuple(retained), call_count())


def _units_of_groups(groups: Sequence[Sensitivity]) -> list[int]:
    return [unit for group in groups for unit in group.units]
