"""The names of the properties of splats and of point clouds in PLY files.

The names of splats are those of ``save_ply`` in the 3DGS training code
(graphdeco-inria/gaussian-splatting, ``scene/gaussian_model.py``).
"""

import math
import re
from collections.abc import Collection, Mapping

from gsgen.formats.ply.header import Element, Header
from gsgen.formats.shared.errors import NotSupported, PropertyMissing, join_names
from gsgen.formats.shared.splats import SH_COUNTS

XYZ = ("x", "y", "z")
COLORS = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
"""The property names of a point's colour, the most common first."""

_CONSTANT_NAMES = ("f_dc_0", "f_dc_1", "f_dc_2")
_REST_NAME = re.compile(r"f_rest_\d+")
_HIGHER_SH_VALUE_COUNTS = tuple(3 * (count - 1) for count in SH_COUNTS)


def splat_groups(degree: int) -> dict[str, tuple[str, ...]]:
    """Return the PLY property names of each array of ``Splats``, in the order of its columns.

    The file lists ``f_rest`` channel-major: all of red, then green, then blue. The names are
    returned coefficient-major, so that reading by name reorders them.
    """
    higher_count = (degree + 1) ** 2 - 1
    higher_sh_names = (
        f"f_rest_{c * higher_count + k}" for k in range(higher_count) for c in range(3)
    )
    return {
        "position": XYZ,
        "sh": ("f_dc_0", "f_dc_1", "f_dc_2", *higher_sh_names),
        "logit_opacity": ("opacity",),
        "log_scale": ("scale_0", "scale_1", "scale_2"),
        "rotation": ("rot_0", "rot_1", "rot_2", "rot_3"),
    }


def splat_names(degree: int) -> list[str]:
    """Return the PLY property names of splats in the order that 3DGS training code writes."""
    higher_count = 3 * (degree + 1) ** 2 - 3
    return [
        *XYZ,
        *(f"f_dc_{index}" for index in range(3)),
        *(f"f_rest_{index}" for index in range(higher_count)),
        "opacity",
        *(f"scale_{index}" for index in range(3)),
        *(f"rot_{index}" for index in range(4)),
    ]


def find_vertex(header: Header) -> Element:
    """Return the PLY element ``vertex``, whose rows are splats or points."""
    vertex = header.find("vertex")
    if vertex is None:
        names = join_names([element.name for element in header.elements])
        raise PropertyMissing(
            f"the PLY file has no element 'vertex', only {names}", expected="element 'vertex'"
        )
    if "packed_position" in vertex.types:
        raise NotSupported(
            "the file is a compressed PLY",
            where="element 'vertex', property packed_position",
            expected="a plain 3DGS PLY",
            hint="unpack it: `gsgen convert packed.ply plain.ply`",
        )
    list_properties = [item.name for item in vertex.properties if item.count_type]
    if list_properties:
        raise NotSupported(
            f"the properties {join_names(list_properties)} are lists",
            where="element 'vertex'",
            expected="plain numbers",
        )
    return vertex


def is_splat(names: Collection[str]) -> bool:
    """Return whether a PLY file has a property that only splats have, such as ``f_dc_0``."""
    splat_only_names = set(splat_names(0)).difference(XYZ)
    return any(name in splat_only_names or _REST_NAME.fullmatch(name) for name in names)


def splat_colors(names: Collection[str]) -> tuple[str, ...]:
    """Return the PLY properties of a colour that stand for ``f_dc``, as nerfstudio writes them.

    Nothing if the file has ``f_dc``, or no colour.
    """
    if any(name in names for name in _CONSTANT_NAMES):
        return ()
    return next((colors for colors in COLORS if set(colors) <= set(names)), ())


def splat_degree(names: Collection[str]) -> int:
    """Return the SH degree of a PLY splat file from its property names.

    Raises:
        PropertyMissing: A property of splats is missing, or the number of ``f_rest`` fits
            no degree.
    """
    replaced_names = _CONSTANT_NAMES if splat_colors(names) else ()
    _require_all_properties(names, splat_names(0), replaced_names)
    higher_sh_names = [name for name in names if _REST_NAME.fullmatch(name)]
    if len(higher_sh_names) not in _HIGHER_SH_VALUE_COUNTS:
        raise PropertyMissing(
            f"the file has {len(higher_sh_names)} properties f_rest: {join_names(higher_sh_names)}",
            where="element 'vertex'",
            expected="0, 9, 24, 45 or 72, for SH degree 0 to 4",
        )
    degree = math.isqrt(len(higher_sh_names) // 3 + 1) - 1
    _require_all_properties(names, splat_names(degree), replaced_names)
    return degree


def _require_all_properties(
    names: Collection[str], needed: list[str], replaced_names: Collection[str]
) -> None:
    missing = [name for name in needed if name not in names and name not in replaced_names]
    if not missing:
        return
    hint = ""
    if missing == ["scale_2"]:
        hint = "two scales look like a 2DGS file: `gsgen export 2dgs` reads its flat splats"
    raise PropertyMissing(
        f"the properties {join_names(missing, limit=100)} are missing; found {join_names(list(names))}",
        where="element 'vertex'",
        expected="all properties of a 3DGS PLY",
        hint=hint,
    )


def cloud_colors(types: Mapping[str, str]) -> tuple[str, ...]:
    """Return the PLY property names of red, green and blue of a point cloud."""
    matches = {names: len(types.keys() & set(names)) for names in COLORS}
    colors = max(COLORS, key=lambda names: matches[names])  # the first one with the most properties
    missing = [name for name in (*XYZ, *colors) if name not in types]
    if missing:
        raise PropertyMissing(
            f"the properties {join_names(missing)} are missing; found {join_names(list(types))}",
            where="element 'vertex'",
            expected="x, y, z and a colour, or all properties of a 3DGS PLY",
        )
    kinds = {types[name] for name in colors}
    if not (kinds == {"u1"} or kinds <= {"f4", "f8"}):
        raise NotSupported(
            f"the colours have the types {', '.join(types[name] for name in colors)}",
            where=f"properties {', '.join(colors)}",
            expected="uchar (0 to 255) for all, or float (0 to 1) for all",
        )
    return colors
