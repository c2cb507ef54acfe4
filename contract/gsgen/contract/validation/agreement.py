"""Compares two executions of an ONNX generator field by field: the specification's "Agreement".

Numbers in comments are those of the statements on that page (docs/spec/agreement.md).
"""

__all__ = [
    "ROWS_PER_BLOCK",
    "Allowance",
    "Errors",
    "FieldError",
    "cell_errors",
    "comparable_parts",
    "drawn_cells",
    "excess_of",
    "field_errors",
    "keep_worst",
    "live_cells",
    "row_errors",
    "tolerance_of",
    "view_directions",
]

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from typing import Final

import numpy as np

from gsgen.contract._array_types import Bool, Float, Int
from gsgen.contract.probing.differences import signed_difference
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
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.spherical_harmonics import basis, degree_of, largest_sum
from gsgen.contract.validation.report import Tolerance

DIRECTION_COUNT: Final = 64
"""Directions from which spherical harmonics are seen (statement A8)."""

ROWS_PER_BLOCK: Final = 8192
"""Rows compared at a time: copies of all rows would take several times their memory."""

# Statement 8: half a unit in the last place, and the step of the smallest numbers, of a dtype.
_ROUNDING = {"float32": 2.0**-24, "float16": 2.0**-11}
_SUBNORMAL_STEP = {"float32": 2.0**-149, "float16": 2.0**-24}
# Other kernels round differently in every step: a long chain of them adds up to this.
_ARITHMETIC_EPSILON = 2.0**-20
_MIN_COVARIANCE_TRACE = 1e-30


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldError:
    """The largest error in one field of Gaussians, such as position.

    Attributes:
        field: ``position``, ``covariance``, ``opacity`` or ``appearance``; for cells
            ``cell position``, ``cell covariance`` or ``cell visibility``.
        error: The largest error, in the field's unit.
        excess: The error divided by the allowed error; above 1, the executions do not agree.
        probe: Label of the test inputs with this error.
        row: Index of the Gaussian, or of the cell.
    """

    field: str
    error: float
    excess: float
    probe: str = ""
    row: int = 0


@dataclass(frozen=True, slots=True)
class Allowance:
    """The allowed errors: tolerances of the fields, and the rounding of stored values."""

    tolerances: Tolerances
    # how often values were rounded: 2 for two executions, 1 if the reference is not rounded
    roundings: int = 2

    def relative(self, dtype: np.dtype) -> float:
        """Return the relative error that rounding to a dtype may cause (statement A10)."""
        return self.roundings * (_ROUNDING[dtype.name] + _ARITHMETIC_EPSILON)

    def absolute(self, dtype: np.dtype) -> float:
        """Return the error that rounding to a dtype may cause near zero (statement A10)."""
        return self.roundings * 2 * _SUBNORMAL_STEP[dtype.name]


Errors = dict[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]
"""Field → the error of each row in the field's unit, and the allowed error of each row."""

ArrayPair = tuple[Float[np.ndarray, "n c"], Float[np.ndarray, "n c"]]
"""Packed rows of the reference, and of the other execution, whose dtype is that of the outputs."""


def row_errors(
    rows: ArrayPair, colors: ArrayPair | None, allowance: Allowance, *, is_sh: bool
) -> Errors:
    """Return the errors of Gaussians: packed rows and, if they can be compared, their colours."""
    # Statement 2, phrased so that a row whose opacity is NaN is compared.
    is_faint = [side[:, OPACITY].astype(np.float64) < CULL_OPACITY for side in rows]
    drawn = ~np.logical_and(*is_faint)
    errors = _ellipsoid_errors(rows, drawn, allowance)
    if colors is not None:
        errors["appearance"] = _color_errors(colors, drawn, allowance, is_sh=is_sh)
    return errors


def cell_errors(cells: ArrayPair, drawn: Bool[np.ndarray, " c"], allowance: Allowance) -> Errors:
    """Return the errors of packed cells; ``drawn`` marks those that show a Gaussian."""
    errors = _ellipsoid_errors(cells, drawn, allowance)
    return {
        f"cell {'visibility' if field == 'opacity' else field}": pair
        for field, pair in errors.items()
    }


def live_cells(count: int, rows: int, cells: int) -> int:
    """Return the number of cells (groups of Gaussians) that hold a row before the count."""
    return -(-count // (rows // cells)) if cells and rows else 0


def drawn_cells(
    opacity: Float[np.ndarray, " n"], count: int, visibility: Float[np.ndarray, " c"]
) -> Bool[np.ndarray, " c"]:
    """Return the mask of the cells that show a Gaussian (statement A5); NaN counts as shown."""
    live = np.where(np.arange(len(opacity)) < count, opacity, 0.0)
    largest = live.reshape(len(visibility), -1).max(axis=1).astype(np.float64)
    return np.asarray(~(largest * visibility < CULL_OPACITY))


def _color_errors(
    colors: ArrayPair, drawn: Bool[np.ndarray, " n"], allowance: Allowance, *, is_sh: bool
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    a, b = (side.astype(np.float64) for side in colors)
    # Statement 6: RGB as it is, SH from 64 directions.
    if is_sh:
        shape = (len(a), a.shape[1] // 3, 3)
        weights = basis(view_directions(), degree_of(shape[1]))
        error = largest_sum(weights, signed_difference(a, b).reshape(shape))
        magnitude = largest_sum(np.abs(weights), np.abs(a).reshape(shape))
    else:
        error, magnitude = _distance(a[:, :3], b[:, :3]), _largest_per_row(a[:, :3])
    rounding = _clamp_to_finite(allowance.relative(colors[1].dtype) * magnitude)
    return np.where(drawn, error, 0.0), allowance.tolerances.appearance + rounding


def _ellipsoid_errors(
    rows: ArrayPair, drawn: Bool[np.ndarray, " n"], allowance: Allowance
) -> Errors:
    a, b = (side.astype(np.float64) for side in rows)
    dtype, allowed = rows[1].dtype, allowance.tolerances
    relative, absolute = allowance.relative(dtype), allowance.absolute(dtype)
    # Statements 4 and 5: the units are those of the reference's Gaussian.
    trace = np.maximum(a[:, VARIANCES].sum(axis=1), _MIN_COVARIANCE_TRACE)
    sigma = np.sqrt(trace / 3)
    position = _divide_distances(_distance(a[:, POSITION], b[:, POSITION]), sigma)
    covariance = _divide_distances(_distance(a[:, COVARIANCE], b[:, COVARIANCE]), trace)
    opacity = _distance(a[:, OPACITY : OPACITY + 1], b[:, OPACITY : OPACITY + 1])
    # Statement 8: rounding in proportion to the number, and in steps near zero.
    extent = _largest_per_row(a[:, POSITION])
    return {
        "position": (
            np.where(drawn, position, 0.0),
            allowed.position + _clamp_to_finite((relative * extent + absolute) / sigma),
        ),
        "covariance": (
            np.where(drawn, covariance, 0.0),
            allowed.covariance + _clamp_to_finite(relative + absolute / trace),
        ),
        "opacity": (opacity, np.full(len(a), allowed.opacity + relative)),
    }


def excess_of(
    error: Float[np.ndarray, " n"], allowed: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return errors as multiples of the allowed errors; NaN becomes infinite (statement A9)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.divide(error, allowed, out=np.zeros_like(error), where=error != 0)
    ratio[np.isnan(ratio)] = np.inf
    return np.asarray(ratio)


def keep_worst(
    worst_errors: dict[str, FieldError], errors: Errors, rows: Int[np.ndarray, " n"], probe: str
) -> None:
    """Update the largest excess of each field with the errors of more rows."""
    for name, (error, allowed) in errors.items() if len(rows) else ():
        excess = excess_of(error, allowed)
        index = int(np.argmax(excess))
        if name not in worst_errors or excess[index] > worst_errors[name].excess:
            worst_errors[name] = FieldError(
                field=name,
                error=float(error[index]),
                excess=float(excess[index]),
                probe=probe,
                row=int(rows[index]),
            )


def field_errors(
    first: ModelOutputs, second: ModelOutputs, tolerances: Sequence[Tolerance]
) -> Iterator[FieldError]:
    """Yield the fields in which two runs of a model differ beyond tolerance and rounding.

    ``first`` is the reference; values are rounded to the dtypes of ``second``. Other rules compare
    the counts, and report outputs of another size or without packed rows, which yield no error.
    """
    rows, colors, cells = comparable_parts(first, second)
    if rows is None or not tolerances:
        return
    values = Tolerances(**{tolerance.field: tolerance.value for tolerance in tolerances})
    allowance = Allowance(values)
    live = max(first.count, second.count)

    worst_errors: dict[str, FieldError] = {}
    for start in range(0, live, ROWS_PER_BLOCK):
        block = slice(start, min(start + ROWS_PER_BLOCK, live))
        color_blocks = None if colors is None else (colors[0][block], colors[1][block])
        packed_blocks = rows[0][block], rows[1][block]
        errors = row_errors(packed_blocks, color_blocks, allowance, is_sh=first.is_sh)
        keep_worst(worst_errors, errors, np.arange(block.start, block.stop), first.probe)
    if cells is not None:
        total = live_cells(live, len(rows[0]), len(cells[0]))
        drawn = np.logical_or(
            *(
                drawn_cells(side[:, OPACITY], outputs.count, side_cells[:, VISIBILITY])
                for side, outputs, side_cells in zip(rows, (first, second), cells, strict=True)
            )
        )
        errors = cell_errors((cells[0][:total], cells[1][:total]), drawn[:total], allowance)
        keep_worst(worst_errors, errors, np.arange(total), first.probe)
    yield from (error for error in worst_errors.values() if error.excess > 1)


def tolerance_of(error: FieldError, tolerances: Sequence[Tolerance]) -> Tolerance:
    """Return the tolerance of a field of Gaussians or cells; a visibility has an opacity's."""
    field = error.field.removeprefix("cell ").replace("visibility", "opacity")
    return next(tolerance for tolerance in tolerances if tolerance.field == field)


def comparable_parts(
    first: ModelOutputs, second: ModelOutputs
) -> tuple[ArrayPair | None, ArrayPair | None, ArrayPair | None]:
    """Return the packed rows, colours and cells of two runs that can be compared field by field."""
    rows = _require_both_arrays_or_none(first.gaussians, second.gaussians)
    if rows is None:
        return None, None, None
    colors = _require_both_arrays_or_none(first.appearance, second.appearance)
    channels = APPEARANCE_CHANNELS["sh" if first.is_sh else "rgb"]
    if colors is not None and colors[0].shape[1] not in channels:
        colors = None
    return rows, colors, _require_both_arrays_or_none(first.cells, second.cells)


def _require_both_arrays_or_none(
    first: np.ndarray | None, second: np.ndarray | None
) -> ArrayPair | None:
    if first is None or second is None or first.shape != second.shape:
        return None
    return first, second


@cache
def view_directions() -> Float[np.ndarray, "64 3"]:
    """Return 64 unit vectors spread evenly over the sphere, a Fibonacci lattice (statement A8)."""
    index = np.arange(DIRECTION_COUNT) + 0.5
    z = 1 - 2 * index / DIRECTION_COUNT
    angle = np.pi * (1 + np.sqrt(5)) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _is_drawn(opacity: np.ndarray) -> np.ndarray:
    return np.asarray(opacity.astype(np.float64) >= CULL_OPACITY)


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _largest_per_row(signed_difference(a, b))


def _largest_per_row(table: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Return the largest absolute value of each row; ``max(axis=1)`` takes four times as long."""
    return np.asarray(reduce(np.maximum, np.abs(table).T))


def _divide_distances(distance: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Divide distances by a unit length; a distance of zero stays zero, even for a NaN unit."""
    return np.asarray(np.where(distance == 0, 0.0, distance / unit))


def _clamp_to_finite(rounding: np.ndarray) -> np.ndarray:
    """Return the allowed rounding errors; those of numbers that are not finite are zero."""
    return np.asarray(np.nan_to_num(rounding, posinf=0.0))
