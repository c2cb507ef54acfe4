"""Orders of columns that packed rows may have by mistake, and how each is undone."""

__all__ = ["column_orders"]

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.causes.readings import (
    UNIT_RANGE_TOLERANCE,
    Box,
    Reading,
    misfit_mask_of,
    without_empty_rows,
)
from gsgen.contract.spec.layout import POSITION

# Natural logarithms of scales that scenes have.
_LOG_SCALES = (-30.0, 5.0)
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


def column_orders(
    rows: Float[np.ndarray, "n 10"], bounds: Box | None, planes: Float[np.ndarray, "n 10"] | None
) -> Iterator[Reading]:
    """Yield readings of rows with columns in another order, likeliest first."""
    for name, columns in _PERMUTATION_BY_FIELD_ORDER.items():
        read_rows = rows[:, columns]
        misfit = misfit_mask_of(read_rows, bounds)
        hint = f"Return `rows[:, {list(columns)}]`, the columns in the contract's order."
        yield Reading(name, misfit, read_rows[:, POSITION], hint)
    covariance_hint = "Store x y z, opacity, and the covariance R S Sᵀ Rᵀ of scales and quaternion."
    for name, misfit in _quaternion_layouts(rows).items():
        yield Reading(name, misfit, rows[:, POSITION], covariance_hint)
    if planes is not None:
        planes = without_empty_rows(planes)
        name = "ten planes, which reshape left as they were in place of a transpose"
        misfit = misfit_mask_of(planes, bounds) if len(planes) else np.zeros(0, bool)
        hint = "Transpose the planes: `rows.reshape(10, -1).T`."
        yield Reading(name, misfit, planes[:, POSITION], hint)
    if (rows[:, 7] < 0).any():  # where a variance stands, and a factor has either sign
        name = "a Cholesky factor in place of the covariance"
        negative_scale_mask = (rows[:, [4, 6, 9]] < 0).any(axis=1)
        misfit = misfit_mask_of(_squared_factor(rows), bounds) | negative_scale_mask
        yield Reading(name, misfit, rows[:, POSITION], "Store L Lᵀ in place of the factor L.")


def _quaternion_layouts(rows: Float[np.ndarray, "n 10"]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Return the mask of packed rows that do not hold a position, scales and a unit quaternion."""

    def misfit_mask(scale: slice, quaternion: slice, *, log: bool) -> Bool[np.ndarray, " n"]:
        length = np.linalg.norm(rows[:, quaternion], axis=1)
        low, high = _LOG_SCALES if log else (0.0, np.inf)
        fitting_mask = ((rows[:, scale] >= low) & (rows[:, scale] <= high)).all(axis=1)
        return np.asarray(~(fitting_mask & (np.abs(length - 1) <= UNIT_RANGE_TOLERANCE)))

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
