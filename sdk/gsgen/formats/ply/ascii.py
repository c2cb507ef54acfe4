"""Reads a text PLY file some rows at a time, as one array for each property."""

import mmap
from collections.abc import Iterator
from itertools import islice

import numpy as np
from jaxtyping import Float64

from gsgen.formats.ply.header import Element, Header
from gsgen.formats.shared.errors import BodyMalformed, FileTruncated, quoted

CHUNK_ROWS = 1 << 12
MAX_LINE = 1 << 24
"""The longest line that is read, in bytes; a splat needs about 1000, a list of indices more."""


def ascii_rows(
    data: mmap.mmap, header: Header, vertex: Element
) -> Iterator[dict[str, Float64[np.ndarray, " rows"]]]:
    """Return an iterator over chunks of the PLY element ``vertex``: property → column.

    Numbers are read as doubles, which hold every PLY type exactly.

    Raises:
        FileTruncated: The file is too short for all rows (raised at once), or the rows end
            early (raised by the iterator).
        BodyMalformed: A row holds too many or too few values, or values that are not numbers.
    """
    _require_length(data, header, vertex)
    return _chunks(data, header, vertex)


def _chunks(
    data: mmap.mmap, header: Header, vertex: Element
) -> Iterator[dict[str, Float64[np.ndarray, " rows"]]]:
    lines = _lines(data, header.body_offset)
    for element in _preceding_elements(header, vertex):
        _skip_element(lines, element)
    for start in range(0, vertex.count, CHUNK_ROWS):
        rows = list(islice(lines, min(CHUNK_ROWS, vertex.count - start)))
        if len(rows) < min(CHUNK_ROWS, vertex.count - start):
            raise _truncated_error(vertex, start + len(rows))
        table = _parse_rows(rows, start, len(vertex.properties))
        yield dict(zip(vertex.types, table.T, strict=True))


def _preceding_elements(header: Header, vertex: Element) -> tuple[Element, ...]:
    """Return the PLY elements that come before ``vertex`` in the file and have properties."""
    elements = header.elements[: header.elements.index(vertex)]
    return tuple(element for element in elements if element.properties)


def _require_length(data: mmap.mmap, header: Header, vertex: Element) -> None:
    """Raise FileTruncated if a text PLY file is too short for its number of rows."""
    remaining = len(data) - header.body_offset
    for element in (*_preceding_elements(header, vertex), vertex):
        # A digit and a blank or line end for each value; the last line may lack its end.
        min_bytes = 2 * len(element.properties) * element.count - 1
        if min_bytes > remaining:
            raise FileTruncated(
                f"the {element.count} rows need {min_bytes} bytes or more, but {remaining} are left",
                where=f"element {quoted(element.name)}",
                hint="copy or download the file again",
            )


def _skip_element(lines: Iterator[str], element: Element) -> None:
    """Skip the lines of a PLY element in a text file: one line per row, lists included."""
    rows = sum(1 for _ in islice(lines, element.count))
    if rows < element.count:
        raise _truncated_error(element, rows)


def _truncated_error(element: Element, rows: int) -> FileTruncated:
    return FileTruncated(
        f"the file ends after {rows} of {element.count} rows",
        where=f"element {quoted(element.name)}",
        hint="copy or download the file again",
    )


def _lines(data: mmap.mmap, start: int) -> Iterator[str]:
    """Yield the non-blank lines of a text PLY file from byte ``start`` on."""
    while start < len(data):
        end = data.find(b"\n", start, start + MAX_LINE)
        if end < 0:
            end = len(data)
        if end - start > MAX_LINE:
            raise BodyMalformed(
                f"the line is longer than the limit of {MAX_LINE} bytes", where=f"byte {start}"
            )
        # The parser reports characters beyond ASCII as invalid numbers.
        line = data[start:end].decode("ascii", "replace").strip()
        if line:
            yield line
        start = end + 1


def count_lines(data: mmap.mmap, start: int) -> int:
    """Return the number of non-blank lines of a text PLY file from byte ``start`` on."""
    return sum(1 for _ in _lines(data, start))


def _parse_rows(rows: list[str], first: int, width: int) -> Float64[np.ndarray, "rows width"]:
    """Parse lines of a text PLY file as numbers; ``first`` is the number of the first row."""
    try:
        table = np.loadtxt(rows, dtype=np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise _first_row_error(rows, first, width, str(error)) from error
    if table.shape != (len(rows), width):
        raise _first_row_error(rows, first, width, f"{table.shape[1]} values per row")
    return table


def _first_row_error(rows: list[str], first: int, width: int, problem: str) -> BodyMalformed:
    """Return the error of the first invalid row of a text PLY file, or a general error."""
    for number, row in enumerate(rows, start=first):
        values = row.split()
        where = f"element 'vertex', row {number}"
        if len(values) != width:
            expected = f"{width}, one for each property"
            return BodyMalformed(f"{len(values)} values", where=where, expected=expected)
        for value in values:
            if not _is_number(value):
                return BodyMalformed(quoted(value), where=where, expected="a number")
    where = f"element 'vertex', rows {first} to {first + len(rows) - 1}"
    return BodyMalformed(problem, where=where, expected=f"{width} numbers in each")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
