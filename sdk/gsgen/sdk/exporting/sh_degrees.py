"""Which degrees of spherical harmonics consumers take."""

__all__ = ["ONE_DEGREE", "taken_degree"]

from collections.abc import Mapping
from typing import Final

ONE_DEGREE: Final[Mapping[str, int]] = {"visionary": 3}
"""Consumers that read rows of one width alone (rule TV104)."""


def taken_degree(degree: int, *, half: bool, target: str = "core") -> tuple[int, str]:
    """Return the degree to write, and why in words; nothing where it is that of the harmonics.

    Rows of float16 have to fill words of four bytes (rule GO015), which those of degree 0 and 2
    do not; and some consumers read one degree alone. Coefficients of 0 show nothing.

    Args:
        degree: Of the harmonics.
        half: Rows are float16.
        target: The consumer.
    """
    if target in ONE_DEGREE:
        taken, why = ONE_DEGREE[target], f"{target} reads no other"
    else:
        taken, why = degree + (half and degree % 2 == 0), "rows fill words"
    if taken == degree:
        return degree, ""
    return taken, f"SH of degree {degree} are written as degree {taken}: {why}"
