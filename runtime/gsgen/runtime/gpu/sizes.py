"""Arithmetic of GPU buffer and dispatch sizes, which may be numbers or symbolic formulas."""

__all__ = ["symbolic_max"]


def symbolic_max(value: int, least: int) -> int:
    """Return the larger of two integers without comparing them, since a size may be a formula.

    ``max`` compares, and a comparison of recorded sizes is a branch that holds for some of them
    only. Sums and absolute values are recorded as a formula for all sizes (tools/web_client).
    """
    return least + (value - least + abs(value - least)) // 2
