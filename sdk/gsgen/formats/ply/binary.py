"""Reads a binary PLY file some rows at a time, as one array for each property."""

import mmap
from collections.abc import Iterator

import numpy as np
from jaxtyping import Shaped

from gsgen.formats.ply.header import Element, Header, Property
from gsgen.formats.shared.errors import BodyMalformed, FileTruncated, quoted

CHUNK_ROWS = 1 << 12
"""Rows a chunk; they fit in a processor's cache while their columns are copied."""


def binary_rows(
    data: mmap.mmap, header: Header, vertex: Element
) -> Iterator[dict[str, Shaped[np.ndarray, " rows"]]]:
    """Return an iterator over chunks of the binary PLY element ``vertex``: property → column.

    The columns are views of ``data`` in the types of the file.

    Raises:
        FileTruncated: The file ends before the last row.
        BodyMalformed: A list before ``vertex`` has a negative count.
    """
    start = first_row(data, header, vertex)
    order = ">" if header.byte_order == "big" else "<"
    fields = [(name, order + code) for name, code in vertex.types.items()]
    rows = np.frombuffer(data, np.dtype(fields), vertex.count, start)
    return (
        {name: rows[name][chunk_start : chunk_start + CHUNK_ROWS] for name in vertex.types}
        for chunk_start in range(0, vertex.count, CHUNK_ROWS)
    )


def first_row(data: mmap.mmap, header: Header, vertex: Element) -> int:
    """Return the byte offset of the PLY element ``vertex``; raise if the file is too short."""
    start = header.body_offset
    for element in header.elements[: header.elements.index(vertex)]:
        start = _element_end(data, header, element, start)
    _require_length(data, vertex, start)
    return start


def end_of_elements(data: mmap.mmap, header: Header) -> int:
    """Return the byte offset after the last PLY element; raise if the file is too short."""
    start = header.body_offset
    for element in header.elements:
        start = _element_end(data, header, element, start)
    return start


def _element_end(data: mmap.mmap, header: Header, element: Element, start: int) -> int:
    """Return the byte offset after the PLY element ``element`` that begins at byte ``start``."""
    if not element.has_lists:
        _require_length(data, element, start)
        return start + element.count * element.row_bytes
    for row in range(element.count):
        for item in element.properties:
            start += item.size * _length(data, header, item, start, row)
            start += int(item.count_type[1]) if item.count_type else 0
            if start > len(data):
                raise FileTruncated(
                    f"the file ends after {row} of {element.count} rows",
                    where=f"element {quoted(element.name)}",
                    hint="copy or download the file again",
                )
    return start


def _length(data: mmap.mmap, header: Header, item: Property, start: int, row: int) -> int:
    """Return how many values a PLY property has in the row whose data begin at byte ``start``."""
    if item.count_type is None:
        return 1
    count = data[start : start + int(item.count_type[1])]
    is_signed_count = item.count_type[0] == "i"
    length = int.from_bytes(count, header.byte_order, signed=is_signed_count)
    if length < 0:
        where = f"property {quoted(item.name)}, row {row}, byte {start}"
        raise BodyMalformed(
            f"the list has {length} values", where=where, expected="0 values or more"
        )
    return length


def _require_length(data: mmap.mmap, element: Element, start: int) -> None:
    needed_bytes, remaining = element.count * element.row_bytes, len(data) - start
    if needed_bytes > remaining:
        raise FileTruncated(
            f"the {element.count} rows of {element.row_bytes} bytes need {needed_bytes} bytes, "
            f"but {remaining} are left from byte {start} on",
            where=f"element {quoted(element.name)}",
            hint="copy or download the file again",
        )
