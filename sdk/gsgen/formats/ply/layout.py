"""Which properties of a PLY file mean what: the names 3DGS and point clouds use.

The names of splats are those that ``save_ply`` of the 3DGS training code writes
(graphdeco-inria/gaussian-splatting, ``scene/gaussian_model.py``).
"""

import math
import re
from collections.abc import Collection, Mapping

from gsgen.formats.ply.header import Element, Header
from gsgen.formats.shared.errors import NotSupported, PropertyMissing, listed
from gsgen.formats.shared.splats import SH_COUNTS

XYZ = ("x", "y", "z")
COLORS = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
"""Names of the colour of a point, best known first."""

_REST_NAME = re.compile(r"f_rest_\d+")
_REST_COUNTS = tuple(3 * (count - 1) for count in SH_COUNTS)


def splat_groups(degree: int) -> dict[str, tuple[str, ...]]:
    """Return the properties that make up each array of ``Splats``, in its order.

    The file lists ``f_rest`` channel-major: all of red, then green, then blue. Here they
    are named coefficient-major, which is all that it takes to reorder them.
    """
    rest = (degree + 1) ** 2 - 1
    higher = (f"f_rest_{c * rest + k}" for k in range(rest) for c in range(3))
    return {
        "position": XYZ,
        "sh": ("f_dc_0", "f_dc_1", "f_dc_2", *higher),
        "logit_opacity": ("opacity",),
        "log_scale": ("scale_0", "scale_1", "scale_2"),
        "rotation": ("rot_0", "rot_1", "rot_2", "rot_3"),
    }


def splat_names(degree: int) -> list[str]:
    """Return the properties of splats in the order of the training code, less normals."""
    rest = 3 * (degree + 1) ** 2 - 3
    return [
        *XYZ,
        *(f"f_dc_{index}" for index in range(3)),
        *(f"f_rest_{index}" for index in range(rest)),
        "opacity",
        *(f"scale_{index}" for index in range(3)),
        *(f"rot_{index}" for index in range(4)),
    ]


def find_vertex(header: Header) -> Element:
    """Return the element that holds the points.

    Raises:
        PropertyMissing: There is none.
        NotSupported: Its rows are packed, or hold lists.
    """
    vertex = header.find("vertex")
    if vertex is None:
        found = listed([element.name for element in header.elements])
        raise PropertyMissing(
            f"no element 'vertex', found {found}", expected="element 'vertex'"
        )
    if "packed_position" in vertex.types:
        raise NotSupported(
            "a compressed PLY",
            where="element 'vertex', property packed_position",
            expected="a plain 3DGS PLY",
            hint="unpack it: `gsgen convert packed.ply plain.ply`",
        )
    lists = [item.name for item in vertex.properties if item.count_type]
    if lists:
        raise NotSupported(
            f"{listed(lists)} in lists", where="element 'vertex'", expected="plain numbers"
        )
    return vertex


def is_splat(names: Collection[str]) -> bool:
    """Say whether any property is one that only splats have."""
    own = set(splat_names(0)).difference(XYZ)
    return any(name in own or _REST_NAME.fullmatch(name) for name in names)


def splat_degree(names: Collection[str]) -> int:
    """Return the SH degree of a file of splats with these properties.

    Raises:
        PropertyMissing: A property of splats is missing, or the number of ``f_rest``
            is that of no degree.
    """
    _require_all(names, splat_names(0))
    rest = [name for name in names if _REST_NAME.fullmatch(name)]
    if len(rest) not in _REST_COUNTS:
        raise PropertyMissing(
            f"{len(rest)} properties f_rest: {listed(rest)}",
            where="element 'vertex'",
            expected="0, 9, 24, 45 or 72 of them, for SH degree 0 to 4",
        )
    degree = math.isqrt(len(rest) // 3 + 1) - 1
    _require_all(names, splat_names(degree))
    return degree


def _require_all(names: Collection[str], needed: list[str]) -> None:
    missing = [name for name in needed if name not in names]
    if not missing:
        return
    hint = ""
    if missing == ["scale_2"]:
        hint = "two scales look like a 2DGS file: flat splats, which are not read here"
    raise PropertyMissing(
        f"{listed(missing, limit=100)} missing, found {listed(list(names))}",
        where="element 'vertex'",
        expected="all properties of a 3DGS PLY, as some are there",
        hint=hint,
    )


def cloud_colors(types: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of red, green and blue in a point cloud with these properties.

    Raises:
        PropertyMissing: There is no position, or no colour.
        NotSupported: The colours are neither bytes nor floats.
    """
    found = {names: len(types.keys() & set(names)) for names in COLORS}
    colors = max(COLORS, key=lambda names: found[names])  # the first of the fullest
    missing = [name for name in (*XYZ, *colors) if name not in types]
    if missing:
        raise PropertyMissing(
            f"{listed(missing)} missing, found {listed(list(types))}",
            where="element 'vertex'",
            expected="x, y, z and a colour, or all properties of a 3DGS PLY",
        )
    kinds = {types[name] for name in colors}
    if not (kinds == {"u1"} or kinds <= {"f4", "f8"}):
        raise NotSupported(
            f"colours of types {', '.join(types[name] for name in colors)}",
            where=f"properties {', '.join(colors)}",
            expected="uchar (0 to 255) for all, or float (0 to 1) for all",
        )
    return colors
