"""Lists the declared parts of a PLY file that its reader did not use."""

__all__ = ["unused_parts"]

import mmap
from collections.abc import Collection, Mapping

from gsgen.formats.ply.ascii import ascii_rows, count_lines
from gsgen.formats.ply.binary import binary_rows, end_of_elements
from gsgen.formats.ply.header import Element, Header
from gsgen.formats.shared.errors import join_names

_NORMAL_PROPERTIES = ("nx", "ny", "nz")


def unused_parts(data: mmap.mmap, header: Header, used: Mapping[str, Collection[str]]) -> list[str]:
    """Return the names of properties, elements, comments and rows that were not used.

    Normals that are zero, as 3DGS training writes them, say nothing and are not listed.

    Args:
        data: The file.
        header: Its header.
        used: Element → its properties that were used.
    """
    parts = []
    for element in header.elements:
        properties = used.get(element.name)
        if properties is None:
            parts += [f"element {element.name} ({element.count:,} rows)"] if element.count else []
            continue
        names = [name for name in element.types if name not in properties]
        if set(_NORMAL_PROPERTIES) & set(names) and not _has_normals(data, header, element):
            names = [name for name in names if name not in _NORMAL_PROPERTIES]
        if names:
            noun = "property" if len(names) == 1 else "properties"
            parts.append(f"{noun} {join_names(names)}")
    parts += [f"comment {comment!r}" for comment in header.unknown_comments]
    return parts + _rows_after_the_end(data, header)


def _has_normals(data: mmap.mmap, header: Header, vertex: Element) -> bool:
    """Return whether the first rows have a normal other than 0, 0, 0."""
    read = ascii_rows if header.encoding == "ascii" else binary_rows
    chunk = next(iter(read(data, header, vertex)), {})
    return any(chunk[name].any() for name in _NORMAL_PROPERTIES if name in chunk)


def _rows_after_the_end(data: mmap.mmap, header: Header) -> list[str]:
    """Return a description of what follows the last declared row; nothing if nothing does."""
    last = header.elements[-1]
    if any(element.has_lists for element in header.elements):
        return []  # their rows would have to be read one by one
    if header.encoding == "ascii":
        declared_count = sum(entry.count for entry in header.elements if entry.properties)
        extra_count = count_lines(data, header.body_offset) - declared_count
        extra_text = f"{extra_count:,} lines"
    else:
        extra_bytes = len(data) - end_of_elements(data, header)
        extra_count = extra_bytes // last.row_bytes if last.row_bytes else 0
        extra_text = f"{extra_bytes:,} bytes" if extra_bytes else ""
    if extra_count > 0:
        return [
            f"{extra_text} after the {last.count:,} rows of element {last.name} that the header "
            f"declares, room for {extra_count:,} more rows"
        ]
    return [f"{extra_text} after the last row"] if header.encoding != "ascii" and extra_text else []
