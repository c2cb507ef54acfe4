"""Sorts points along a Morton curve: neighbours in space become neighbours in memory."""

__all__ = ["morton_sorted_indices"]

from typing import Final

import numpy as np
from jaxtyping import Float, Int64

from gsgen.formats.shared.morton import interleave_bits

_COORDINATE_BITS: Final = 21  # of each coordinate at most: three coordinates fill a word of 64 bits
_BLOCK_POINTS: Final = 1 << 14  # points at a time, so that their codes stay in the cache
_MIN_BOX_SIDE: Final = 1e-30  # least side of the bounding box, against division by zero


def morton_sorted_indices(position: Float[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the order of points along a Z-order curve (Morton 1966) through their bounding box.

    Points that are not finite come first; points of the same cell keep their order.
    """
    columns = position.T.astype(np.float64, order="C")
    finite = np.isfinite(columns).all(axis=0)
    if not finite.any():
        return np.arange(len(position))
    columns[:, ~finite] = columns[:, finite.argmax()][:, None]  # without effect on the box
    low, high = columns.min(axis=1, keepdims=True), columns.max(axis=1, keepdims=True)
    columns[:, ~finite] = low
    # Sorting words of a code and an index is many times as fast as sorting indices by codes.
    index_bits = len(position).bit_length()
    bits = min(_COORDINATE_BITS, (64 - index_bits) // 3)
    scale = ((1 << bits) - 1) / max(float((high - low).max()), _MIN_BOX_SIDE)
    morton_codes = np.arange(len(position), dtype=np.uint64)
    for start in range(0, len(position), _BLOCK_POINTS):
        part = slice(start, start + _BLOCK_POINTS)
        code = interleave_bits(*((columns[:, part] - low) * scale).astype(np.uint64))
        morton_codes[part] |= code << np.uint64(index_bits)
    morton_codes.sort()
    return (morton_codes & np.uint64((1 << index_bits) - 1)).astype(np.int64)
