"""Reads columns of any PLY file by name, for files that do not hold splats.

Methods that store anchors, or other points that a network turns into splats, use PLY with their
own properties.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float32

from gsgen.formats.ply.columns import read_columns
from gsgen.formats.ply.header import parse_header
from gsgen.formats.ply.layout import find_vertex
from gsgen.formats.shared.errors import PropertyMissing, join_names
from gsgen.formats.shared.files import FilePath, map_file
from gsgen.formats.shared.values import require_finite, require_rows

__all__ = ["ply_infos", "ply_properties", "read_ply_columns"]


def ply_properties(path: FilePath) -> tuple[str, ...]:
    """Return the property names of the PLY element ``vertex``, in the order of the file."""
    with map_file(path) as data:
        return tuple(item.name for item in find_vertex(parse_header(data)).properties)


def ply_infos(path: FilePath) -> tuple[str, ...]:
    """Return the texts of the lines ``obj_info`` in the header of a PLY file."""
    with map_file(path) as data:
        return parse_header(data).infos


def read_ply_columns(
    path: FilePath, groups: Mapping[str, Sequence[str]]
) -> dict[str, Float32[np.ndarray, "n m"]]:
    """Read one array for each group of PLY properties, with one column per property.

    Numbers may be text or binary, of either byte order and any type; they become float32 and
    must be finite.
    """
    with map_file(path) as data:
        header = parse_header(data)
        vertex = find_vertex(header)
        _require_properties(vertex.types, groups)
        require_rows(vertex.count, "element 'vertex'")
        tables = read_columns(data, header, vertex, groups)
        for group, names in groups.items():
            require_finite(tables[group], [f"property {name}" for name in names])
        return tables


def _require_properties(types: Mapping[str, str], groups: Mapping[str, Sequence[str]]) -> None:
    needed = [name for names in groups.values() for name in names]
    missing = [name for name in needed if name not in types]
    if missing:
        raise PropertyMissing(
            f"the properties {join_names(missing, limit=100)} are missing; found {join_names(list(types))}",
            where="element 'vertex'",
            expected=f"the properties {join_names(needed, limit=100)}",
        )
