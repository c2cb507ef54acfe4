"""Stores weight tables in 16 bits per number: as float16, or quantised at even spacing.

Float16 rounds every number to 11 significant bits. 65,536 even steps between the smallest and the
largest number of a column are finer for numbers that fill the range: positions in a scene,
logarithms of scales, features. The closer of the two is measured for each table. Rows, or the
channels of a plane, have steps of their own where these are twice as fine. Tables are read in
blocks, so that a hundred million numbers take little more memory than their 16 bits a number.
"""

__all__ = ["MIN_TABLE_ELEMENTS", "HalfTable", "half_table"]

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

_LARGEST_UINT16 = 65535
# A step below this is zero where a processor flushes subnormal numbers.
_MIN_STEP_SIZE = float(np.finfo(np.float32).tiny)
# A smaller table saves fewer bytes than the nodes that decode its steps take.
MIN_TABLE_ELEMENTS = 4096
# A column of fewer numbers saves fewer bytes than its step and start take.
_MIN_ROWS = 64
# How much finer, squared, steps along another axis than the last must be: these need more of them.
_AXIS_PENALTY = 4
# Numbers in a block.
_BLOCK_ELEMENTS = 1 << 18

Block = tuple[slice, slice, slice]


@dataclass(frozen=True, slots=True)
class HalfTable:
    """A weight table stored in 16 bits per number."""

    numbers: np.ndarray  # float16, or the steps as uint16; of the table's shape
    # size of a step, float32 [columns], [] for all, or of another axis, such as [rows, 1]; None
    # with float16
    step: Float32[np.ndarray, "..."] | None = None
    # the number of step 0, of the same shape as ``step``
    start: Float32[np.ndarray, "..."] | None = None

    @property
    def decoded(self) -> Float32[np.ndarray, "..."]:
        """The float32 weights that the ONNX graph decodes from the 16-bit numbers of a weight table."""
        numbers = self.numbers.astype(np.float32)
        if self.step is None or self.start is None:
            return numbers
        return np.asarray(numbers * self.step + self.start)


def half_table(array: Float32[np.ndarray, "..."], *, rounds_in_steps: bool = True) -> HalfTable:
    """Store a weight table as float16 or evenly quantised, whichever is closer to float32.

    Float16 suits sizes from very small to large: even steps may be closer by the mean square, but
    make the small numbers zero.
    """
    if rounds_in_steps and array.size >= MIN_TABLE_ELEMENTS:
        steps = _quantize_evenly(array)
        if steps is not None:
            return steps
    return HalfTable(array.astype(np.float16))


def _quantize_evenly(array: Float32[np.ndarray, "..."]) -> HalfTable | None:
    """Quantise a weight table at even spacing; None if float16 has no larger error."""
    axis = _quantization_axis(array)
    start, width = _table_range(array, axis)
    step = (width / _LARGEST_UINT16).astype(np.float32)
    step[step < _MIN_STEP_SIZE] = 0
    rows = 1 if axis is None else _size(array.shape[:axis])
    flat_table = array.reshape(rows, start.size, -1)
    numbers = np.empty(flat_table.shape, np.uint16)
    error_reduction = 0.0
    for block in _blocks(flat_table.shape):
        part, low = flat_table[block], start.reshape(-1, 1)[block[1]]
        size = step.reshape(-1, 1)[block[1]]
        steps = np.divide(part - low, size, out=np.zeros_like(part), where=size > 0)
        table = HalfTable(np.clip(np.rint(steps), 0, _LARGEST_UINT16).astype(np.uint16), size, low)
        error_reduction += _error(HalfTable(part.astype(np.float16)), part) - _error(table, part)
        numbers[block] = table.numbers
    if error_reduction <= 0:
        return None
    shape = () if axis is None else (start.size, *[1] * (array.ndim - 1 - axis))
    return HalfTable(numbers.reshape(array.shape), step.reshape(shape), start.reshape(shape))


def _quantization_axis(array: Float32[np.ndarray, "..."]) -> int | None:
    """Return the axis along which a weight table's quantisation spacing varies, or None."""
    last_axis = array.ndim - 1
    axes = [k for k, n in enumerate(array.shape) if 1 < n <= array.size // _MIN_ROWS]
    spacing_by_axis = {k: float(np.square(_table_range(array, k)[1]).mean()) for k in axes}
    for axis in spacing_by_axis.keys() - {last_axis}:
        spacing_by_axis[axis] *= _AXIS_PENALTY
    return min(reversed(axes), key=lambda axis: spacing_by_axis[axis], default=None)


def _table_range(
    array: Float32[np.ndarray, "..."], axis: int | None
) -> tuple[Float32[np.ndarray, " k"], np.ndarray]:
    """Return minimum, and maximum − minimum, of a weight table at each index of an axis."""
    other_axes = tuple(k for k in range(array.ndim) if k != axis)
    minimum = np.atleast_1d(array.min(axis=other_axes))
    return minimum, np.atleast_1d(array.max(axis=other_axes)).astype(np.float64) - minimum


def _size(shape: tuple[int, ...]) -> int:
    return int(np.prod(shape, dtype=np.int64))


def _blocks(shape: tuple[int, int, int]) -> Iterator[Block]:
    """Divide a weight table's shape into slices of limited size, to bound the memory."""
    _, column_count, inner_size = shape
    sizes = (
        max(1, _BLOCK_ELEMENTS // (column_count * inner_size)),
        max(1, _BLOCK_ELEMENTS // inner_size),
        _BLOCK_ELEMENTS,
    )
    for position in np.ndindex(*(-(-n // size) for n, size in zip(shape, sizes, strict=True))):
        row_slice, column_slice, inner_slice = (
            slice(k * size, (k + 1) * size) for k, size in zip(position, sizes, strict=True)
        )
        yield row_slice, column_slice, inner_slice


def _error(table: HalfTable, array: Float32[np.ndarray, "..."]) -> float:
    """Return the sum of squared errors of a 16-bit weight table."""
    return float(np.square(table.decoded - array, dtype=np.float64).sum())
