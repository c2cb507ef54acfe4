"""How far two executions of a generator are apart, field by field, in the units of tolerances."""

__all__ = ["FieldError", "apart", "comparable"]

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.spec.layout import (
    APPEARANCE_CHANNELS,
    COVARIANCE,
    CULL_OPACITY,
    OPACITY,
    POSITION,
    VISIBILITY,
)
from gsgen.contract.spec.spherical_harmonics import basis, degree_of, largest_sum
from gsgen.contract.validation.report import Tolerance

# Relative errors that the storage of both may add, and kernels that sum in another order.
_ROUNDING = {"float16": 2.0**-10, "float32": 2.0**-20}
# What float16 and float32 cannot tell from nothing, once for each of both.
_TINY = {"float16": 2.0**-23, "float32": 2.0**-148}
_TRACE_COLUMNS = [4, 7, 9]
_NOTHING = 1e-30
_AXES = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True, slots=True)
class FieldError:
    """A field in which two executions differ by more than is allowed.

    Attributes:
        tolerance: The field, and what is allowed.
        row: The worst row.
        error: How far it is apart, in the tolerance's unit.
        of_cells: The row is a cell; its visibility is measured as opacity.
    """

    tolerance: Tolerance
    row: int
    error: float
    of_cells: bool = False


def apart(
    first: ModelOutputs, second: ModelOutputs, tolerances: Sequence[Tolerance]
) -> Iterator[FieldError]:
    """Yield the fields that differ by more than their tolerance and what storage rounds.

    Rows and cells that neither draws are compared by opacity and visibility alone. Nothing comes of
    outputs that are no packed rows, or of another size; other rules say so.
    """
    rows = first.gaussians
    judged, _, cells = comparable(first, second)
    if not judged or rows is None or not len(rows):
        return
    yield from _beyond(dict(_measured(first, second)), tolerances, of_cells=False)
    if cells:
        yield from _beyond(dict(_cells_measured(first, second)), tolerances, of_cells=True)


def _beyond(
    measured: "dict[str, Measured]", tolerances: Sequence[Tolerance], *, of_cells: bool
) -> Iterator[FieldError]:
    for tolerance in tolerances:
        if tolerance.field not in measured:
            continue
        error, rounding = measured[tolerance.field]
        explained = np.nan_to_num(
            rounding, posinf=0.0
        )  # the same NaN on both sides is no error
        excess = np.where(np.isfinite(error), error - explained, np.inf)
        if excess.max() > tolerance.value:
            row = int(np.argmax(excess))
            yield FieldError(tolerance, row, float(error[row]), of_cells)


def comparable(first: ModelOutputs, second: ModelOutputs) -> tuple[bool, bool, bool]:
    """Say whether packed rows, colours and cells can each be compared field by field."""
    rows, others = first.gaussians, second.gaussians
    if rows is None or others is None or rows.shape != others.shape:
        return False, False, False
    cells, peers = first.cells, second.cells
    both = cells is not None and peers is not None and cells.shape == peers.shape
    color, other = first.appearance, second.appearance
    if color is None or other is None or color.shape != other.shape:
        return True, False, both
    known = color.shape[1] in APPEARANCE_CHANNELS["sh" if first.is_sh else "rgb"]
    return True, known, both


Measured = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


def _measured(first: ModelOutputs, second: ModelOutputs) -> Iterator[tuple[str, Measured]]:
    """Yield each field's error and what rounding explains of it, row by row."""
    assert first.gaussians is not None
    assert second.gaussians is not None
    a, b = (one.astype(np.float64) for one in (first.gaussians, second.gaussians))
    dtype = first.gaussians.dtype.name
    shown = (a[:, OPACITY] >= CULL_OPACITY) | (b[:, OPACITY] >= CULL_OPACITY)
    yield from _packed_measured(a, b, shown, dtype)
    color, other = first.appearance, second.appearance
    if color is not None and other is not None and comparable(first, second)[1]:
        c, d = color.astype(np.float64), other.astype(np.float64)
        error, largest = _colors_apart(first.is_sh, c, d)
        yield "appearance", _where(shown, error, _ROUNDING[color.dtype.name] * largest)


def _cells_measured(
    first: ModelOutputs, second: ModelOutputs
) -> Iterator[tuple[str, Measured]]:
    """Yield the same of cells; one is drawn if it is seen and has a row that is."""
    assert first.cells is not None
    assert second.cells is not None
    a, b = (one.astype(np.float64) for one in (first.cells, second.cells))
    shown = np.zeros(len(a), bool)
    for one, cells in ((first, a), (second, b)):
        assert one.gaussians is not None
        opacity = one.gaussians[:, OPACITY].astype(np.float64)
        most = opacity.reshape(len(cells), -1).max(axis=1)
        shown |= ~(most * cells[:, VISIBILITY] < CULL_OPACITY)  # NaN is seen
    yield from _packed_measured(a, b, shown, first.cells.dtype.name)


def _packed_measured(
    a: Float[np.ndarray, "n 10"],
    b: Float[np.ndarray, "n 10"],
    shown: Bool[np.ndarray, " n"],
    dtype: str,
) -> Iterator[tuple[str, Measured]]:
    """Yield opacity, position and covariance of rows that are packed alike."""
    rounding, tiny = _ROUNDING[dtype], _TINY[dtype]
    yield "opacity", (_distance(a, b, OPACITY), np.full(len(a), rounding))
    trace = np.maximum(a[:, _TRACE_COLUMNS].sum(axis=1), _NOTHING)
    sigma = np.sqrt(trace / 3)
    reach = np.abs(a[:, POSITION]).max(axis=1)
    place = _ratio(_distance(a, b, POSITION), sigma)
    yield "position", _where(shown, place, (rounding * reach + tiny) / sigma)
    spread = _ratio(_distance(a, b, COVARIANCE), trace)
    yield "covariance", _where(shown, spread, rounding + tiny / trace)


def _where(shown: np.ndarray, error: np.ndarray, rounding: np.ndarray) -> Measured:
    return np.where(shown, error, 0.0), rounding


def _ratio(distance: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return distances in ``unit``; none is none, whatever the unit."""
    return np.asarray(np.where(distance == 0, 0.0, distance / unit))


def _distance(a: np.ndarray, b: np.ndarray, columns: int | slice) -> np.ndarray:
    """Return the largest difference of a row; zero where both are equal, NaN included."""
    x, y = a[:, columns].reshape(len(a), -1), b[:, columns].reshape(len(b), -1)
    return np.asarray(np.abs(_difference(x, y)).max(axis=1))


def _difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return x − y, zero where both are the same, infinity and NaN included."""
    same = (x == y) | (np.isnan(x) & np.isnan(y))
    return np.asarray(np.where(same, 0.0, x - y))


def _colors_apart(is_sh: bool, a: np.ndarray, b: np.ndarray) -> Measured:
    """Return how far the colours are apart, seen along the axes, and how large they are."""
    if not is_sh:
        part = slice(0, 3)
        return _distance(a, b, part), np.abs(a[:, part]).max(axis=1)
    shape = (len(a), a.shape[1] // 3, 3)
    weights = basis(_AXES, degree_of(shape[1]))
    x, y = a.reshape(shape), b.reshape(shape)
    between = _difference(x, y)
    return largest_sum(weights, between), largest_sum(np.abs(weights), np.abs(x))
