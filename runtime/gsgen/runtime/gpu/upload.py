"""Uploads rows of an array into a GPU buffer, in blocks where the device maps its memory."""

__all__ = ["Target", "upload"]

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Shaped, UInt32

from gsgen.runtime.gpu.device import MAPPED_ALIGNMENT, Device
from gsgen.runtime.gpu.handles import Buffer

_BLOCK_ROWS: Final = 1 << 13  # rows that are converted at a time, so that they stay in the cache


@final
@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The rows of a GPU buffer that an upload writes.

    Attributes:
        buffer: A buffer of ``Device.dynamic_storage``.
        first: Index of the first row.
        size: Bytes of a row.
        convert: Converts rows of an array to rows of the buffer; None if they are equal bit by bit.
    """

    buffer: Buffer
    first: int
    size: int
    convert: Callable[[Shaped[np.ndarray, "n c"]], Shaped[np.ndarray, "n d"]] | None = None


def upload(
    device: Device,
    target: Target,
    array: Shaped[np.ndarray, "n c"],
    order: UInt32[np.ndarray, " m"] | None = None,
) -> None:
    """Write rows of an array into a GPU buffer that no submitted work uses.

    A buffer that this process can map is written block by block, so that a block is still in the
    cache when it is copied. Elsewhere wgpu copies the rows to memory that it allocates for that,
    and from there to the device.

    Args:
        device: Device of the buffer.
        target: Rows of the buffer.
        array: All rows.
        order: Indices of the rows to write, in order; all rows if None.
    """
    start = target.first * target.size
    if device.can_map(target.buffer) and start % MAPPED_ALIGNMENT == 0:
        device.write_mapped(
            target.buffer, _convert_blocks(target, array, order, _BLOCK_ROWS), start
        )
        return
    for rows in _convert_blocks(target, array, order, max(1, len(array))):
        device.write(target.buffer, rows, start)


def _convert_blocks(
    target: Target,
    array: Shaped[np.ndarray, "n c"],
    order: UInt32[np.ndarray, " m"] | None,
    length: int,
) -> Iterator[Shaped[np.ndarray, "b d"]]:
    """Yield the rows to write, ``length`` at a time, as the buffer stores them."""
    count = len(array) if order is None else len(order)
    for first in range(0, count, length):
        part = slice(first, first + length)
        rows = array[part] if order is None else array.take(order[part], axis=0)
        yield np.ascontiguousarray(rows if target.convert is None else target.convert(rows))
