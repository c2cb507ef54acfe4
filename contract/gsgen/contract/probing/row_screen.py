"""Tells packed rows that may break a rule of values from those that cannot, at little cost.

The rules themselves need rows in memory; a run at a named moment keeps rows only if this screen
finds them faulty. It lets no fault pass that the rules GV003, GV005, GV006, GV010, GV016, GV018 and
those of cells report, up to a sample of 16,384 suspected covariances of a run.
"""

__all__ = ["drawn_rows", "live_count", "look_faulty", "row_keys", "visible_count"]

import numpy as np

from gsgen.contract._array_types import Bool, Float, UInt
from gsgen.contract.spec.geometry import PSD_FLOOR, PSD_SLACK, clearly_positive, smallest_eigenvalue
from gsgen.contract.spec.layout import (
    COVARIANCE,
    CULL_OPACITY,
    OPACITY,
    OPACITY_SLACK,
    POSITION,
    ROW_LENGTH,
    VARIANCES,
    VISIBILITY,
)
from gsgen.contract.spec.units import FLOAT16_MAX

# Rows screened at a time: their columns stay in the second-level cache.
_BLOCK_ROWS = 16384
_MAX_SUSPECTS = 16384
# About so many rows are kept for pictures.
_PICTURE_ROWS = 16384
_KEY_COLUMNS = 10
# Odd factors of a hash: powers of 2⁶⁴ over the golden ratio.
_KEY_FACTORS = np.array(
    [pow(0x9E3779B97F4A7C15, k + 1, 2**64) for k in range(_KEY_COLUMNS)], np.uint64
)


def look_faulty(
    rows: np.ndarray | None, count: np.ndarray | None, cells: np.ndarray | None, per_cell: int
) -> bool:
    """Return whether packed rows, their count or their cells may break a rule of values.

    Args:
        rows: Packed rows, [N, 10], whose values are finite; None if the model gives none.
        count: The row count, int32 [1]; None if the model gives none.
        cells: Packed cells, [C, 10]; None if the model gives none.
        per_cell: Rows of each cell.
    """
    if rows is None:
        return False
    if rows.ndim != 2 or rows.shape[1] != ROW_LENGTH or rows.dtype.kind != "f":
        return True
    live = live_count(rows, count)
    if not 0 <= live <= len(rows):
        return True
    padding, part = rows[live:, OPACITY], rows[:live]
    return bool(
        (padding != 0).any()
        or _do_rows_look_faulty(part, CULL_OPACITY)
        or (cells is not None and _do_cells_look_faulty(cells, live, per_cell))
    )


def live_count(rows: np.ndarray, count: np.ndarray | None) -> int:
    """Return the row count of a run as the model gives it; all rows if it gives no whole number."""
    is_whole = count is not None and count.size and count.dtype.kind in "iu"
    return int(count.reshape(-1)[0]) if count is not None and is_whole else len(rows)


def visible_count(rows: np.ndarray, count: np.ndarray | None) -> int:
    """Return how many live rows are opaque enough to be drawn; 0 if the rows are not packed."""
    if rows.ndim != 2 or rows.shape[1] != ROW_LENGTH:
        return 0
    return int(np.count_nonzero(rows[: max(0, live_count(rows, count)), OPACITY] >= CULL_OPACITY))


def row_keys(rows: Float[np.ndarray, "n k"]) -> UInt[np.ndarray, " n"]:
    """Return a hash, uint64, of the bits of each row's first ten numbers as float32."""
    columns = np.ascontiguousarray(rows[:, :_KEY_COLUMNS], np.float32).view(np.uint32)
    keys = (columns * _KEY_FACTORS[: columns.shape[1]]).sum(axis=1, dtype=np.uint64)
    return np.asarray(keys ^ keys >> np.uint64(32))


def drawn_rows(
    rows: np.ndarray | None, count: np.ndarray | None
) -> Float[np.ndarray, "n 10"] | None:
    """Return the visible rows of a run as float32; None without packed rows.

    Of more than 32,767 rows, a share is chosen by their positions, the same in each run.
    """
    if rows is None or rows.ndim != 2 or rows.shape[1] != ROW_LENGTH or rows.dtype.kind != "f":
        return None
    live = rows[: max(0, live_count(rows, count))]
    drawn = live[live[:, OPACITY] >= CULL_OPACITY].astype(np.float32)
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    step = max(1, len(rows) // _PICTURE_ROWS)
    return drawn if step == 1 else drawn[row_keys(drawn[:, POSITION]) % np.uint64(step) == 0]


def _do_rows_look_faulty(rows: Float[np.ndarray, "n 10"], min_opacity: float) -> bool:
    """Return whether an opacity, a magnitude or a covariance of live rows is out of range."""
    suspects: list[np.ndarray] = []
    for start in range(0, len(rows), _BLOCK_ROWS):
        block = rows[start : start + _BLOCK_ROWS]
        columns = np.ascontiguousarray(block.T, np.float32)
        opacity = columns[OPACITY]
        if opacity.min() < -OPACITY_SLACK or opacity.max() > 1 + OPACITY_SLACK:
            return True
        if rows.dtype == np.float16 and np.abs(columns).max() >= FLOAT16_MAX:
            return True
        drawn = opacity >= min_opacity
        if (columns[list(VARIANCES)].min(axis=0)[drawn] < 0).any():
            return True
        suspects.append(
            block[drawn & ~clearly_positive(columns[COVARIANCE], PSD_SLACK[rows.itemsize])]
        )
    return _is_any_indefinite(np.concatenate(suspects), rows.itemsize) if suspects else False


def _is_any_indefinite(rows: Float[np.ndarray, "n 10"], itemsize: int) -> bool:
    sample = rows[:: max(1, len(rows) // _MAX_SUSPECTS), COVARIANCE].astype(np.float64)
    size = np.abs(sample[:, [0, 3, 5]]).sum(axis=1)
    return not (
        smallest_eigenvalue(sample) >= -PSD_SLACK[itemsize] * size - PSD_FLOOR[itemsize]
    ).all()


def _do_cells_look_faulty(cells: Float[np.ndarray, "c 10"], live: int, per_cell: int) -> bool:
    if cells.ndim != 2 or cells.shape[1] != ROW_LENGTH or cells.dtype.kind != "f":
        return True
    is_empty: Bool[np.ndarray, " c"] = np.arange(len(cells)) * per_cell >= live
    visibility = cells[:, VISIBILITY]
    return bool(
        (visibility[is_empty] != 0).any()
        or _do_rows_look_faulty(cells, float(np.finfo(np.float32).tiny))
    )
