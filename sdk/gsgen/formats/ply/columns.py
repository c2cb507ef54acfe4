"""Reads named properties of a PLY file into NumPy arrays."""

import mmap
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Float32

from gsgen.formats.ply.ascii import ascii_rows
from gsgen.formats.ply.binary import binary_rows, first_row
from gsgen.formats.ply.header import Element, Header

_ROWS_PER_RELEASE = 1 << 18
CHUNK_ROWS = 1 << 10
"""Rows a chunk; they fit in a processor's cache while each group copies its columns."""


def read_columns(
    data: mmap.mmap,
    header: Header,
    vertex: Element,
    groups: Mapping[str, Sequence[str]],
    wide_groups: Collection[str] = (),
) -> dict[str, Float[np.ndarray, "n m"]]:
    """Return one array for each group of PLY properties, one column per property.

    The memory is that of these arrays and one chunk of rows: the length of the file is checked
    before an array is allocated. Arrays are float32, those of ``wide_groups`` float64 where the
    file has text or doubles.
    """
    if header.encoding == "binary_little_endian" and set(vertex.types.values()) == {"f4"}:
        return _floats(data, header, vertex, groups)
    read = ascii_rows if header.encoding == "ascii" else binary_rows
    chunks = read(data, header, vertex)
    tables = {
        group: np.empty(
            (vertex.count, len(names)), np.float64 if group in wide_groups else np.float32
        )
        for group, names in groups.items()
    }
    start = 0
    # A double beyond float32 becomes infinite, which the checks of values refuse.
    with np.errstate(over="ignore", invalid="ignore"):
        for columns in chunks:
            size = len(next(iter(columns.values())))
            for group, names in groups.items():
                for index, name in enumerate(names):
                    tables[group][start : start + size, index] = columns[name]
            start += size
    return tables


def _floats(
    data: mmap.mmap, header: Header, vertex: Element, groups: Mapping[str, Sequence[str]]
) -> dict[str, Float32[np.ndarray, "n m"]]:
    """Read columns of a PLY file whose properties are all float32: faster than for mixed types."""
    shape = vertex.count, len(vertex.properties)
    rows = np.ndarray(shape, "<f4", data, first_row(data, header, vertex))
    column_indices = {name: column for column, name in enumerate(vertex.types)}
    columns = {
        group: np.array([column_indices[name] for name in names], np.intp)
        for group, names in groups.items()
    }
    tables = {
        group: np.empty((vertex.count, len(names)), np.float32) for group, names in groups.items()
    }
    for start in range(0, vertex.count, CHUNK_ROWS):
        part = slice(start, start + CHUNK_ROWS)
        chunk = rows[part]
        for group, table in tables.items():
            # All columns exist: the mode only saves `take` a copy.
            chunk.take(columns[group], axis=1, out=table[part], mode="clip")
        # Pages that were read need not stay in memory; Windows drops them by itself.
        if start % _ROWS_PER_RELEASE == 0 and hasattr(mmap, "MADV_DONTNEED"):
            data.madvise(mmap.MADV_DONTNEED)
    return tables
