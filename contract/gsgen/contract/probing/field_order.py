"""Infers from the numbers the order of the fields of packed rows."""

__all__ = ["FieldOrder", "suspect_order"]

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.spec.geometry import smallest_eigenvalue

# Minimum number of rows for a statement.
_FEWEST = 16
# An order is suspected if more than the first fraction of rows is invalid as declared, and
# less than the second in the other order.
_BROKEN = 0.2
_SOUND = 1e-3
_SLACK = 2.0**-8
_UNIT = 1e-2

# Columns of xx xy xz yy yz zz in orders that exporters have used by mistake.
_COVARIANCES = {
    "xx yy zz xy xz yz": (0, 3, 4, 1, 5, 2),
    "xx xy yy xz yz zz": (0, 1, 3, 2, 4, 5),
}


@dataclass(frozen=True, slots=True)
class FieldOrder:
    """A field order that fits the rows better than the declared one.

    Attributes:
        name: The fields in that order.
        declared: Fraction of rows without a valid covariance, read as declared.
        fraction: The same fraction, read in this order.
        rows: Number of rows examined.
    """

    name: str
    declared: float
    fraction: float
    rows: int


def suspect_order(rows: Float[np.ndarray, "n 10"]) -> FieldOrder | None:
    """Return the order that nearly all ``rows`` fit, if many do not fit the declared one."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    covariance = rows[:, 4:]
    rows = rows[np.abs(covariance).sum(axis=1) > 0]
    covariance = rows[:, 4:]
    if len(rows) < _FEWEST:
        return None
    declared = _share(_indefinite(covariance))
    if declared <= _BROKEN:
        return None
    fractions = {
        name: _share(_indefinite(covariance[:, columns]))
        for name, columns in _COVARIANCES.items()
    }
    fractions |= {name: _share(is_invalid) for name, is_invalid in _turned(rows).items()}
    name, share = min(fractions.items(), key=lambda item: item[1])
    return FieldOrder(name, declared, share, len(rows)) if share <= _SOUND else None


def _share(is_invalid: Bool[np.ndarray, " n"]) -> float:
    return float(np.count_nonzero(is_invalid) / len(is_invalid))


def _indefinite(upper: Float[np.ndarray, "n 6"]) -> Bool[np.ndarray, " n"]:
    size = np.abs(upper[:, [0, 3, 5]]).sum(axis=1)
    return np.asarray(~(smallest_eigenvalue(upper) >= -_SLACK * size))


def _turned(rows: Float[np.ndarray, "n 10"]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Return which rows are not a position with scales and a unit quaternion."""

    def unfit(scale: slice, quaternion: slice) -> Bool[np.ndarray, " n"]:
        length = np.linalg.norm(rows[:, quaternion], axis=1)
        fits = (rows[:, scale] >= 0).all(axis=1) & (np.abs(length - 1) <= _UNIT)
        return np.asarray(~fits)

    return {
        "x y z, three scales, a quaternion": unfit(slice(3, 6), slice(6, 10)),
        "x y z, a quaternion, three scales": unfit(slice(7, 10), slice(3, 7)),
    }
