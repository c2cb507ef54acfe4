"""NumPy references of the sorting kernels: what each shader must return."""

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.kernels.sort.scan import MAX_COUNT


def first_digits_reference(
    keys: UInt32[np.ndarray, " n"], digits: FirstDigits
) -> UInt32[np.ndarray, "values blocks"]:
    """Count the first digits of keys by block: reference of ``first_digits.wgsl``."""
    table = np.zeros((digits.values, max(1, -(-len(keys) // digits.block))), np.uint32)
    present = np.flatnonzero(keys != NO_ID)
    np.add.at(table, (keys[present] % digits.values, present // digits.block), 1)
    return table


def sort_reference(keys: UInt32[np.ndarray, " n"], bits: int) -> UInt32[np.ndarray, " m"]:
    """Return the indices of the drawn Gaussians, sorted by key: the reference of the GPU sorts."""
    present = np.flatnonzero(keys != NO_ID)
    order = np.argsort(keys[present] & ((1 << bits) - 1), kind="stable")
    return present[order].astype(np.uint32)


def scan_reference(numbers: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
    """Return exclusive prefix sums, which saturate at 2³¹ − 1: the reference of ``scan.wgsl``."""
    before = np.cumsum(numbers, dtype=np.uint64) - numbers
    return np.asarray(np.minimum(before, MAX_COUNT), np.uint32)


def order_ties_reference(
    keys: UInt32[np.ndarray, " n"],
    lows: UInt32[np.ndarray, " m"],
    origins: UInt32[np.ndarray, " m"],
    order: UInt32[np.ndarray, " n"],
) -> UInt32[np.ndarray, " n"]:
    """Sort splats by float32 depth, its rounding error and splat set, like ``order_ties.wgsl``."""
    return order[np.lexsort((origins[order], lows[order], keys))]


def gather_reference(
    keys: UInt32[np.ndarray, " m"], order: UInt32[np.ndarray, " n"]
) -> UInt32[np.ndarray, " n"]:
    """Gather the splats' second sort keys in sorted order: reference of ``gather_keys.wgsl``."""
    return np.asarray(keys[order])
