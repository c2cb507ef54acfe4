"""Arithmetic of buffer sizes and dispatches that also works on sizes recorded as formulas."""

__all__ = ["at_least"]


def at_least(value: int, least: int) -> int:
    """Return the larger of two integers without a comparison, so that it can be a formula.

    ``max`` compares, and a comparison of recorded sizes is a branch that holds for some of them
    only. Sums and absolute values are recorded as a formula for all sizes (gsgen.runtime.web).
    """
    return least + (value - least + abs(value - least)) // 2
