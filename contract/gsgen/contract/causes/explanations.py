"""Explains rows that do not fit one scene: each explanation undoes a mistake, and is tried.

An explanation of rows is a reading of them: another order of columns, or another space of centres.
All compete on one score, the share of rows that do not fit one scene in that reading:

1. an opacity outside [0, 1], a covariance that is not positive semi-definite, or a centre outside
   the bounds;
2. a centre that is behind all cameras, which look at the scene;
3. a row that moves with the camera, if in some reading no row does.
"""

__all__ = ["explain_rows"]

from collections.abc import Sequence

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.causes.camera_spaces import space_of_still_rows
from gsgen.contract.causes.column_orders import column_orders
from gsgen.contract.causes.readings import (
    MAX_INVALID_SHARE,
    UNIT_RANGE_TOLERANCE,
    Box,
    Explanation,
    SeenRows,
    hidden_mask,
    misfit_mask_of,
    outside_mask,
    share_of,
    without_empty_rows,
)

# Minimum number of rows for a statement.
_MIN_ROWS = 16
# Another layout is suspected if more than this fraction of rows is invalid as declared.
_MAX_INVALID_ROW_SHARE = 0.2


def explain_rows(
    rows: Float[np.ndarray, "n 10"],
    bounds: Box | None = None,
    planes: Float[np.ndarray, "n 10"] | None = None,
    rounding_error: float = 0.0,
    cameras: Sequence[SeenRows] = (),
) -> Explanation | None:
    """Return the reading that fits nearly all rows, if the declared one does not.

    Args:
        rows: Packed rows as stored, [n, 10], float64.
        bounds: Declared corners of the box around all centres; None if not declared.
        planes: The same memory read as ten planes, [n, 10]; None if the rows are a sample.
        rounding_error: The rounding error of entries near zero, as float16 has it.
        cameras: The rows of runs that differ in the camera alone.
    """
    rows = without_empty_rows(rows)
    space = space_of_still_rows(cameras)
    if space is not None:  # no order of columns makes rows still that move
        return space
    if len(rows) < _MIN_ROWS:
        return None
    declared = share_of(misfit_mask_of(rows, bounds, rounding_error))
    if declared <= _MAX_INVALID_ROW_SHARE or _is_opacity_alone(rows, rounding_error):
        return None
    if bounds is not None and share_of(outside_mask(rows, bounds)) <= MAX_INVALID_SHARE:
        bounds = None  # measured on these columns, so they say nothing of others
    scores = [
        (share_of(reading.misfit | hidden_mask(reading.position, cameras)), reading)
        for reading in column_orders(rows, bounds, planes)
        if len(reading.misfit)
    ]
    share, reading = min(scores, key=lambda entry: entry[0])
    if share > MAX_INVALID_SHARE:
        return None
    return Explanation(
        kind="order",
        name=reading.name,
        declared=declared,
        fraction=share,
        rows=len(rows),
        hint=reading.hint,
    )


def _is_opacity_alone(rows: Float[np.ndarray, "n 10"], rounding_error: float) -> bool:
    """Return whether centres could be opacities (all within 0 … 1), and covariances are valid.

    Then any of the first columns would pass as an opacity, which proves no other order.
    """
    if not (np.abs(rows[:, :3] - 0.5) <= 0.5 + UNIT_RANGE_TOLERANCE).all():
        return False
    opaque_rows = rows.copy()
    opaque_rows[:, 3] = 1
    return share_of(misfit_mask_of(opaque_rows, None, rounding_error)) <= MAX_INVALID_SHARE
