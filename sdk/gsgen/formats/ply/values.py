"""Refuse splats and points that cannot be drawn, or leave them out, in the words of a PLY file."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32

from gsgen.formats.ply.layout import COLORS, XYZ, splat_groups
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splat_values import INFINITE
from gsgen.formats.shared.splats import PointCloud, Splats
from gsgen.formats.shared.values import (
    meaning_something,
    require_colors,
    require_finite,
    require_rows,
)


def require_splats(splats: Splats) -> None:
    """Raise ValueInvalid unless there are splats and all can be drawn."""
    require_rows(len(splats), "element 'vertex'")
    for array, names, table in _tables(splats):
        require_finite(table, _labels(names), INFINITE.get(array, ()))


def only_drawable(splats: Splats, path: FilePath) -> Splats:
    """Return the splats of ``path`` that can be drawn, and warn of how many cannot.

    Raises:
        ValueInvalid: None can be drawn.
    """
    try:
        require_splats(splats)
    except ValueInvalid:
        fine = np.concatenate(
            [
                meaning_something(one, INFINITE.get(array, ()))
                for array, _, one in _tables(splats)
            ],
            axis=1,
        )
        kept = fine.all(axis=1)
        if not kept.any():
            raise
    else:
        return splats
    values = np.concatenate([one for *_, one in _tables(splats)], axis=1)
    labels = [name for _, names, _ in _tables(splats) for name in names]
    _warn_of(path, fine, values, labels)
    return replace(
        splats, **{array: getattr(splats, array)[kept] for array, *_ in _tables(splats)}
    )


def only_finite(cloud: PointCloud, path: FilePath) -> PointCloud:
    """Return the points of ``path`` that are somewhere, and warn of how many are not.

    Raises:
        ValueInvalid: None is.
    """
    fine = np.isfinite(cloud.position)
    kept = fine.all(axis=1)
    if kept.all():
        return cloud
    if not kept.any():
        require_finite(cloud.position, _labels(XYZ))
    _warn_of(path, fine, cloud.position, XYZ)
    return PointCloud(cloud.position[kept], cloud.color[kept])


def _warn_of(
    path: FilePath,
    fine: Bool[np.ndarray, "n m"],
    values: Float32[np.ndarray, "n m"],
    names: Sequence[str],
) -> None:
    """Warn of the rows that are left out, and say what is wrong with the first of them."""
    kept = np.asarray(fine.all(axis=1))
    row, left = int(np.argmin(kept)), len(kept) - int(np.count_nonzero(kept))
    column = int(np.argmin(fine[row]))
    text = (
        f"{path}: {left:,} of {len(kept):,} rows cannot be drawn and are left out; row {row} "
        f"is the first, where {names[column]} is {values[row, column]:g}"
    )
    warnings.warn(text, FormatWarning, stacklevel=2)


def _tables(splats: Splats) -> list[tuple[str, Sequence[str], Float32[np.ndarray, "n m"]]]:
    """Return each array of the splats, with what its columns are called in a file."""
    return [
        (array, names, getattr(splats, array).reshape(len(splats), len(names)))
        for array, names in splat_groups(splats.degree).items()
    ]


def require_cloud(cloud: PointCloud, colors: Sequence[str] = COLORS[0]) -> None:
    """Raise ValueInvalid unless there are points and all can be drawn.

    Args:
        cloud: The points.
        colors: What the file calls red, green and blue.
    """
    require_rows(len(cloud), "element 'vertex'")
    require_finite(cloud.position, _labels(XYZ))
    require_colors(cloud.color, _labels(colors))


def _labels(names: Sequence[str]) -> list[str]:
    return [f"property {name}" for name in names]
