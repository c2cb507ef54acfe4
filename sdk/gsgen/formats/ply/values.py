"""Checks splats and points of a PLY file; drops or refuses values that cannot be drawn."""

import os
import warnings
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32

from gsgen.formats.ply.layout import COLORS, XYZ, splat_groups
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splat_values import Labels, require_drawable
from gsgen.formats.shared.splats import MAX_FLOAT32_OFFSET, NO_ORIGIN, PointCloud, Splats
from gsgen.formats.shared.values import require_colors, require_finite, require_rows

_ORIGIN_STEP: Final = 1000.0
_MIN_REPORTED_LOSS: Final = 1e-4  # of a coordinate, in units
VERTEX: Final = "element 'vertex'"
"""The place of the rows of a PLY file, in messages."""


def splat_labels(splats: Splats) -> Labels:
    """Return the PLY property names of each array's columns."""
    return splat_groups(splats.degree)


def require_splats(splats: Splats, *, checked_fields: Collection[str] = ()) -> None:
    """Raise ValueInvalid if ``splats`` is empty or holds a row that cannot be drawn.

    Arrays that are named in ``checked_fields`` are known to be valid.
    """
    labels = splat_labels(splats)
    require_drawable(splats, labels=labels, where=VERTEX, checked_fields=checked_fields)


def only_finite(cloud: PointCloud, path: FilePath) -> PointCloud:
    """Return the points with finite positions, and warn about dropped points of the PLY file."""
    is_valid = np.isfinite(cloud.position)
    is_drawable = is_valid.all(axis=1)
    if is_drawable.all():
        return cloud
    if not is_drawable.any():
        require_finite(cloud.position, _labels(XYZ))
    _warn_of_dropped_values(path, is_valid, cloud.position, XYZ)
    return PointCloud(cloud.position[is_drawable], cloud.color[is_drawable])


def _warn_of_dropped_values(
    path: FilePath,
    is_valid: Bool[np.ndarray, "n m"],
    values: Float32[np.ndarray, "n m"],
    names: Sequence[str],
) -> None:
    """Warn about the number of rows dropped from a PLY file, and the fault of the first one."""
    is_drawable = np.asarray(is_valid.all(axis=1))
    row, dropped_count = (
        int(np.argmin(is_drawable)),
        len(is_drawable) - int(np.count_nonzero(is_drawable)),
    )
    column = int(np.argmin(is_valid[row]))
    text = (
        f"{path}: {dropped_count:,} of {len(is_drawable):,} rows cannot be drawn and are left out; row {row} "
        f"is the first, where {names[column]} is {values[row, column]:g}"
    )
    warnings.warn(text, FormatWarning, stacklevel=2)


def near_origin(
    position: Float[np.ndarray, "n 3"], path: FilePath
) -> tuple[Float32[np.ndarray, "n 3"], tuple[float, float, float]]:
    """Return positions as float32, relative to an origin if they are far from zero.

    Coordinates of maps are millions of units, where float32 has steps of half a unit. The origin
    is a multiple of 1000, and a FormatWarning reports it.
    """
    if position.dtype == np.float32:
        return np.asarray(position, np.float32), NO_ORIGIN  # no copy
    with np.errstate(over="ignore", invalid="ignore"):
        position32 = position.astype(np.float32)
    is_finite = np.isfinite(position32).all(axis=1)
    if not is_finite.any():
        return position32, NO_ORIGIN
    low, high = position[is_finite].min(axis=0), position[is_finite].max(axis=0)
    if np.abs([low, high]).max() <= MAX_FLOAT32_OFFSET:
        return position32, NO_ORIGIN
    origin = np.round((low + high) / 2 / _ORIGIN_STEP) * _ORIGIN_STEP + 0.0  # no -0
    loss = np.abs(position[is_finite] - position32[is_finite]).max()
    if not origin.any() or loss < _MIN_REPORTED_LOSS:
        return position32, NO_ORIGIN
    x, y, z = (float(value) for value in origin)
    text = (
        f"{os.fspath(path)}: positions are relative to ({x:.0f}, {y:.0f}, {z:.0f}): as float32 "
        f"they would be off by up to {loss:.3g} units"
    )
    warnings.warn(text, FormatWarning, stacklevel=3)
    return (position - origin).astype(np.float32), (x, y, z)


def require_cloud(cloud: PointCloud, colors: Sequence[str] = COLORS[0]) -> None:
    """Raise ValueInvalid if a point cloud is empty or holds a value that cannot be drawn."""
    require_rows(len(cloud), VERTEX)
    require_finite(cloud.position, _labels(XYZ))
    require_colors(cloud.color, _labels(colors))


def _labels(names: Sequence[str]) -> list[str]:
    return [f"property {name}" for name in names]
