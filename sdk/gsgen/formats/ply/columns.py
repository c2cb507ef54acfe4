"""Read properties of a PLY file, chosen by name, into dense arrays."""

import mmap
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float32

from gsgen.formats.ply.ascii import ascii_rows
from gsgen.formats.ply.binary import binary_rows, first_row
from gsgen.formats.ply.header import Element, Header

CHUNK_ROWS = 1 << 10
"""Rows that stay in a processor's cache while each group picks its columns."""


def read_columns(
    data: mmap.mmap, header: Header, vertex: Element, groups: Mapping[str, Sequence[str]]
) -> dict[str, Float32[np.ndarray, "n m"]]:
    """Return one array for each of ``groups``, a column for each name in it.

    Takes no more memory than these arrays and one chunk of rows: no array is made before
    the file is known to be long enough for it.

    Raises:
        FileTruncated: The file ends before the last row.
        BodyMalformed: A row of text, or a list on the way, breaks the rules.
    """
    if header.encoding == "binary_little_endian" and set(vertex.types.values()) == {"f4"}:
        return _floats(data, header, vertex, groups)
    read = ascii_rows if header.encoding == "ascii" else binary_rows
    chunks = read(data, header, vertex)
    tables = {
        group: np.empty((vertex.count, len(names)), np.float32)
        for group, names in groups.items()
    }
    at = 0
    # A double may be more than a float holds; as infinity it meets the checks of values.
    with np.errstate(over="ignore", invalid="ignore"):
        for columns in chunks:
            size = len(next(iter(columns.values())))
            for group, names in groups.items():
                for index, name in enumerate(names):
                    tables[group][at : at + size, index] = columns[name]
            at += size
    return tables


def _floats(
    data: mmap.mmap, header: Header, vertex: Element, groups: Mapping[str, Sequence[str]]
) -> dict[str, Float32[np.ndarray, "n m"]]:
    """Do the same where all is float32, as in files of the training code: in half the time."""
    shape = vertex.count, len(vertex.properties)
    rows = np.ndarray(shape, "<f4", data, first_row(data, header, vertex))
    places = {name: column for column, name in enumerate(vertex.types)}
    columns = {group: [places[name] for name in names] for group, names in groups.items()}
    tables = {
        group: np.empty((vertex.count, len(names)), np.float32)
        for group, names in groups.items()
    }
    for at in range(0, vertex.count, CHUNK_ROWS):
        part = slice(at, at + CHUNK_ROWS)
        for group, table in tables.items():
            # All columns are there: mode only spares np.take a copy.
            np.take(rows[part], columns[group], axis=1, out=table[part], mode="clip")
    return tables
