"""Refuse splats and points that cannot be drawn, in the words of a PLY file."""

from collections.abc import Sequence

from gsgen.formats._ply_layout import COLORS, XYZ, splat_groups
from gsgen.formats._splat_values import INFINITE
from gsgen.formats._values import require_colors, require_finite, require_rows
from gsgen.formats.splats import PointCloud, Splats


def require_splats(splats: Splats) -> None:
    """Raise ValueInvalid unless there are splats and all can be drawn."""
    require_rows(len(splats), "element 'vertex'")
    for array, names in splat_groups(splats.degree).items():
        table = getattr(splats, array).reshape(len(splats), len(names))
        require_finite(table, _labels(names), INFINITE.get(array, ()))


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
