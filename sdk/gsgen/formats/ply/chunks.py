"""Reads row ranges of a 3DGS PLY file, for scenes that do not fit into memory."""

__all__ = ["PlyTable", "ply_table", "read_ply_rows"]

import os
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from gsgen.formats.ply.binary import first_row
from gsgen.formats.ply.header import parse_header
from gsgen.formats.ply.layout import (
    find_vertex,
    is_splat,
    splat_colors,
    splat_degree,
    splat_groups,
    splat_names,
)
from gsgen.formats.ply.methods import FILTER_PROPERTY
from gsgen.formats.ply.packed import is_packed
from gsgen.formats.ply.ply import declared_color_space
from gsgen.formats.ply.unused import unused_parts
from gsgen.formats.shared.errors import FileTruncated
from gsgen.formats.shared.files import FilePath, map_file, naming
from gsgen.formats.shared.splats import DEFAULT_UP, Splats


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlyTable:
    """The location of the splats in a binary PLY file whose properties are all float32.

    Attributes:
        count: Splats.
        degree: Their SH degree.
        first_byte: Offset of the first row.
        columns: Properties of a row, in the order of the file.
        antialiased: Whether the header says that training used the filter of Mip-Splatting.
        color_space: The declared colour space.
        up: The declared upward direction.
        unused: The declared parts that are not used.
    """

    count: int
    degree: int
    first_byte: int
    columns: tuple[str, ...]
    antialiased: bool = False
    color_space: Literal["srgb", "linear"] = "srgb"
    up: tuple[float, float, float] = DEFAULT_UP
    unused: tuple[str, ...] = ()

    @property
    def row_bytes(self) -> int:
        """The size in bytes of one row of the PLY file."""
        return 4 * len(self.columns)


def ply_table(path: FilePath) -> PlyTable | None:
    """Return where the splats lie in the PLY file at ``path``: offset, count, row size.

    Returns:
        None where rows cannot be read by ranges: the numbers are text, big-endian, packed or of
        several types, or the file holds points. :func:`~gsgen.formats.read_ply` reads those.
    """
    with map_file(path) as data:
        header = parse_header(data)
        if is_packed(header):
            return None
        vertex = find_vertex(header)
        types = vertex.types
        is_float32 = header.encoding == "binary_little_endian" and set(types.values()) == {"f4"}
        if not (is_float32 and is_splat(types)) or splat_colors(types):
            return None
        degree = splat_degree(types)
        space, used_space = declared_color_space(data, header)
        used = {vertex.name: (*splat_names(degree), FILTER_PROPERTY), **used_space}
        return PlyTable(
            count=vertex.count,
            degree=degree,
            first_byte=first_row(data, header, vertex),
            columns=tuple(types),
            antialiased=header.antialiased,
            color_space=space,
            up=header.up or DEFAULT_UP,
            unused=tuple(unused_parts(data, header, used)),
        )


def read_ply_rows(path: FilePath, table: PlyTable, first: int, count: int) -> Splats:
    """Read ``count`` splats of a PLY file from row ``first`` on, without checking values."""
    width = len(table.columns)
    offset = table.first_byte + first * table.row_bytes
    with naming(path):
        rows = np.fromfile(os.fspath(path), "<f4", count * width, offset=offset)
        if len(rows) < count * width:
            raise FileTruncated(
                f"the file ends after {len(rows) // width} of {count} rows from row {first} on",
                where="element 'vertex'",
                hint="copy or download the file again",
            )
    rows = rows.reshape(count, width)
    index = {name: column for column, name in enumerate(table.columns)}
    arrays = {
        array: np.take(rows, [index[name] for name in names], axis=1)
        for array, names in splat_groups(table.degree).items()
    }
    return Splats(
        position=arrays["position"],
        rotation=arrays["rotation"],
        log_scale=arrays["log_scale"],
        logit_opacity=arrays["logit_opacity"].reshape(-1),
        sh=arrays["sh"].reshape(count, -1, 3),
        antialiased=table.antialiased,
        color_space=table.color_space,
        up=table.up,
    )
