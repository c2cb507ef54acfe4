"""Checks splats and points of a PLY file; drops or refuses values that cannot be drawn."""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32

from gsgen.formats.ply.layout import COLORS, XYZ, splat_groups
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splat_values import Labels, require_drawable
from gsgen.formats.shared.splats import PointCloud, Splats
from gsgen.formats.shared.values import require_colors, require_finite, require_rows

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
    return replace(cloud, position=cloud.position[is_drawable], color=cloud.color[is_drawable])


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


def require_cloud(cloud: PointCloud, colors: Sequence[str] = COLORS[0]) -> None:
    """Raise ValueInvalid if a point cloud is empty or holds a value that cannot be drawn."""
    require_rows(len(cloud), VERTEX)
    require_finite(cloud.position, _labels(XYZ))
    require_colors(cloud.color, _labels(colors))


def _labels(names: Sequence[str]) -> list[str]:
    return [f"property {name}" for name in names]
