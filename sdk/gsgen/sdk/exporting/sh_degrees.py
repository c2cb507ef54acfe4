"""Chooses the SH degree to store, by row alignment and for viewers that read one degree only."""

__all__ = ["HALF_RGB", "REQUIRED_DEGREES", "stored_degree"]

from collections.abc import Mapping
from typing import Final

REQUIRED_DEGREES: Final[Mapping[str, int]] = {"visionary": 3}
"""Consumers that read rows of one width alone (rule TV104)."""


HALF_RGB: Final = frozenset({"visionary"})
"""Consumers that read RGB as float16 alone (rule TV104)."""


def stored_degree(degree: int, *, half: bool, target: str = "core") -> tuple[int, str]:
    """Return the SH degree to store, and the reason if the Gaussians have another degree.

    Rows of float16 must fill words of four bytes (rule GO015), which degrees 0 and 2 do not. Some
    consumers read one degree alone. The added coefficients are zero.
    """
    if target in REQUIRED_DEGREES:
        stored, reason = REQUIRED_DEGREES[target], f"{target} reads no other"
    else:
        stored, reason = degree + (half and degree % 2 == 0), "rows fill words"
    if stored == degree:
        return degree, ""
    return stored, f"SH of degree {degree} are written as degree {stored}: {reason}"
