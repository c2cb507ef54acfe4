"""Infers from the values of packed Gaussians which column holds which quantity."""

__all__ = ["FieldOrder", "suspect_order"]

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.spec.geometry import smallest_eigenvalue

# Minimum number of rows for a statement.
_MIN_ROWS = 16
# Another layout is suspected if more than the first fraction of rows is invalid as declared, and
# less than the second in the other layout.
_MAX_INVALID_ROW_SHARE = 0.2
_MAX_INVALID_SHARE = 1e-3
_EIGENVALUE_SLACK = 2.0**-8
_UNIT_RANGE_TOLERANCE = 1e-2
# Natural logarithms of scales that scenes have.
_LOG_SCALES = (-30.0, 5.0)
# A covariance exceeds the two standard deviations' product by rounding alone.
_MAX_CORRELATION = 1.02
# A box of bounds may be left by this fraction of its diagonal.
_OUTSIDE_SLACK = 1e-2

# The orders of the six covariance entries that exporters have used by mistake: at which place of
# them xx xy xz yy yz zz stand.
_COVARIANCE_LAYOUTS = {
    "the covariance": (0, 1, 2, 3, 4, 5),
    "xx yy zz xy xz yz": (0, 3, 4, 1, 5, 2),
    "xx yy zz yz xz xy (Voigt)": (0, 5, 4, 1, 3, 2),
    "xx xy yy xz yz zz (lower triangle)": (0, 1, 3, 2, 4, 5),
    "zz yz yy xz xy xx (reversed)": (5, 4, 3, 2, 1, 0),
}
# The orders of the three parts of a row, and the first columns of x y z, opacity, the covariance.
_COLUMNS_BY_PART_ORDER = {
    "{}": (0, 3, 4),
    "opacity first, then x y z and {}": (1, 0, 4),
    "x y z, {}, opacity last": (0, 9, 3),
    "{} first, then x y z and opacity": (6, 9, 0),
    "{} first, then opacity and x y z": (7, 6, 0),
    "opacity first, then {} and x y z": (7, 0, 1),
}
# The columns that hold x y z, opacity, xx xy xz yy yz zz in other layouts, the likelier ones first.
_PERMUTATION_BY_FIELD_ORDER = {
    parts.format(name): (
        *range(position, position + 3),
        opacity,
        *(first + column for column in column_offsets),
    )
    for name, column_offsets in _COVARIANCE_LAYOUTS.items()
    for parts, (position, opacity, first) in _COLUMNS_BY_PART_ORDER.items()
    if (name, position, opacity) != ("the covariance", 0, 3)
}

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class FieldOrder:
    """A column layout that fits the packed Gaussians better than the declared layout.

    Attributes:
        name: The fields in that order.
        declared: Fraction of rows that are no valid Gaussian, read as declared.
        fraction: The same fraction, read in this layout.
        rows: Number of rows examined.
    """

    name: str
    declared: float
    fraction: float
    rows: int


def suspect_order(
    rows: Float[np.ndarray, "n 10"],
    bounds: Box | None = None,
    planes: Float[np.ndarray, "n 10"] | None = None,
    rounding_error: float = 0.0,
) -> FieldOrder | None:
    """Return the column layout that fits nearly all Gaussians, if the declared layout does not.

    Args:
        rows: Packed rows as stored, [n, 10], float64.
        bounds: Declared corners of the box around all centres; None if not declared.
        planes: The same memory read as ten planes, [n, 10]; None if the rows are a sample.
        rounding_error: The rounding error of entries near zero, as float16 has it.
    """
    rows = _without_empty_rows(rows)
    if len(rows) < _MIN_ROWS:
        return None
    declared = _invalid_share(_convention_misfit_mask(rows, bounds, rounding_error))
    if declared <= _MAX_INVALID_ROW_SHARE or _is_opacity_alone(rows, rounding_error):
        return None
    if bounds is not None and _invalid_share(_outside_mask(rows, bounds)) <= _MAX_INVALID_SHARE:
        bounds = None  # measured on these columns, so they say nothing of others
    fractions = {
        name: _invalid_share(mask) for name, mask in _candidate_layouts(rows, bounds, planes)
    }
    name, share = min(fractions.items(), key=lambda item: item[1])
    return FieldOrder(name, declared, share, len(rows)) if share <= _MAX_INVALID_SHARE else None


def _candidate_layouts(
    rows: Float[np.ndarray, "n 10"], bounds: Box | None, planes: Float[np.ndarray, "n 10"] | None
) -> Iterator[tuple[str, Bool[np.ndarray, " n"]]]:
    """Yield alternative column layouts, likeliest first, each with the mask of invalid rows."""
    for name, columns in _PERMUTATION_BY_FIELD_ORDER.items():
        yield name, _convention_misfit_mask(rows[:, columns], bounds)
    yield from _quaternion_layouts(rows).items()
    if planes is not None and len(_without_empty_rows(planes)):
        name = "ten planes, which reshape left as they were in place of a transpose"
        yield name, _convention_misfit_mask(_without_empty_rows(planes), bounds)
    if (rows[:, 7] < 0).any():  # where a variance stands, and a factor has either sign
        name = "a Cholesky factor in place of the covariance"
        negative_scale_mask = (rows[:, [4, 6, 9]] < 0).any(axis=1)
        yield name, _convention_misfit_mask(_squared_factor(rows), bounds) | negative_scale_mask


def _without_empty_rows(rows: Float[np.ndarray, "n 10"]) -> Float[np.ndarray, "m 10"]:
    """Return the finite packed rows that are not padding (all zeros)."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(rows[np.abs(rows[:, 3:]).sum(axis=1) > 0])


def _invalid_share(is_invalid: Bool[np.ndarray, " n"]) -> float:
    return float(np.count_nonzero(is_invalid) / len(is_invalid))


def _convention_misfit_mask(
    rows: Float[np.ndarray, "n 10"], bounds: Box | None, rounding_error: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Return the mask of packed rows that cannot be Gaussians, by opacity, covariance or centre.

    Beside a large entry, an eigenvalue says little of the small ones: so each covariance is compared
    with the standard deviations of its own two axes, too.
    """
    opacity, upper = rows[:, 3], rows[:, 4:]
    is_opacity = (opacity >= -_UNIT_RANGE_TOLERANCE) & (opacity <= 1 + _UNIT_RANGE_TOLERANCE)
    size = np.abs(upper[:, [0, 3, 5]]).sum(axis=1)
    fitting_mask = is_opacity & (
        smallest_eigenvalue(upper) >= -_EIGENVALUE_SLACK * size - rounding_error
    )
    xx, yy, zz = np.maximum(upper[:, [0, 3, 5]].T, 0) + rounding_error
    xy, xz, yz = np.abs(upper[:, [1, 2, 4]].T)
    for covariance, variances in ((xy, xx * yy), (xz, xx * zz), (yz, yy * zz)):
        fitting_mask &= covariance <= _MAX_CORRELATION * np.sqrt(variances) + rounding_error
    return np.asarray(
        ~fitting_mask if bounds is None else ~fitting_mask | _outside_mask(rows, bounds)
    )


def _is_opacity_alone(rows: Float[np.ndarray, "n 10"], rounding_error: float) -> bool:
    """Return whether centres could be opacities (all within 0 … 1), and covariances are valid.

    Then any of the first columns would pass as an opacity, which proves no other order.
    """
    if not (np.abs(rows[:, :3] - 0.5) <= 0.5 + _UNIT_RANGE_TOLERANCE).all():
        return False
    opaque_rows = rows.copy()
    opaque_rows[:, 3] = 1
    return (
        _invalid_share(_convention_misfit_mask(opaque_rows, None, rounding_error))
        <= _MAX_INVALID_SHARE
    )


def _outside_mask(rows: Float[np.ndarray, "n 10"], bounds: Box) -> Bool[np.ndarray, " n"]:
    """Return the mask of centres outside a box by more than a hundredth of the box's diagonal."""
    low, high = np.asarray(bounds)
    slack = _OUTSIDE_SLACK * np.linalg.norm(high - low)
    position = rows[:, :3]
    return np.asarray(~((position >= low - slack) & (position <= high + slack)).all(axis=1))


def _quaternion_layouts(rows: Float[np.ndarray, "n 10"]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Return the mask of packed rows that do not hold a position, scales and a unit quaternion."""

    def misfit_mask(scale: slice, quaternion: slice, *, log: bool) -> Bool[np.ndarray, " n"]:
        length = np.linalg.norm(rows[:, quaternion], axis=1)
        low, high = _LOG_SCALES if log else (0.0, np.inf)
        fitting_mask = ((rows[:, scale] >= low) & (rows[:, scale] <= high)).all(axis=1)
        return np.asarray(~(fitting_mask & (np.abs(length - 1) <= _UNIT_RANGE_TOLERANCE)))

    first, last = (slice(3, 6), slice(6, 10)), (slice(7, 10), slice(3, 7))
    return {
        "x y z, three scales, a quaternion": misfit_mask(*first, log=False),
        "x y z, a quaternion, three scales": misfit_mask(*last, log=False),
        "x y z, three log scales, a quaternion": misfit_mask(*first, log=True),
        "x y z, a quaternion, three log scales": misfit_mask(*last, log=True),
    }


def _squared_factor(rows: Float[np.ndarray, "n 10"]) -> Float[np.ndarray, "n 10"]:
    """Return packed rows with the covariance L Lᵀ in place of the Cholesky factor L."""
    lower = np.zeros((len(rows), 3, 3))
    lower[:, [0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]] = rows[:, 4:]
    sigma = lower @ lower.transpose(0, 2, 1)
    upper = sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([rows[:, :4], upper], axis=1)
