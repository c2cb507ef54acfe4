"""Defines which splats can be drawn: raises for others, or drops them with a warning.

A row is valid if its numbers are finite (an infinite opacity logit is opaque or invisible, a log
scale of -inf is flat), its quaternion is not zero, and its scales fit float32.
"""

import math
import os
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32

from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splats import SPLAT_ARRAY_NAMES, Splats
from gsgen.formats.shared.values import finite_or_allowed, require_finite, require_rows

ALLOWED_INFINITIES = {"logit_opacity": (math.inf, -math.inf), "log_scale": (-math.inf,)}
"""The allowed infinities: opaque, invisible, and flat along an axis."""

LARGEST_LOG_SCALE: Final = 88.0
"""The largest log scale that can be drawn: float32 holds its exponential."""

Labels = Mapping[str, Sequence[str]]
"""Array of :class:`Splats` → the names of its columns in a file."""

DROP_HINT: Final = "`gsgen convert --drop-invalid` writes a file without such rows"
"""The hint about rows that cannot be drawn."""
_ZERO_QUATERNION: Final = "an all-zero quaternion"


def drawable(
    splats: Splats,
    path: str | os.PathLike[str],
    *,
    drop_invalid: bool,
    labels: Labels | None = None,
    where: str = "the scene",
) -> Splats:
    """Return the valid splats of a file: drop others with a warning, or raise for them.

    Args:
        splats: The splats of the file.
        path: The file.
        drop_invalid: Whether invalid rows are dropped.
        labels: The names of columns in messages; by default those of the arrays.
        where: The place of the rows in messages.

    Raises:
        ValueInvalid: A row is invalid; with ``drop_invalid``, every row is.
    """
    try:
        require_drawable(splats, labels=labels, where=where)
    except ValueInvalid as error:
        if not drop_invalid:
            error.hint = error.hint or DROP_HINT
            raise
        is_valid = valid_rows(splats)
        if not is_valid.any():
            raise
    else:
        return splats
    count = len(splats) - int(np.count_nonzero(is_valid))
    zero_count = int(np.count_nonzero(_has_zero_quaternion(splats.rotation)))
    reason = f"; {zero_count:,} rows have {_ZERO_QUATERNION}" if zero_count else ""
    row = int(np.argmin(is_valid))
    text = (
        f"{os.fspath(path)}: {count:,} of {len(splats):,} rows cannot be drawn and are left out; "
        f"row {row} is the first, where {_fault_of_row(splats, row, labels)}{reason}"
    )
    warnings.warn(text, FormatWarning, stacklevel=3)
    return splats[is_valid]


def valid_rows(splats: Splats) -> Bool[np.ndarray, " n"]:
    """Return the mask of splats that can be drawn; see the module for the definition."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_valid = ~np.isnan(splats.logit_opacity)
        for axis in range(3):  # a NaN fails the comparison
            is_valid &= splats.log_scale[:, axis] <= LARGEST_LOG_SCALE
        for array in (splats.position, splats.rotation, splats.sh):
            # A NaN or an infinity would show in the sum; most scenes have none.
            if not np.isfinite(array.sum()):
                is_valid &= np.isfinite(array.reshape(len(splats), -1)).all(axis=1)
        is_valid &= ~_has_zero_quaternion(splats.rotation)
    return np.asarray(is_valid)


def require_drawable(
    splats: Splats,
    *,
    labels: Labels | None = None,
    where: str = "the scene",
    checked_fields: Collection[str] = (),
) -> None:
    """Raise ValueInvalid if ``splats`` is empty or holds an invalid row.

    Arrays that are named in ``checked_fields`` are known to be valid.
    """
    require_rows(len(splats), where)
    for name, table, names in _tables(splats, labels):
        if name in checked_fields:
            continue
        require_finite(table, names, ALLOWED_INFINITIES.get(name, ()))
        if name == "rotation":
            _require_rotations(table, names)
        elif name == "log_scale" and table.max() > LARGEST_LOG_SCALE:
            row = int(np.argmax(table.max(axis=1)))
            raise ValueInvalid(
                f"row {row} is {table[row].max():g}",
                where=names[int(np.argmax(table[row]))],
                expected=f"at most {LARGEST_LOG_SCALE:g}, a natural logarithm",
            )


def _require_rotations(rotation: Float32[np.ndarray, "n 4"], names: Sequence[str]) -> None:
    is_zero = _has_zero_quaternion(rotation)
    count = int(np.count_nonzero(is_zero))
    if count:
        raise ValueInvalid(
            f"{count:,} of {len(rotation):,} rows have {_ZERO_QUATERNION}: "
            f"row {int(np.argmax(is_zero))} is the first",
            where=", ".join(name.removeprefix("property ") for name in names),
            expected="a quaternion other than 0, 0, 0, 0",
        )


def _has_zero_quaternion(rotation: Float32[np.ndarray, "n 4"]) -> Bool[np.ndarray, " n"]:
    is_zero = rotation[:, 0] == 0  # of few rows, whose other columns are read
    candidates = np.flatnonzero(is_zero)
    is_zero[candidates] = (rotation[candidates] == 0).all(axis=1)
    return np.asarray(is_zero)


def _tables(
    splats: Splats, labels: Labels | None
) -> Iterator[tuple[str, Float32[np.ndarray, "n m"], list[str]]]:
    """Yield the arrays of splats as tables, with the names of their columns."""
    for name in SPLAT_ARRAY_NAMES:
        table = getattr(splats, name).reshape(len(splats), -1)
        columns = range(table.shape[1])
        names = [f"{name}[:, {column}]" for column in columns]
        if labels is not None:
            names = [f"property {label}" for label in labels[name]]
        yield name, table, names


def _fault_of_row(splats: Splats, row: int, labels: Labels | None) -> str:
    """Return the first value of an invalid row that cannot be drawn, with its name."""
    for name, table, names in _tables(splats, labels):
        is_valid = finite_or_allowed(table[row], ALLOWED_INFINITIES.get(name, ()))
        if name == "log_scale":
            is_valid &= table[row] <= LARGEST_LOG_SCALE
        if not is_valid.all():
            column = int(np.argmin(is_valid))
            return f"{names[column].removeprefix('property ')} is {table[row, column]:g}"
    return "the quaternion is 0, 0, 0, 0"


def linear_scale(splats: Splats) -> Float32[np.ndarray, "n 3"]:
    """Return the standard deviations of splats as float32."""
    with np.errstate(over="ignore"):
        scale = np.exp(splats.log_scale.astype(np.float64)).astype(np.float32)
    labels = [f"e^log_scale[:, {axis}]" for axis in range(3)]
    require_finite(scale, labels)
    return scale
