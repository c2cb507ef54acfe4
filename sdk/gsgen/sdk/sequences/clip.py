"""The parts of a clip: tables of bytes whose weighted sums are the values of a moment.

Every value that changes with time is a sum over components, X(t) = Σ_r c_r(t) (T_r − 128), of a
table T of bytes with one row per component and few coefficients c per moment.
"""

__all__ = ["DIGIT_ZERO", "Clip", "Palette", "RowGroup", "Table", "knot_weights", "sizes_of"]

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

DIGIT_ZERO: Final = 128
"""The byte of a table that stands for zero."""


TABLE_NAMES: Final = ("place", "motion", "factors", "opacity", "color")
"""The tables of a group."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Values of ``planes`` columns and n rows at every moment, as a sum over R components.

    Attributes:
        digits: Bytes of each component, plane by plane, with 128 for zero.
        coefficients: Weights of the components at each knot, or in one row if they are constant.
        planes: Columns of the values.
    """

    digits: UInt8[np.ndarray, "r p*n"]
    coefficients: Float32[np.ndarray, "k r"]
    planes: int

    def __len__(self) -> int:
        return int(self.digits.shape[1]) // self.planes

    @property
    def nbytes(self) -> int:
        """The bytes of the table and its coefficients."""
        return self.digits.nbytes + self.coefficients.nbytes

    def at(self, weights: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, "p n"]:
        """Return the values in float64 for the weights of the knots."""
        knots = self.coefficients.astype(np.float64)
        coefficients = knots[0] if len(knots) == 1 else weights @ knots
        values = np.zeros(self.digits.shape[1])
        for coefficient, digits in zip(coefficients, self.digits, strict=True):
            values += coefficient * (digits.astype(np.float64) - DIGIT_ZERO)
        return values.reshape(self.planes, -1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RowGroup:
    """Gaussians of a clip that share the components of their motion.

    Position is ``place`` + ``motion`` · size, factors are ``factors`` · size, where size is
    exp(``size_step`` · (``size`` − 128)) times ``size_unit``.

    Attributes:
        rows: Row numbers of the source.
        size: Bytes of the logarithm of each Gaussian's size.
        size_unit: The size that the byte 128 stands for.
        place: Mean centre, in local units; three planes.
        motion: Offset from it in units of the size; None for Gaussians that stay in place.
        factors: Cholesky factors in units of the size: l00 l10 l20 l11 l21 l22.
        opacity: Opacity less ½, before it is clipped to [0, 1].
        color: RGB, or the constant SH term of red, green and blue; three planes.
    """

    rows: Int64[np.ndarray, " n"]
    size: UInt8[np.ndarray, " n"]
    size_unit: float
    place: Table
    motion: Table | None
    factors: Table
    opacity: Table
    color: Table

    def __len__(self) -> int:
        return len(self.rows)

    def component_counts(self) -> dict[str, int]:
        """Return the number of bytes of each attribute's table for one number of one Gaussian."""
        tables = {name: getattr(self, name) for name in TABLE_NAMES}
        return {name: len(table.digits) for name, table in tables.items() if table is not None}


@dataclass(frozen=True, slots=True, eq=False)
class Palette:
    """The SH coefficients of a clip's rows but for the constant term, which do not change.

    Attributes:
        entries: Coefficients of each entry, coefficient-major; a plane for each.
        labels: Entry of each row, in the order of the clip.
    """

    entries: Table
    labels: Int64[np.ndarray, " n"]

    def reordered(self, rows: Int64[np.ndarray, " n"]) -> "Palette":
        """Return the palette for rows in another order."""
        return Palette(self.entries, self.labels[rows])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Clip:
    """A sequence as tables.

    Attributes:
        groups: Its Gaussians, in the order of the rows.
        palette: Their SH coefficients of degree 1 and higher; None without any.
        space: Whether colours are SH or RGB.
        frames: Frames that the times from 0 to 1 span.
        knots: Rows of coefficients: one for each frame, and one more if the clip ends in another.
    """

    groups: tuple[RowGroup, ...]
    palette: Palette | None
    space: Literal["sh", "rgb"]
    frames: int
    knots: int

    def __len__(self) -> int:
        return sum(len(group) for group in self.groups)

    def bytes_by_attribute(self) -> dict[str, int]:
        """Return the bytes of the tables of each attribute, and of the palette of SH."""
        totals = {"size": sum(group.size.nbytes for group in self.groups)}
        for name in TABLE_NAMES:
            tables: list[Table | None] = [getattr(group, name) for group in self.groups]
            totals[name] = sum(table.nbytes for table in tables if table is not None)
        if self.palette is not None:
            totals["palette"] = self.palette.entries.nbytes + 2 * len(self.palette.labels)
        return totals

    @property
    def nbytes(self) -> int:
        """The bytes of all tables."""
        return sum(self.bytes_by_attribute().values())

    @property
    def channels(self) -> int:
        """The columns of the appearance."""
        return 3 + (0 if self.palette is None else self.palette.entries.planes)


SIZE_STEP: Final = 0.0866433976  # ln 2 / 8: eight steps double the size


def sizes_of(digits: UInt8[np.ndarray, " n"], unit: float) -> Float64[np.ndarray, " n"]:
    """Return the sizes that bytes stand for, where 128 stands for ``unit``."""
    return np.asarray(unit * np.exp(SIZE_STEP * (digits.astype(np.float64) - DIGIT_ZERO)))


def knot_weights(time: float, frames: int, knots: int) -> Float64[np.ndarray, " k"]:
    """Return the weights of a clip's knots at a time in [0, 1], by linear interpolation.

    Knot k is frame k, at k / ``frames``. One more is the frame that the clip ends in: the first
    one of a loop, or that of the next segment. Without it the last frame lasts until the end.
    """
    place = min(time * frames, knots - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots))))
