"""Reads and writes PLY files of splats and of coloured points."""

import mmap
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from jaxtyping import Float, Float32

from gsgen.formats.ply.columns import read_columns
from gsgen.formats.ply.header import COLOR_SPACE, Element, Encoding, Header, parse_header
from gsgen.formats.ply.layout import (
    XYZ,
    cloud_colors,
    find_vertex,
    is_splat,
    splat_colors,
    splat_degree,
    splat_groups,
)
from gsgen.formats.ply.methods import FILTER_PROPERTY, require_still_splats, with_smoothing_filter
from gsgen.formats.ply.packed import is_packed, read_packed
from gsgen.formats.ply.unused import unused_parts
from gsgen.formats.ply.values import VERTEX, only_finite, require_cloud, splat_labels
from gsgen.formats.ply.write import write_ply
from gsgen.formats.shared.errors import NotSupported, ValueInvalid, join_names
from gsgen.formats.shared.files import FilePath, map_file
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.origins import Origin, is_printed_float32, relative_positions
from gsgen.formats.shared.quantities import SH_C0
from gsgen.formats.shared.splat_values import DROP_HINT, drawable
from gsgen.formats.shared.splats import DEFAULT_UP, PointCloud, Splats
from gsgen.formats.shared.values import require_colors, require_rows

__all__ = ["Encoding", "declared_color_space", "read_ply", "write_ply"]


_SHORT_TYPES = ("i2", "u2")


@final
@dataclass(frozen=True, slots=True)
class _PlyContent:
    """The content of a PLY file, and for each element the properties that were used."""

    content: Splats | PointCloud
    used: dict[str, tuple[str, ...]]


def read_ply(path: FilePath, *, drop_invalid: bool = False) -> Splats | PointCloud:
    """Read the splats, or else the coloured points, of the PLY file at ``path``.

    A file with any property of splats (``f_dc_0``, ``opacity``, ``scale_0``, ``rot_0``, …) must
    have all of them; in place of ``f_dc``, the colours may be ``red``, ``green`` and ``blue``.
    Otherwise it holds points: x, y, z and a colour in bytes or in floats from 0 to 1. Properties
    are found by name. Numbers may be text or binary, of either byte order and any type; all
    become float32. A compressed PLY file is unpacked. ``filter_3D`` of Mip-Splatting is applied,
    comments on the vertical axis set ``up``, and the element ``color_space`` of SHARP sets the
    colour space. Declared parts without effect are named in a FormatWarning.

    Args:
        path: The file.
        drop_invalid: Drop rows that cannot be drawn, which training leaves in some files, and
            warn about them (FormatWarning).

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not a PLY file.
        NotSupported: The file is a variant of PLY that gsgen does not read.
        HeaderMalformed: The header breaks the rules of the format.
        BodyMalformed: A row of text, or a list before the vertices, breaks them.
        PropertyMissing: The file lacks needed properties; the message names them all.
        FileTruncated: The file ends before the last row.
        ValueInvalid: The file has no rows, or a row that cannot be drawn: a NaN, an infinity
            other than ±inf for opacity and -inf for a scale, or a quaternion of zeros. With
            ``drop_invalid``, every row is of this kind.
    """
    with map_file(path) as data:
        header = parse_header(data)
        if is_packed(header):
            splats, used = read_packed(data, header)
            content = _PlyContent(drawable(splats, path, drop_invalid=drop_invalid), used)
        else:
            vertex = find_vertex(header)
            require_still_splats(vertex.types)
            read = _read_splats if is_splat(vertex.types) else _read_cloud
            content = read(data, header, vertex, path, drop_invalid=drop_invalid)
        warn_unused(path, unused_parts(data, header, content.used))
        return content.content


def _read_splats(
    data: mmap.mmap, header: Header, vertex: Element, path: FilePath, *, drop_invalid: bool
) -> _PlyContent:
    degree, colors = splat_degree(vertex.types), splat_colors(vertex.types)
    groups: dict[str, tuple[str, ...]] = splat_groups(degree)
    if colors:
        groups["sh"] = (*colors, *groups["sh"][3:])
    has_filter = FILTER_PROPERTY in vertex.types
    if has_filter:
        groups |= {FILTER_PROPERTY: (FILTER_PROPERTY,)}
    names = tuple(name for group in groups.values() for name in group)
    require_rows(vertex.count, VERTEX)
    tables = read_columns(data, header, vertex, groups, _wide_groups(header, vertex))
    position, origin, rounding = _near_positions(tables["position"], vertex)
    log_scale, logit_opacity = tables["log_scale"], tables["logit_opacity"].reshape(-1)
    if has_filter:
        log_scale, logit_opacity = with_smoothing_filter(
            log_scale, logit_opacity, tables[FILTER_PROPERTY].reshape(-1)
        )
    if colors:
        tables["sh"][:, :3] = _constant_term(tables["sh"][:, :3], vertex, colors)
    space, used_space = declared_color_space(data, header)
    splats = Splats(
        position=position,
        rotation=tables["rotation"],
        log_scale=log_scale,
        logit_opacity=logit_opacity,
        sh=tables["sh"].reshape(vertex.count, -1, 3),
        antialiased=header.antialiased or has_filter,
        color_space=space,
        up=header.up or DEFAULT_UP,
        origin=origin,
        rounding=rounding,
    )
    labels = splat_labels(splats)
    try:
        splats = drawable(splats, path, drop_invalid=drop_invalid, labels=labels, where=VERTEX)
    except ValueInvalid as error:
        short_properties = [name for name in names if vertex.types[name] in _SHORT_TYPES]
        if short_properties:
            error.hint = (
                f"PLY has no type for half floats: write {join_names(short_properties)} as float"
            )
        raise
    return _PlyContent(splats, {vertex.name: names, **used_space})


def _wide_groups(header: Header, vertex: Element) -> tuple[str, ...]:
    """Return the arrays that are read as float64: positions of text, doubles or integers."""
    is_float32 = {vertex.types[axis] for axis in XYZ} <= {"f4"}
    return () if is_float32 and header.encoding != "ascii" else ("position",)


def _near_positions(
    position: Float[np.ndarray, "n 3"], vertex: Element
) -> tuple[Float32[np.ndarray, "n 3"], Origin, float]:
    """Return positions as float32, their origin, and the largest error.

    Text that declares ``float`` is float32, unless its numbers need an origin.
    """
    is_float32 = {vertex.types[axis] for axis in XYZ} == {"f4"}
    if is_float32 and is_printed_float32(position):
        position = position.astype(np.float32)
    position32, origin, rounding = relative_positions(position)
    return position32, origin, 0.0 if is_float32 and not any(origin) else rounding


def _constant_term(
    color: Float32[np.ndarray, "n 3"], vertex: Element, colors: tuple[str, ...]
) -> Float32[np.ndarray, "n 3"]:
    """Convert the colours of splats to SH coefficients of degree 0."""
    if vertex.types[colors[0]] == "u1":
        color = color / np.float32(255)
    require_colors(color, [f"property {name}" for name in colors])
    return np.asarray((color - np.float32(0.5)) / np.float32(SH_C0), np.float32)


def declared_color_space(
    data: mmap.mmap, header: Header
) -> tuple[Literal["srgb", "linear"], dict[str, tuple[str, ...]]]:
    """Return the colour space that a PLY file declares, and the property that declares it."""
    element = header.find(COLOR_SPACE)
    if element is None or element.count != 1 or COLOR_SPACE not in element.types:
        return "srgb", {}
    table = read_columns(data, header, element, {COLOR_SPACE: (COLOR_SPACE,)})
    value = float(table[COLOR_SPACE][0, 0])
    if value not in (0, 1):
        raise NotSupported(
            f"the colour space is {value:g}",
            where=f"element {COLOR_SPACE!r}",
            expected="0 (sRGB) or 1 (linear)",
        )
    return ("linear" if value else "srgb"), {COLOR_SPACE: (COLOR_SPACE,)}


def _read_cloud(
    data: mmap.mmap, header: Header, vertex: Element, path: FilePath, *, drop_invalid: bool
) -> _PlyContent:
    colors = cloud_colors(vertex.types)
    require_rows(vertex.count, VERTEX)
    groups = {"position": XYZ, "color": colors}
    tables = read_columns(data, header, vertex, groups, _wide_groups(header, vertex))
    position, origin, rounding = _near_positions(tables["position"], vertex)
    if vertex.types[colors[0]] == "u1":
        tables["color"] /= np.float32(255)
    cloud = PointCloud(position, tables["color"], origin, rounding)
    try:
        if drop_invalid:
            cloud = only_finite(cloud, path)
        require_cloud(cloud, colors)
    except ValueInvalid as error:
        error.hint = error.hint or ("" if drop_invalid else DROP_HINT)
        raise
    return _PlyContent(cloud, {vertex.name: (*XYZ, *colors)})
