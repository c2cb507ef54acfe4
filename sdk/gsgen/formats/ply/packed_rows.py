"""Packs and unpacks the four 32-bit words of a splat in a compressed PLY file.

The format is that of PlayCanvas (playcanvas/splat-transform): 256 splats share a box of
positions, log scales and colours; the numbers of a word divide the box evenly.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64, UInt8, UInt32

from gsgen.formats.shared.quantities import (
    SH_C0,
    logit,
    quaternions_from_largest,
    rounded,
    sigmoid,
    to_bytes,
    unit,
    without_largest,
)

ROWS_PER_CHUNK: Final = 256
"""The number of splats that share a box."""
BOX_PROPERTIES: Final = tuple(
    f"{end}_{axis}"
    for group in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for end in ("min", "max")
    for axis in group
)
"""The properties of a box, in the order of the file."""
PACKED_PROPERTIES: Final = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
LARGEST_LOG_SCALE: Final = 20.0

_AXIS_BITS = (11, 10, 11)
_COLOR_BITS = (8, 8, 8, 8)
_ROTATION_BITS = (2, 10, 10, 10)
_SQRT_TWO = float(np.sqrt(2))
_SH_RANGE_WIDTH = 8.0  # harmonics lie from -4 to 4

PackedWords = UInt32[np.ndarray, " n"]


def split_fields(words: PackedWords, widths: Sequence[int]) -> Int64[np.ndarray, "n m"]:
    """Split 32-bit words into bit fields of ``widths`` bits, highest bits first."""
    columns, shift = [], 32
    for width in widths:
        shift -= width
        columns.append(words.astype(np.int64) >> shift & ((1 << width) - 1))
    return np.stack(columns, axis=1)


def join_fields(numbers: Int64[np.ndarray, "n m"], widths: Sequence[int]) -> PackedWords:
    """Join bit fields of ``widths`` bits to 32-bit words; the inverse of ``split_fields``."""
    word, shift = np.zeros(len(numbers), np.int64), 32
    for column, width in zip(numbers.T, widths, strict=True):
        shift -= width
        word |= column << shift
    return word.astype(np.uint32)


def field_fractions(words: PackedWords, widths: Sequence[int]) -> Float64[np.ndarray, "n m"]:
    """Return the bit fields of 32-bit words as fractions of their maximum, from 0 to 1."""
    return split_fields(words, widths) / (2.0 ** np.array(widths) - 1)


def from_shares(values: Float[np.ndarray, "n m"], widths: Sequence[int]) -> PackedWords:
    """Pack fractions, clipped to [0, 1], into bit fields of words; the inverse of ``field_fractions``."""
    numbers = rounded(np.clip(values, 0, 1) * (2.0 ** np.array(widths) - 1), 0, 2**31)
    return join_fields(numbers, widths)


def unpack_in_box(
    words: PackedWords, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """Unpack positions or log scales that are stored relative to a chunk's bounding box."""
    fractions = field_fractions(words, _AXIS_BITS)
    with np.errstate(invalid="ignore", over="ignore"):  # the checks of values follow
        return np.asarray(low * (1 - fractions) + high * fractions, np.float32)


def pack_in_box(
    values: Float32[np.ndarray, "n 3"],
    low: Float[np.ndarray, "n 3"],
    high: Float[np.ndarray, "n 3"],
) -> PackedWords:
    """Pack positions or log scales relative to the bounding box of their chunk of splats."""
    return from_shares(_fraction_in_box(values, low, high), _AXIS_BITS)


def unpack_rotation(words: PackedWords) -> Float32[np.ndarray, "n 4"]:
    """Unpack 32-bit words to unit quaternions (w, x, y, z)."""
    largest = split_fields(words, _ROTATION_BITS)[:, 0]
    smaller = (field_fractions(words, _ROTATION_BITS)[:, 1:] - 0.5) * _SQRT_TWO
    return unit(quaternions_from_largest(largest, smaller))


def pack_rotation(rotation: Float32[np.ndarray, "n 4"]) -> PackedWords:
    """Pack quaternions (w, x, y, z) into 32-bit words."""
    largest, smaller = without_largest(unit(rotation))
    numbers = rounded((smaller / _SQRT_TWO + 0.5) * 1023, 0, 1023)
    return join_fields(np.column_stack([largest, numbers]), _ROTATION_BITS)


def unpack_color(
    words: PackedWords, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
    """Unpack 32-bit words to degree-0 SH coefficients and opacity logits."""
    fractions = field_fractions(words, _COLOR_BITS)
    with np.errstate(invalid="ignore", over="ignore"):
        color = low * (1 - fractions[:, :3]) + high * fractions[:, :3]
        return ((color - 0.5) / SH_C0).astype(np.float32), logit(fractions[:, 3])


def color_of(constant: Float32[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Convert degree-0 SH coefficients to RGB colours."""
    return np.asarray(0.5 + SH_C0 * constant.astype(np.float64))


def pack_color(
    color: Float64[np.ndarray, "n 3"],
    logit_opacity: Float32[np.ndarray, " n"],
    low: Float[np.ndarray, "n 3"],
    high: Float[np.ndarray, "n 3"],
) -> PackedWords:
    """Pack RGB colours, relative to their chunk's range, and opacities into 32-bit words."""
    fractions = np.column_stack([_fraction_in_box(color, low, high), sigmoid(logit_opacity)])
    return from_shares(fractions, _COLOR_BITS)


def unpack_sh(sh_bytes: UInt8[np.ndarray, "n m"]) -> Float32[np.ndarray, "n m"]:
    """Unpack bytes to SH coefficients above degree 0."""
    fractions = (sh_bytes + 0.5) / 256
    fractions[sh_bytes == 0], fractions[sh_bytes == 255] = 0, 1
    return ((fractions - 0.5) * _SH_RANGE_WIDTH).astype(np.float32)


def pack_sh(sh: Float32[np.ndarray, "n m"]) -> UInt8[np.ndarray, "n m"]:
    """Pack SH coefficients above degree 0 into bytes."""
    return to_bytes(np.floor((sh.astype(np.float64) / _SH_RANGE_WIDTH + 0.5) * 256))


def _fraction_in_box(
    values: Float[np.ndarray, "n 3"], low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Return values as fractions of the range from ``low`` to ``high``; 0 for an empty range."""
    extent = high.astype(np.float64) - low
    return np.asarray((values - low.astype(np.float64)) / np.where(extent > 0, extent, 1))
