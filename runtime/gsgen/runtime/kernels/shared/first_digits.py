"""Counts the first digits of sort keys where they are written, so that a sort reads them once."""

__all__ = ["FirstDigits"]

from typing import NamedTuple


class FirstDigits(NamedTuple):
    """How a kernel counts the digits of the keys that it writes, for the first pass of their sort.

    Attributes:
        values: Number of digits.
        block: Keys of a column of the histogram.
    """

    values: int
    block: int

    @property
    def constants(self) -> dict[str, int]:
        """The constants of ``first_digits.wgsl``."""
        return {"DIGITS": self.values, "SORT_BLOCK": self.block}
