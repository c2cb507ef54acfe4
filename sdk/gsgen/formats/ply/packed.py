"""Reads compressed PLY files: packed words relative to bounding boxes of 256 splats."""

import mmap
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Shaped

from gsgen.formats.ply import packed_rows as rows
from gsgen.formats.ply.ascii import ascii_rows
from gsgen.formats.ply.binary import binary_rows
from gsgen.formats.ply.header import Element, Header
from gsgen.formats.shared.errors import HeaderMalformed, PropertyMissing, join_names
from gsgen.formats.shared.splats import DEFAULT_UP, SH_COUNTS, Splats
from gsgen.formats.shared.values import require_rows

_BOX_WITHOUT_COLORS = rows.BOX_PROPERTIES[:12]
_HIGHER_SH_VALUE_COUNTS = tuple(3 * (count - 1) for count in SH_COUNTS[1:])


def is_packed(header: Header) -> bool:
    """Return whether a PLY file is a compressed one, whose vertices are packed words."""
    vertex = header.find("vertex")
    return vertex is not None and rows.PACKED_PROPERTIES[0] in vertex.types


def read_packed(data: mmap.mmap, header: Header) -> tuple[Splats, dict[str, tuple[str, ...]]]:
    """Return the splats of a compressed PLY file, and the used properties of each element."""
    vertex, chunk_element = _require_element(header, "vertex"), _require_element(header, "chunk")
    require_rows(vertex.count, "element 'vertex'")
    needed = -(-vertex.count // rows.ROWS_PER_CHUNK)
    if chunk_element.count < needed:
        raise HeaderMalformed(
            f"the element has {chunk_element.count} rows",
            where="element 'chunk'",
            expected=f"{needed} or more",
        )
    words = _columns(data, header, vertex, rows.PACKED_PROPERTIES, "u4")
    chunk_boxes = _read_boxes(data, header, chunk_element, vertex.count)
    low_color = (
        np.zeros((1, 3), np.float32) if chunk_boxes.shape[1] == 12 else chunk_boxes[:, 12:15]
    )
    high_color = (
        np.ones((1, 3), np.float32) if chunk_boxes.shape[1] == 12 else chunk_boxes[:, 15:18]
    )
    constant, logit_opacity = rows.unpack_color(words[3], low_color, high_color)
    splats = Splats(
        position=rows.unpack_in_box(words[0], chunk_boxes[:, 0:3], chunk_boxes[:, 3:6]),
        rotation=rows.unpack_rotation(words[1]),
        log_scale=rows.unpack_in_box(words[2], chunk_boxes[:, 6:9], chunk_boxes[:, 9:12]),
        logit_opacity=logit_opacity,
        sh=np.concatenate(
            [constant[:, None], _read_higher_sh_bands(data, header, vertex.count)], axis=1
        ),
        antialiased=header.antialiased,
        up=header.up or DEFAULT_UP,
    )
    used = {
        element.name: tuple(element.types)
        for element in (chunk_element, header.find("sh"))
        if element
    }
    return splats, used | {"vertex": rows.PACKED_PROPERTIES}


def _read_boxes(
    data: mmap.mmap, header: Header, element: Element, count: int
) -> Float32[np.ndarray, "n b"]:
    """Return the bounds of each splat's chunk in a compressed PLY; old files bound no colours.

    Colour bounds came in 2024.
    """
    names = rows.BOX_PROPERTIES if rows.BOX_PROPERTIES[-1] in element.types else _BOX_WITHOUT_COLORS
    columns = _columns(data, header, element, names, "f4")
    return np.repeat(np.stack(columns, axis=1), rows.ROWS_PER_CHUNK, axis=0)[:count]


def _read_higher_sh_bands(
    data: mmap.mmap, header: Header, count: int
) -> Float32[np.ndarray, "n k 3"]:
    element = header.find("sh")
    if element is None:
        return np.empty((count, 0, 3), np.float32)
    if element.count != count:
        raise HeaderMalformed(
            f"the element has {element.count} rows",
            where="element 'sh'",
            expected=f"{count}, as vertex has",
        )
    value_count = len(element.properties)
    if value_count == 0:  # gsplat declares the element at degree 0, too
        return np.empty((count, 0, 3), np.float32)
    if value_count not in _HIGHER_SH_VALUE_COUNTS:
        raise PropertyMissing(
            f"the element has {value_count} properties",
            where="element 'sh'",
            expected="9, 24, 45 or 72 of f_rest",
        )
    names = [f"f_rest_{index}" for index in range(value_count)]
    columns = _columns(data, header, element, names, "u1")
    channels = rows.unpack_sh(np.stack(columns, axis=1)).reshape(count, 3, value_count // 3)
    return np.ascontiguousarray(channels.swapaxes(1, 2))


def _require_element(header: Header, name: str) -> Element:
    element = header.find(name)
    if element is None:
        raise PropertyMissing(
            f"the PLY file has no element {name!r}",
            expected="elements chunk and vertex of a compressed PLY",
        )
    return element


def _columns(
    data: mmap.mmap, header: Header, element: Element, names: Sequence[str], code: str
) -> list[Shaped[np.ndarray, " n"]]:
    """Return PLY columns ``names``; raise if one is missing or not of the scalar type ``code``."""
    wrongly_typed_names = [name for name in names if element.types.get(name) != code]
    if wrongly_typed_names or element.has_lists:
        kinds = {"u4": "uint", "f4": "float", "u1": "uchar"}
        raise PropertyMissing(
            f"the properties {join_names(wrongly_typed_names)} are missing or of another type; found {join_names(list(element.types))}",
            where=f"element {element.name!r}",
            expected=f"{join_names(list(names), limit=100)} of type {kinds[code]}, no lists",
        )
    read = ascii_rows if header.encoding == "ascii" else binary_rows
    parts = list(read(data, header, element))
    with np.errstate(over="ignore", invalid="ignore"):
        return [np.concatenate([part[name] for part in parts]).astype(code) for name in names]
