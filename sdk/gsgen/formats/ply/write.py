"""Writes splats and point clouds as PLY files."""

from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np
from jaxtyping import Float32

from gsgen.formats.ply.header import ANTIALIASED_COMMENT, ENCODINGS, Encoding
from gsgen.formats.ply.layout import COLORS, XYZ, splat_groups, splat_names
from gsgen.formats.ply.values import require_cloud, require_splats
from gsgen.formats.shared.errors import ValueInvalid, shown
from gsgen.formats.shared.files import FilePath, naming, replacing
from gsgen.formats.shared.splats import PointCloud, Splats

CHUNK_ROWS = 1 << 12

Columns = dict[str, tuple[str, Float32[np.ndarray, " n"]]]
"""The type and the values of each property, in the order of the file."""


def write_ply(
    path: FilePath, content: Splats | PointCloud, *, format: Encoding = "binary_little_endian"
) -> None:
    """Write splats or coloured points to ``path`` as a PLY file.

    Splats are kept bit for bit. The colours of a point cloud are written as bytes, which other
    programs expect, with an error of at most 1/510. The file is written completely or not at
    all.

    Raises:
        ValueInvalid: ``content`` is empty or holds values that cannot be drawn, or
            ``format`` is unknown.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with naming(path):
        if format not in ENCODINGS:
            raise ValueInvalid(shown(str(format)), where="format", expected=", ".join(ENCODINGS))
        columns = _splat_columns(content) if isinstance(content, Splats) else _points(content)
    with replacing(path) as file:
        is_antialiased = isinstance(content, Splats) and content.antialiased
        file.write(_header(columns, len(content), format, antialiased=is_antialiased))
        for chunk in _chunks(columns, len(content)):
            _write_rows(file, chunk, format)


def write_ply_parts(path: FilePath, parts: Iterable[Splats], count: int) -> None:
    """Write ``count`` splats as a binary PLY file; the parts have equal SH degree and flags."""
    encoding: Encoding = "binary_little_endian"
    with replacing(path) as file:
        for index, part in enumerate(parts):
            columns = _splat_columns(part)
            if index == 0:
                file.write(_header(columns, count, encoding, antialiased=part.antialiased))
            for chunk in _chunks(columns, len(part)):
                _write_rows(file, chunk, encoding)


def _splat_columns(splats: Splats) -> Columns:
    require_splats(splats)
    columns = {}
    for array, names in splat_groups(splats.degree).items():
        table = getattr(splats, array).reshape(len(splats), len(names))
        columns.update({name: ("f4", table[:, i]) for i, name in enumerate(names)})
    return {name: columns[name] for name in splat_names(splats.degree)}


def _points(cloud: PointCloud) -> Columns:
    require_cloud(cloud)
    color = np.rint(cloud.color * np.float32(255))
    properties = {name: ("f4", cloud.position[:, i]) for i, name in enumerate(XYZ)}
    return properties | {name: ("u1", color[:, i]) for i, name in enumerate(COLORS[0])}


def _header(columns: Columns, count: int, encoding: Encoding, *, antialiased: bool) -> bytes:
    words = {"f4": "float", "u1": "uchar"}
    lines = [
        "ply",
        f"format {encoding} 1.0",
        *([ANTIALIASED_COMMENT] if antialiased else []),
        f"element vertex {count}",
        *(f"property {words[code]} {name}" for name, (code, _) in columns.items()),
        "end_header\n",
    ]
    return "\n".join(lines).encode("ascii")


def _chunks(columns: Columns, count: int) -> Iterator[Columns]:
    for start in range(0, count, CHUNK_ROWS):
        yield {
            name: (code, values[start : start + CHUNK_ROWS])
            for name, (code, values) in columns.items()
        }


def _write_rows(file: BinaryIO, columns: Columns, encoding: Encoding) -> None:
    if encoding == "ascii":
        # Nine digits identify every float32.
        digits = ["%.9g" if code == "f4" else "%d" for code, _ in columns.values()]
        np.savetxt(file, np.stack([v for _, v in columns.values()], axis=1), fmt=digits)
        return
    order = ">" if encoding == "binary_big_endian" else "<"
    fields = [(name, order + code) for name, (code, _) in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))[1]), np.dtype(fields))
    for name, (_, values) in columns.items():
        rows[name] = values
    file.write(rows.tobytes())
