"""Tests whether row i of two frames is the same Gaussian.

Between neighbouring frames, Gaussians that are near each other move alike and keep their shapes, or
they keep their colours. Rows that a file has sorted, along a curve for example, do neither: their
offsets are as large as the distances between neighbours, and shapes and colours differ.
"""

__all__ = ["agreeing_share", "rows_correspond"]

from typing import Final

import numpy as np

from gsgen.contract.spec import layout
from gsgen.sdk.exporting.constant_generator import ConstantRows
from gsgen.sdk.sequences.frame_store import BASE_CHANNELS, cholesky_factors

_SAMPLE_ROWS: Final = 2000
_NEIGHBOUR: Final = 4  # the fourth nearest: the first ones may be duplicates
# The largest difference of two neighbours' offsets, as a share of the distance between them.
_MAX_STRETCH: Final = 0.5
# The largest change of a shape from frame to frame, as a share of its size.
_MAX_CHANGE: Final = 0.5
# The largest change of a colour, as a share of the difference to the neighbour's.
_MAX_COLOR_SHARE: Final = 0.1
# Rows correspond if at least this share of them agrees: where several bodies move through each
# other, fewer neighbours move alike. Of rows in another order, one in a hundred agrees.
_MIN_AGREEING_SHARE: Final = 0.2


def rows_correspond(first: ConstantRows, second: ConstantRows) -> bool:
    """Return whether row i of two neighbouring frames is the same Gaussian."""
    if len(first.rows) != len(second.rows):
        return False
    return agreeing_share(first, second) >= _MIN_AGREEING_SHARE


def agreeing_share(first: ConstantRows, second: ConstantRows) -> float:
    """Return the share of visible rows that are the same Gaussian in two neighbouring frames.

    Of more than 2,000 rows, evenly spaced ones are tested. The share is 1 if hardly a row is
    visible in both frames.
    """
    from scipy.spatial import KDTree

    visible = (first.rows[:, layout.OPACITY] >= layout.CULL_OPACITY) & (
        second.rows[:, layout.OPACITY] >= layout.CULL_OPACITY
    )
    rows = np.flatnonzero(visible)
    if len(rows) <= _NEIGHBOUR:
        return 1.0
    start = first.rows[rows, layout.POSITION].astype(np.float64)
    offset = second.rows[rows, layout.POSITION] - start
    sample = np.unique(np.linspace(0, len(rows) - 1, _SAMPLE_ROWS).astype(np.int64))
    distance, nearest = KDTree(start).query(start[sample], k=_NEIGHBOUR + 1)
    neighbour = nearest[:, -1]
    # Sign 1: the row moves as its neighbour does, and keeps its shape.
    stretch = np.linalg.norm(offset[sample] - offset[neighbour], axis=1)
    before, after = (
        cholesky_factors(frame.rows[rows[sample]][:, layout.COVARIANCE])
        for frame in (first, second)
    )
    change = np.linalg.norm(after - before, axis=1)
    moves_alike = stretch <= _MAX_STRETCH * distance[:, -1]
    agrees = moves_alike & (change <= _MAX_CHANGE * np.linalg.norm(before, axis=1))
    # Sign 2: the row keeps its colour, which is not that of its neighbour.
    old, new, other = (
        frame.appearance[selected, :BASE_CHANNELS].astype(np.float64)
        for frame, selected in (
            (first, rows[sample]),
            (second, rows[sample]),
            (first, rows[neighbour]),
        )
    )
    contrast = np.linalg.norm(other - old, axis=1)
    agrees |= (contrast > 0) & (np.linalg.norm(new - old, axis=1) <= _MAX_COLOR_SHARE * contrast)
    return float(agrees.mean())
