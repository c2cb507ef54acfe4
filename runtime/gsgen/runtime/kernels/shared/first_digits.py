"""Counts the first digits of sort keys where they are written, so that a sort reads them once."""

__all__ = ["FirstDigits", "first_digits_reference"]

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.kernels.shared.shader import ABSENT


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


def first_digits_reference(
    keys: UInt32[np.ndarray, " n"], digits: FirstDigits
) -> UInt32[np.ndarray, "values blocks"]:
    """Count the first digits of keys by block: reference of ``first_digits.wgsl``."""
    table = np.zeros((digits.values, max(1, -(-len(keys) // digits.block))), np.uint32)
    present = np.flatnonzero(keys != ABSENT)
    np.add.at(table, (keys[present] % digits.values, present // digits.block), 1)
    return table
