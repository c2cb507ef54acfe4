"""Refuse values that cannot be drawn, and say which, where and how many."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32

from gsgen.formats.shared.errors import ValueInvalid


def require_rows(count: int, where: str) -> None:
    """Raise ValueInvalid if there is nothing to draw."""
    if count == 0:
        raise ValueInvalid(
            "0 rows",
            where=where,
            expected="at least one",
            hint="whatever made this may have dropped every point",
        )


def require_finite(
    table: Float32[np.ndarray, "n m"],
    labels: Sequence[str],
    infinite: Sequence[float] = (),
) -> None:
    """Raise ValueInvalid unless all is finite or one of ``infinite``.

    Args:
        table: The values, a column for each of ``labels``.
        labels: What to call the columns in the error.
        infinite: Infinities that mean something here.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(
            table.sum()
        ):  # a NaN or an infinity would show: nothing has to be found
            return
    expected = " or ".join(["a finite number", *(f"{value:+}" for value in infinite)])
    for column, label in zip(table.T, labels, strict=True):
        _require(meaning_something(column, infinite), column, label, expected)


def meaning_something(
    values: Float32[np.ndarray, "..."], infinite: Sequence[float] = ()
) -> Bool[np.ndarray, "..."]:
    """Return which values are finite or one of ``infinite``."""
    kept = np.isfinite(values)
    for value in infinite:
        kept |= values == value
    return np.asarray(kept)


def require_colors(table: Float32[np.ndarray, "n 3"], labels: Sequence[str]) -> None:
    """Raise ValueInvalid unless all lies in [0, 1]; ``labels`` names the columns."""
    hint = "colours from 0 to 255 have to be stored as bytes (uchar, uint8)"
    for column, label in zip(table.T, labels, strict=True):
        _require((column >= 0) & (column <= 1), column, label, "0 <= value <= 1", hint)


def _require(
    kept: Bool[np.ndarray, " n"],
    column: Float32[np.ndarray, " n"],
    label: str,
    expected: str,
    hint: str = "",
) -> None:
    if kept.all():
        return
    first = int(np.argmin(kept))
    bad = len(kept) - int(np.count_nonzero(kept))
    raise ValueInvalid(
        f"{bad} of {len(kept)} rows, row {first} is {column[first]:g}",
        where=label,
        expected=expected,
        hint=hint,
    )
