"""Origins of splats: float32 positions relative to a float64 point keep the digits of the file.

Coordinates of maps are millions of units, where float32 has steps of half a unit.
"""

__all__ = [
    "Origin",
    "in_file_coordinates",
    "is_printed_float32",
    "join_splats",
    "middle_origin",
    "near_zero",
    "origin_text",
    "parse_origin",
    "relative_positions",
    "relative_to",
    "with_origin",
]

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splats import (
    MAX_FLOAT32_OFFSET,
    NO_ORIGIN,
    PackedRows,
    PointCloud,
    Splats,
)

Origin = tuple[float, float, float]
"""The point that positions are relative to, in the coordinates of the file."""
Placed = TypeVar("Placed", bound=Splats | PointCloud)
Content = TypeVar("Content", bound=Splats | PointCloud | PackedRows)

_ORIGIN_STEP: Final = 1000.0
_NINE_DIGITS: Final = 5.001e-9  # the largest relative error of nine digits
_MIN_REPORTED_LOSS: Final = 1e-4  # of a coordinate, in units


def relative_positions(
    position: Float[np.ndarray, "n 3"],
) -> tuple[Float32[np.ndarray, "n 3"], Origin, float]:
    """Return positions as float32, their origin, and the largest error that this leaves.

    The origin is 0 unless float32 would lose more than 1/10,000 unit of coordinates above 16,384;
    then it is the multiple of 1000 in the middle. Float32 positions are returned as they are.
    """
    if position.dtype == np.float32:
        return np.asarray(position, np.float32), NO_ORIGIN, 0.0  # no copy
    with np.errstate(over="ignore", invalid="ignore"):
        position32 = position.astype(np.float32)
        error = np.abs(position - position32)
    is_finite = np.asarray(np.isfinite(error).all(axis=1))
    if not is_finite.any():
        return position32, NO_ORIGIN, 0.0
    loss = float(error.max(where=is_finite[:, None], initial=0))
    finite_positions = position if is_finite.all() else position[is_finite]
    low, high = finite_positions.min(axis=0), finite_positions.max(axis=0)
    if np.abs([low, high]).max() <= MAX_FLOAT32_OFFSET or loss < _MIN_REPORTED_LOSS:
        return position32, NO_ORIGIN, loss
    origin = np.round((low + high) / 2 / _ORIGIN_STEP) * _ORIGIN_STEP + 0.0  # no -0
    if not origin.any():
        return position32, NO_ORIGIN, loss
    x, y, z = (float(value) for value in origin)
    with np.errstate(invalid="ignore", over="ignore"):
        offset = position - origin
        offset32 = offset.astype(np.float32)
        error = np.abs(offset - offset32)
    return offset32, (x, y, z), float(error.max(where=is_finite[:, None], initial=0))


def is_printed_float32(numbers: Float[np.ndarray, "..."]) -> bool:
    """Return whether numbers are float32 numbers, or their nine digits, which identify them."""
    if numbers.dtype == np.float32:
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(numbers - numbers.astype(np.float32))
        return not bool((error > _NINE_DIGITS * np.abs(numbers)).any())


def relative_to(content: Placed, origin: Origin) -> Placed:
    """Return the same splats or points with positions relative to another origin.

    The largest error of the new float32 positions is added to ``rounding``.
    """
    shift = np.subtract(content.origin, origin)
    if not shift.any():
        return content if content.origin == origin else replace(content, origin=origin)
    with np.errstate(invalid="ignore", over="ignore"):
        offset = content.position + shift
        position = offset.astype(np.float32)
        error = np.abs(offset - position)
    rounding = float(error.max(where=np.isfinite(error), initial=0))
    return replace(content, position=position, origin=origin, rounding=content.rounding + rounding)


def with_origin(content: Content, origin: Origin | None, path: str | os.PathLike[str]) -> Content:
    """Return the content of a file with positions relative to an origin.

    None keeps the origin that its reader chose, and names it (FormatWarning).

    Raises:
        NotSupported: The content is packed rows, which have no origin.
    """
    if origin is None:
        if not isinstance(content, PackedRows) and any(content.origin):
            _warn_of_origin(path, content.origin)
        return content
    if isinstance(content, PackedRows):
        raise NotSupported(
            "packed rows have no origin", where="origin", expected="a file of splats or points"
        )
    return relative_to(content, origin)


def in_file_coordinates(content: Splats | PointCloud) -> Float64[np.ndarray, "n 3"]:
    """Return the positions in the coordinates of the file, as float64."""
    return np.asarray(content.position.astype(np.float64) + np.asarray(content.origin))


def near_zero(splats: Splats) -> Splats:
    """Return splats without an origin where float32 keeps a thousandth of a unit without one."""
    if np.abs(splats.origin).max() > MAX_FLOAT32_OFFSET:
        return splats
    return relative_to(splats, NO_ORIGIN)


def join_splats(parts: Sequence[Splats]) -> Splats:
    """Concatenate sets of splats; SH coefficients that a set lacks are zero.

    Different origins become one in the middle.
    """
    if len(parts) == 1:
        return parts[0]
    parts = _with_common_origin(parts)
    count = max(part.sh.shape[1] for part in parts)

    def join(name: str) -> Float32[np.ndarray, "..."]:
        return np.concatenate([getattr(part, name) for part in parts])

    def padded(sh: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "n l 3"]:
        return np.pad(sh, [(0, 0), (0, count - sh.shape[1]), (0, 0)])

    return Splats(
        position=join("position"),
        rotation=join("rotation"),
        log_scale=join("log_scale"),
        logit_opacity=join("logit_opacity"),
        sh=np.concatenate([padded(part.sh) for part in parts]),
        antialiased=any(part.antialiased for part in parts),
        color_space=parts[0].color_space,
        up=parts[0].up,
        origin=parts[0].origin,
        rounding=max(part.rounding for part in parts),
    )


def _with_common_origin(parts: Sequence[Splats]) -> list[Splats]:
    """Return sets of splats with one common origin: the middle of theirs, if they differ."""
    if len({part.origin for part in parts}) == 1:
        return list(parts)
    origin = middle_origin([part.origin for part in parts])
    return [relative_to(part, origin) for part in parts]


def middle_origin(origins: Sequence[Origin]) -> Origin:
    """Return one origin for several files: the middle of those that are not 0."""
    far_origins = sorted({origin for origin in origins if any(origin)})
    if len(far_origins) < 2:
        return far_origins[0] if far_origins else NO_ORIGIN
    middle = (np.min(far_origins, axis=0) + np.max(far_origins, axis=0)) / 2
    x, y, z = (float(value) for value in np.round(middle / _ORIGIN_STEP) * _ORIGIN_STEP + 0.0)
    return x, y, z


def origin_text(origin: Origin) -> str:
    """Return an origin for a message: ``(449000, 5411000, 0)``."""
    return f"({', '.join(f'{value:.15g}' for value in origin)})"


def parse_origin(text: str) -> Origin | None:
    """Parse the value of ``--origin``: X,Y,Z, or ``auto``, for which None is returned.

    Raises:
        ConfigInvalid: The text is neither.
    """
    if text == "auto":
        return None
    try:
        x, y, z = (float(word) for word in text.split(","))
    except ValueError as error:
        message = f"{text!r} is not a point, expected auto or X,Y,Z, such as 449000,5411000,0"
        raise ConfigInvalid(message, where="--origin") from error
    if not all(map(math.isfinite, (x, y, z))):
        raise ConfigInvalid(f"{text!r} is not finite, expected auto or X,Y,Z", where="--origin")
    return x, y, z


def _warn_of_origin(path: str | os.PathLike[str], origin: Origin, *, stacklevel: int = 3) -> None:
    """Warn that positions are relative to an origin (FormatWarning)."""
    text = (
        f"{os.fspath(path)}: positions are relative to {origin_text(origin)}, "
        "which float32 needs for the digits of the file"
    )
    warnings.warn(text, FormatWarning, stacklevel=stacklevel)
