"""Uploads rows of an array into a GPU buffer with as few copies as the device allows."""

__all__ = ["Target", "upload"]

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Shaped, UInt32

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer

_BLOCK: Final = 1 << 13  # rows that are converted at a time, so that they stay in the cache


@final
@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The rows of a GPU buffer that an upload writes.

    Attributes:
        buffer: A buffer of ``Device.dynamic_storage``.
        first: Index of the first row.
        size: Bytes of a row.
        make: Converts rows of an array to rows of the buffer; None if they are equal bit by bit.
    """

    buffer: Buffer
    first: int
    size: int
    make: Callable[[Shaped[np.ndarray, "n c"]], Shaped[np.ndarray, "n d"]] | None = None


def upload(
    device: Device,
    target: Target,
    array: Shaped[np.ndarray, "n c"],
    order: UInt32[np.ndarray, " m"] | None = None,
) -> None:
    """Write rows of an array into a GPU buffer that no submitted work uses.

    Into a mapped buffer, one copy reorders and writes the rows. Elsewhere wgpu copies them to
    memory that it allocates for that, and from there to the device.

    Args:
        device: Device of the buffer.
        target: Rows of the buffer.
        array: All rows.
        order: Indices of the rows to write, in order; all rows if None.
    """
    start, make = target.first * target.size, target.make
    count = len(array) if order is None else len(order)
    if not device.can_map(target.buffer):
        rows = array if order is None else array.take(order, axis=0)
        device.write(target.buffer, rows if make is None else make(rows), start)
        return
    with device.mapped(target.buffer, start, count * target.size) as memory:
        if make is None:
            destination = memory.view(array.dtype).reshape(count, -1)
            _copy(array, order, destination)
            return
        for first in range(0, count, _BLOCK):
            part = slice(first, first + _BLOCK)
            rows = array[part] if order is None else array.take(order[part], axis=0)
            destination = memory[first * target.size : (first + len(rows)) * target.size]
            destination[:] = make(rows).reshape(-1).view(np.uint8)


def _copy(
    array: Shaped[np.ndarray, "n c"],
    order: UInt32[np.ndarray, " m"] | None,
    destination: Shaped[np.ndarray, "m c"],
) -> None:
    if order is None:
        np.copyto(destination, array)
    else:  # only mode="clip" writes without a copy between; all indices are within the array
        array.take(order, axis=0, out=destination, mode="clip")
