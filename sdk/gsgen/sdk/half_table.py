"""A table of weights in 16 bits a number: as float16, or in even steps from column to column.

Float16 rounds to 11 significant bits wherever a number lies; 65,536 even steps between the least and
the largest number of a column are finer for what fills its range: positions in a scene, logarithms
of scales, features. Which of the two is closer is measured table by table.
"""

__all__ = ["LEAST_ELEMENTS", "HalfTable", "half_table"]

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

_STEPS = 65535
# A smaller table saves less than the nodes that read its steps take.
LEAST_ELEMENTS = 4096
# A column of fewer numbers saves less than its own step and start take.
_LEAST_ROWS = 64


@dataclass(frozen=True, slots=True)
class HalfTable:
    """A table of 16 bits a number.

    Attributes:
        numbers: float16, or the steps as uint16; of the table's shape.
        step: Size of a step, float32 [columns], or [] for all; None with float16.
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


def half_table(array: Float32[np.ndarray, "..."]) -> HalfTable:
    """Return ``array``, finite and within float16's range, in whichever form is closer to it."""
    half = HalfTable(array.astype(np.float16))
    if array.size < LEAST_ELEMENTS:
        return half
    steps = _in_steps(array)
    return steps if _error(steps, array) < _error(half, array) else half


def _in_steps(array: Float32[np.ndarray, "..."]) -> HalfTable:
    columns = array.ndim > 1 and array.size >= _LEAST_ROWS * array.shape[-1]
    axes = tuple(range(array.ndim - 1)) if columns else None
    start = array.min(axis=axes)
    step = ((array.max(axis=axes).astype(np.float64) - start) / _STEPS).astype(np.float32)
    places = np.divide(array - start, step, out=np.zeros_like(array), where=step > 0)
    numbers = np.clip(np.rint(places), 0, _STEPS).astype(np.uint16)
    return HalfTable(numbers, step, start)


def _error(table: HalfTable, array: Float32[np.ndarray, "..."]) -> float:
    """Return the mean square of what a reader sees wrong."""
    return float(np.square(table.decoded - array, dtype=np.float64).mean())
