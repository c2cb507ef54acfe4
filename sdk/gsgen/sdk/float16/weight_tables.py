"""A table of weights in 16 bits a number: as float16, or in even steps from column to column.

Float16 rounds to 11 significant bits wherever a number lies; 65,536 even steps between the least and
the largest number of a column are finer for what fills its range: positions in a scene, logarithms
of scales, features. Which of the two is closer is measured table by table. Rows, or the channels of
a plane, have steps of their own where that is twice as fine. Tables are read block by block, so that
one of a hundred million numbers takes little more memory than its 16 bits a number.
"""

__all__ = ["LEAST_ELEMENTS", "HalfTable", "half_table"]

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

_STEPS = 65535
# A step below this is zero where a processor flushes subnormal numbers.
_LEAST_STEP = float(np.finfo(np.float32).tiny)
# A smaller table saves less than the nodes that read its steps take.
LEAST_ELEMENTS = 4096
# A column of fewer numbers saves less than its own step and start take.
_LEAST_ROWS = 64
# How much finer, squared, steps along another axis than the last must be, since there are more.
_FINER = 4
# Numbers that are worked on at a time.
_BLOCK = 1 << 18

Block = tuple[slice, slice, slice]


@dataclass(frozen=True, slots=True)
class HalfTable:
    """A table of 16 bits a number.

    Attributes:
        numbers: float16, or the steps as uint16; of the table's shape.
        step: Size of a step, float32 [columns], [] for all, or of another axis, such as [rows, 1];
            None with float16.
        start: Where step 0 lies; likewise.
    """

    numbers: np.ndarray
    step: Float32[np.ndarray, "..."] | None = None
    start: Float32[np.ndarray, "..."] | None = None

    @property
    def decoded(self) -> Float32[np.ndarray, "..."]:
        """What a reader makes of it, by the same float32 arithmetic as the graph's."""
        numbers = self.numbers.astype(np.float32)
        if self.step is None or self.start is None:
            return numbers
        return np.asarray(numbers * self.step + self.start)


def half_table(array: Float32[np.ndarray, "..."], *, in_steps: bool = True) -> HalfTable:
    """Return ``array``, finite and within float16's range, in whichever form is closer to it.

    Without ``in_steps``, as float16: sizes from very small to large are read relatively, and steps
    that are closer by the mean square make the small ones zero.
    """
    if in_steps and array.size >= LEAST_ELEMENTS:
        steps = _in_steps(array)
        if steps is not None:
            return steps
    return HalfTable(array.astype(np.float16))


def _in_steps(array: Float32[np.ndarray, "..."]) -> HalfTable | None:
    """Return ``array`` in steps, or None where float16 is as close, by the mean square."""
    axis = _axis_of_steps(array)
    start, width = _range(array, axis)
    step = (width / _STEPS).astype(np.float32)
    step[step < _LEAST_STEP] = 0
    rows = 1 if axis is None else _size(array.shape[:axis])
    flat = array.reshape(rows, start.size, -1)
    numbers = np.empty(flat.shape, np.uint16)
    gained = 0.0
    for block in _blocks(flat.shape):
        part, low = flat[block], start.reshape(-1, 1)[block[1]]
        size = step.reshape(-1, 1)[block[1]]
        places = np.divide(part - low, size, out=np.zeros_like(part), where=size > 0)
        made = HalfTable(np.clip(np.rint(places), 0, _STEPS).astype(np.uint16), size, low)
        gained += _error(HalfTable(part.astype(np.float16)), part) - _error(made, part)
        numbers[block] = made.numbers
    if gained <= 0:
        return None
    shape = () if axis is None else (start.size, *[1] * (array.ndim - 1 - axis))
    return HalfTable(
        numbers.reshape(array.shape), step.reshape(shape), start.reshape(shape)
    )


def _axis_of_steps(array: Float32[np.ndarray, "..."]) -> int | None:
    """Return the axis that has steps of its own for each of its places; None where all share one."""
    last = array.ndim - 1
    axes = [k for k, n in enumerate(array.shape) if 1 < n <= array.size // _LEAST_ROWS]
    coarse = {k: float(np.square(_range(array, k)[1]).mean()) for k in axes}
    for axis in coarse.keys() - {last}:
        coarse[axis] *= _FINER
    return min(reversed(axes), key=lambda axis: coarse[axis], default=None)


def _range(
    array: Float32[np.ndarray, "..."], axis: int | None
) -> tuple[Float32[np.ndarray, " k"], np.ndarray]:
    """Return the least number at each place of ``axis``, and how far the largest is from it."""
    others = tuple(k for k in range(array.ndim) if k != axis)
    least = np.atleast_1d(array.min(axis=others))
    return least, np.atleast_1d(array.max(axis=others)).astype(np.float64) - least


def _size(shape: tuple[int, ...]) -> int:
    return int(np.prod(shape, dtype=np.int64))


def _blocks(shape: tuple[int, int, int]) -> Iterator[Block]:
    """Cut ``shape`` into blocks of about :data:`_BLOCK` numbers."""
    _, middle, inner = shape
    sizes = (max(1, _BLOCK // (middle * inner)), max(1, _BLOCK // inner), _BLOCK)
    for place in np.ndindex(*(-(-n // size) for n, size in zip(shape, sizes, strict=True))):
        first, second, third = (
            slice(k * size, (k + 1) * size) for k, size in zip(place, sizes, strict=True)
        )
        yield first, second, third


def _error(table: HalfTable, array: Float32[np.ndarray, "..."]) -> float:
    """Return the sum of squares of what a reader sees wrong."""
    return float(np.square(table.decoded - array, dtype=np.float64).sum())
