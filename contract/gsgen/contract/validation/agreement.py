"""Compares two runs of an ONNX generator field by field, in the units of the tolerances."""

__all__ = ["FieldError", "comparable_parts", "field_errors"]

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.spec.layout import (
    APPEARANCE_CHANNELS,
    COVARIANCE,
    CULL_OPACITY,
    OPACITY,
    POSITION,
    VARIANCES,
    VISIBILITY,
)
from gsgen.contract.spec.spherical_harmonics import basis, degree_of, largest_sum
from gsgen.contract.validation.report import Tolerance

# Relative errors that rounding to the storage type and another summation order may cause.
_ROUNDING = {"float16": 2.0**-10, "float32": 2.0**-20}
# The smallest difference that float16 and float32 can store, once for each execution.
_TINY = {"float16": 2.0**-23, "float32": 2.0**-148}
_SMALLEST_TRACE = 1e-30
# At a time: copies of all rows would take several times the memory of the outputs.
_COMPARED_ROWS = 1 << 16
_AXES = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True, slots=True)
class FieldError:
    """A field of the Gaussians in which two runs of a model differ beyond the tolerance.

    Attributes:
        tolerance: The field and its largest allowed difference.
        row: The worst row.
        error: The difference, in the tolerance's unit.
        of_cells: The row is a cell, whose visibility is compared as opacity.
    """

    tolerance: Tolerance
    row: int
    error: float
    of_cells: bool = False


def field_errors(
    first: ModelOutputs,
    second: ModelOutputs,
    tolerances: Sequence[Tolerance],
    *,
    roundings: int = 1,
) -> Iterator[FieldError]:
    """Yield the fields of Gaussians in which two runs differ beyond tolerance and rounding.

    Rows and cells that neither execution draws are compared by opacity and visibility alone.
    Outputs of another size, or without packed rows, yield no error: other rules report them.
    Rounding to the storage type of ``first`` is allowed for ``roundings`` times.
    """
    rows = first.gaussians
    has_rows, _, cells = comparable_parts(first, second)
    if not has_rows or rows is None or not len(rows):
        return
    measured = (
        (start, name, error)
        for start in range(0, len(rows), _COMPARED_ROWS)
        for name, error in _measured(first, second, slice(start, start + _COMPARED_ROWS))
    )
    yield from _beyond(measured, tolerances, roundings, of_cells=False)
    if cells:
        cell_errors = ((0, name, error) for name, error in _cells_measured(first, second))
        yield from _beyond(cell_errors, tolerances, roundings, of_cells=True)


def _beyond(
    measured: "Iterable[tuple[int, str, Measured]]",
    tolerances: Sequence[Tolerance],
    roundings: int,
    *,
    of_cells: bool,
) -> Iterator[FieldError]:
    """Yield the fields beyond tolerance, from the errors of blocks and the blocks' first rows."""
    worst: dict[str, tuple[float, int, float]] = {}  # excess, row and error of each field
    for start, name, (error, rounding) in measured:
        # NaN on both sides has error 0 and an undefined rounding.
        explained = roundings * np.nan_to_num(rounding, posinf=0.0)
        excess = np.where(np.isfinite(error), error - explained, np.inf)
        row = int(np.argmax(excess))
        if name not in worst or excess[row] > worst[name][0]:
            worst[name] = float(excess[row]), start + row, float(error[row])
    for tolerance in tolerances:
        if tolerance.field in worst and worst[tolerance.field][0] > tolerance.value:
            yield FieldError(tolerance, *worst[tolerance.field][1:], of_cells)


def comparable_parts(first: ModelOutputs, second: ModelOutputs) -> tuple[bool, bool, bool]:
    """Return whether Gaussians, colours and groups of Gaussians can be compared field by field."""
    rows, second_rows = first.gaussians, second.gaussians
    if rows is None or second_rows is None or rows.shape != second_rows.shape:
        return False, False, False
    cells, peers = first.cells, second.cells
    both = cells is not None and peers is not None and cells.shape == peers.shape
    color, second_color = first.appearance, second.appearance
    if color is None or second_color is None or color.shape != second_color.shape:
        return True, False, both
    known = color.shape[1] in APPEARANCE_CHANNELS["sh" if first.is_sh else "rgb"]
    return True, known, both


Measured = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


def _measured(
    first: ModelOutputs, second: ModelOutputs, block: slice
) -> Iterator[tuple[str, Measured]]:
    """Yield per field the differences of Gaussians between two runs, and their rounding errors."""
    assert first.gaussians is not None
    assert second.gaussians is not None
    a, b = (rows[block].astype(np.float64) for rows in (first.gaussians, second.gaussians))
    dtype = first.gaussians.dtype.name
    drawn = (a[:, OPACITY] >= CULL_OPACITY) | (b[:, OPACITY] >= CULL_OPACITY)
    yield from _packed_measured(a, b, drawn, dtype)
    color, second_color = first.appearance, second.appearance
    if color is not None and second_color is not None and comparable_parts(first, second)[1]:
        c, d = color[block].astype(np.float64), second_color[block].astype(np.float64)
        error, largest = _color_errors(c, d, is_sh=first.is_sh)
        yield "appearance", _where(drawn, error, _ROUNDING[color.dtype.name] * largest)


def _cells_measured(first: ModelOutputs, second: ModelOutputs) -> Iterator[tuple[str, Measured]]:
    """Yield per field each cell's (Gaussian group's) difference between runs and rounding error."""
    assert first.cells is not None
    assert second.cells is not None
    a, b = (values.astype(np.float64) for values in (first.cells, second.cells))
    drawn = np.zeros(len(a), bool)
    for outputs, cells in ((first, a), (second, b)):
        assert outputs.gaussians is not None
        opacity = outputs.gaussians[:, OPACITY].astype(np.float64)
        most = opacity.reshape(len(cells), -1).max(axis=1)
        drawn |= ~(most * cells[:, VISIBILITY] < CULL_OPACITY)  # NaN counts as drawn
    yield from _packed_measured(a, b, drawn, first.cells.dtype.name)


def _packed_measured(
    a: Float[np.ndarray, "n 10"],
    b: Float[np.ndarray, "n 10"],
    drawn: Bool[np.ndarray, " n"],
    dtype: str,
) -> Iterator[tuple[str, Measured]]:
    """Yield the differences in opacity, position and covariance between two sets of packed rows."""
    rounding, tiny = _ROUNDING[dtype], _TINY[dtype]
    yield "opacity", (_distance(a, b, OPACITY), np.full(len(a), rounding))
    trace = np.maximum(a[:, VARIANCES].sum(axis=1), _SMALLEST_TRACE)
    sigma = np.sqrt(trace / 3)
    extent = np.abs(a[:, POSITION]).max(axis=1)
    position_error = _ratio(_distance(a, b, POSITION), sigma)
    yield "position", _where(drawn, position_error, (rounding * extent + tiny) / sigma)
    covariance_error = _ratio(_distance(a, b, COVARIANCE), trace)
    yield "covariance", _where(drawn, covariance_error, rounding + tiny / trace)


def _where(drawn: np.ndarray, error: np.ndarray, rounding: np.ndarray) -> Measured:
    return np.where(drawn, error, 0.0), rounding


def _ratio(distance: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Divide distances by a unit length; a distance of zero stays zero, even for unit 0."""
    return np.asarray(np.where(distance == 0, 0.0, distance / unit))


def _distance(a: np.ndarray, b: np.ndarray, columns: int | slice) -> np.ndarray:
    """Return the largest difference in each row of two arrays; NaN equals NaN."""
    x, y = a[:, columns].reshape(len(a), -1), b[:, columns].reshape(len(b), -1)
    return np.asarray(np.abs(_difference(x, y)).max(axis=1))


def _difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return x − y of two arrays, with zero for equal infinities and for two NaN."""
    same = (x == y) | (np.isnan(x) & np.isnan(y))
    return np.asarray(np.where(same, 0.0, x - y))


def _color_errors(a: np.ndarray, b: np.ndarray, *, is_sh: bool) -> Measured:
    """Return each Gaussian's colour difference between two runs, and the colour's magnitude."""
    if not is_sh:
        part = slice(0, 3)
        return _distance(a, b, part), np.abs(a[:, part]).max(axis=1)
    shape = (len(a), a.shape[1] // 3, 3)
    weights = basis(_AXES, degree_of(shape[1]))
    x, y = a.reshape(shape), b.reshape(shape)
    between = _difference(x, y)
    return largest_sum(weights, between), largest_sum(np.abs(weights), np.abs(x))
