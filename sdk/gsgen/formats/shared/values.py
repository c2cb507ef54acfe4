"""Checks arrays of splats; errors name the column, the first invalid row and its value."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32

from gsgen.formats.shared.errors import ValueInvalid


def require_rows(count: int, where: str) -> None:
    """Raise ValueInvalid if a set of splats or points has no rows."""
    if count == 0:
        raise ValueInvalid(
            "the data have 0 splats or points",
            where=where,
            expected="at least one",
            hint="the program that wrote the file may have dropped every point",
        )


def require_finite(
    table: Float32[np.ndarray, "n m"],
    labels: Sequence[str],
    allowed_infinities: Sequence[float] = (),
) -> None:
    """Raise ValueInvalid unless all values are finite or in ``allowed_infinities``, e.g. -inf."""
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(table.sum()):  # a NaN or an infinity would make the sum non-finite
            return
    expected = " or ".join(["a finite number", *(f"{value:+}" for value in allowed_infinities)])
    for column, label in zip(table.T, labels, strict=True):
        _require_valid(finite_or_allowed(column, allowed_infinities), column, label, expected)


def finite_or_allowed(
    values: Float32[np.ndarray, "..."], allowed_infinities: Sequence[float] = ()
) -> Bool[np.ndarray, "..."]:
    """Return the mask of values that are finite or in ``allowed_infinities``, e.g. -inf."""
    is_valid = np.isfinite(values)
    for value in allowed_infinities:
        is_valid |= values == value
    return np.asarray(is_valid)


def require_colors(table: Float32[np.ndarray, "n 3"], labels: Sequence[str]) -> None:
    """Raise ValueInvalid unless all colours lie in [0, 1]; ``labels`` names the columns."""
    hint = "store colours from 0 to 255 as bytes (uchar, uint8)"
    for column, label in zip(table.T, labels, strict=True):
        _require_valid((column >= 0) & (column <= 1), column, label, "0 <= value <= 1", hint)


def _require_valid(
    is_valid: Bool[np.ndarray, " n"],
    column: Float32[np.ndarray, " n"],
    label: str,
    expected: str,
    hint: str = "",
) -> None:
    if is_valid.all():
        return
    first = int(np.argmin(is_valid))
    invalid_count = len(is_valid) - int(np.count_nonzero(is_valid))
    raise ValueInvalid(
        f"{invalid_count} of {len(is_valid)} rows are invalid: row {first} is {column[first]:g}",
        where=label,
        expected=expected,
        hint=hint,
    )
