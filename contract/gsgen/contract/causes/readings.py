"""Readings of packed rows, and which rows do not fit a scene."""

__all__ = [
    "EIGENVALUE_SLACK",
    "MAX_INVALID_SHARE",
    "UNIT_RANGE_TOLERANCE",
    "Box",
    "Explanation",
    "Reading",
    "SeenRows",
    "hidden_mask",
    "misfit_mask_of",
    "outside_mask",
    "share_of",
    "without_empty_rows",
]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.spec.geometry import smallest_eigenvalue

# An explanation leaves at most this share of rows that do not fit.
MAX_INVALID_SHARE = 1e-3
# Rounding of eigenvalues as a share of the trace, and of opacities and lengths of quaternions.
EIGENVALUE_SLACK = 2.0**-8
UNIT_RANGE_TOLERANCE = 1e-2
# A covariance exceeds the two standard deviations' product by rounding alone.
_MAX_CORRELATION = 1.02
# A box of bounds may be left by this fraction of its diagonal.
_OUTSIDE_SLACK = 1e-2

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """A reading of packed rows in which they are Gaussians of one scene, unlike as declared.

    Attributes:
        kind: What differs: the ``order`` of columns, or the ``space`` of centres.
        name: The reading: the fields in their order, or where the centres are.
        declared: Fraction of rows that do not fit one scene, read as declared.
        fraction: The same fraction, in this reading.
        rows: Number of rows examined.
        hint: How to repair the model; the same repair was applied to the rows.
    """

    kind: Literal["order", "space"]
    name: str
    declared: float
    fraction: float
    rows: int
    hint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenRows:
    """The Gaussians that a model shows to one camera.

    Attributes:
        center: The centre of the camera.
        view: The matrix from local to camera space; None without that input.
        projection: The matrix from camera to clip space; None without that input.
        position: Centres of all rows.
        drawn: Mask of the rows that are drawn.
    """

    center: Float[np.ndarray, "3"]
    view: Float[np.ndarray, "4 4"] | None
    projection: Float[np.ndarray, "4 4"] | None
    position: Float[np.ndarray, "n 3"]
    drawn: Bool[np.ndarray, " n"]


class Reading(NamedTuple):
    """A reading of packed rows, before it is scored.

    Attributes:
        name: The fields in their order, or the space of the centres.
        misfit: Mask of the rows that do not fit it.
        position: The centres in it.
        hint: How to repair a model of such rows.
    """

    name: str
    misfit: Bool[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    hint: str


def without_empty_rows(rows: Float[np.ndarray, "n 10"]) -> Float[np.ndarray, "m 10"]:
    """Return the finite packed rows that are not padding (all zeros)."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(rows[np.abs(rows[:, 3:]).sum(axis=1) > 0])


def share_of(is_invalid: Bool[np.ndarray, " n"]) -> float:
    """Return the share of rows that a mask names."""
    return float(np.count_nonzero(is_invalid) / len(is_invalid))


def misfit_mask_of(
    rows: Float[np.ndarray, "n 10"], bounds: Box | None, rounding_error: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Return the mask of packed rows that cannot be Gaussians, by opacity, covariance or centre.

    Beside a large entry, an eigenvalue says little of the small ones: so each covariance is compared
    with the standard deviations of its own two axes, too.
    """
    opacity, upper = rows[:, 3], rows[:, 4:]
    is_opacity = (opacity >= -UNIT_RANGE_TOLERANCE) & (opacity <= 1 + UNIT_RANGE_TOLERANCE)
    size = np.abs(upper[:, [0, 3, 5]]).sum(axis=1)
    fitting_mask = is_opacity & (
        smallest_eigenvalue(upper) >= -EIGENVALUE_SLACK * size - rounding_error
    )
    xx, yy, zz = np.maximum(upper[:, [0, 3, 5]].T, 0) + rounding_error
    xy, xz, yz = np.abs(upper[:, [1, 2, 4]].T)
    for covariance, variances in ((xy, xx * yy), (xz, xx * zz), (yz, yy * zz)):
        fitting_mask &= covariance <= _MAX_CORRELATION * np.sqrt(variances) + rounding_error
    return np.asarray(
        ~fitting_mask if bounds is None else ~fitting_mask | outside_mask(rows, bounds)
    )


def outside_mask(rows: Float[np.ndarray, "n 10"], bounds: Box) -> Bool[np.ndarray, " n"]:
    """Return the mask of centres outside a box by more than a hundredth of the box's diagonal."""
    low, high = np.asarray(bounds)
    slack = _OUTSIDE_SLACK * np.linalg.norm(high - low)
    position = rows[:, :3]
    return np.asarray(~((position >= low - slack) & (position <= high + slack)).all(axis=1))


def hidden_mask(
    position: Float[np.ndarray, "n 3"], cameras: Sequence[SeenRows]
) -> Bool[np.ndarray, " n"]:
    """Return the mask of centres that are behind all cameras; all False without cameras."""
    views = [camera.view for camera in cameras if camera.view is not None]
    depths = [position @ view[2, :3] + view[2, 3] for view in views]
    if not depths:
        return np.zeros(len(position), bool)
    return np.asarray(np.max(depths, axis=0) <= 0)
