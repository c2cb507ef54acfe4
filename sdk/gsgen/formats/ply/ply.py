"""Reads and writes PLY files of splats and of coloured points."""

import mmap

import numpy as np

from gsgen.formats.ply.columns import read_columns
from gsgen.formats.ply.header import Element, Encoding, Header, parse_header
from gsgen.formats.ply.layout import (
    XYZ,
    cloud_colors,
    find_vertex,
    is_splat,
    splat_degree,
    splat_groups,
    splat_names,
)
from gsgen.formats.ply.methods import (
    FILTER_PROPERTY,
    require_still_splats,
    warn_of_unknown_properties,
    with_smoothing_filter,
)
from gsgen.formats.ply.packed import is_packed, read_packed
from gsgen.formats.ply.values import only_drawable, only_finite, require_cloud, require_splats
from gsgen.formats.ply.write import write_ply
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.files import FilePath, map_file
from gsgen.formats.shared.splats import PointCloud, Splats
from gsgen.formats.shared.values import require_rows

__all__ = ["Encoding", "read_ply", "write_ply"]

_DROP_INVALID_HINT = "`gsgen convert --drop-invalid` writes a file without such rows"


def read_ply(path: FilePath, *, drop_invalid: bool = False) -> Splats | PointCloud:
    """Read the splats, or else the coloured points, of the PLY file at ``path``.

    A file with any property of splats (``f_dc_0``, ``opacity``, ``scale_0``, ``rot_0``, …) must
    have all of them. Otherwise it holds points: x, y, z and a colour in bytes or in floats from
    0 to 1. Properties are found by name. Numbers may be text or binary, of either byte order and
    any type; all become float32. A compressed PLY file is unpacked. ``filter_3D`` of
    Mip-Splatting is applied; other properties have no effect, and are named in a FormatWarning.

    Args:
        path: The file.
        drop_invalid: Drop rows that cannot be drawn, which training leaves in some files, and
            warn about them (FormatWarning). A compressed file with such a row is always
            refused: 256 rows share a box.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not a PLY file.
        NotSupported: The file is a variant of PLY that gsgen does not read.
        HeaderMalformed: The header breaks the rules of the format.
        BodyMalformed: A row of text, or a list before the vertices, breaks them.
        PropertyMissing: The file lacks needed properties; the message names them all.
        FileTruncated: The file ends before the last row.
        ValueInvalid: The file has no rows, or a value that cannot be drawn: a NaN, or an
            infinity other than ±inf for opacity and -inf for a scale. With ``drop_invalid``,
            every row holds such a value.
    """
    with map_file(path) as data:
        header = parse_header(data)
        if is_packed(header):
            return read_packed(data, header)
        vertex = find_vertex(header)
        require_still_splats(vertex.types)
        read = _read_splats if is_splat(vertex.types) else _read_cloud
        try:
            content = read(data, header, vertex, path if drop_invalid else None)
        except ValueInvalid as error:
            error.hint = error.hint or ("" if drop_invalid else _DROP_INVALID_HINT)
            raise
        if isinstance(content, Splats):
            warn_of_unknown_properties(
                vertex.types, (*splat_names(content.degree), FILTER_PROPERTY), path
            )
        return content


def _read_splats(
    data: mmap.mmap, header: Header, vertex: Element, dropped_path: FilePath | None
) -> Splats:
    groups: dict[str, tuple[str, ...]] = splat_groups(splat_degree(vertex.types))
    has_filter = FILTER_PROPERTY in vertex.types
    if has_filter:
        groups |= {FILTER_PROPERTY: (FILTER_PROPERTY,)}
    require_rows(vertex.count, "element 'vertex'")
    tables = read_columns(data, header, vertex, groups)
    log_scale, logit_opacity = tables["log_scale"], tables["logit_opacity"].reshape(-1)
    if has_filter:
        log_scale, logit_opacity = with_smoothing_filter(
            log_scale, logit_opacity, tables[FILTER_PROPERTY].reshape(-1)
        )
    splats = Splats(
        position=tables["position"],
        rotation=tables["rotation"],
        log_scale=log_scale,
        logit_opacity=logit_opacity,
        sh=tables["sh"].reshape(vertex.count, -1, 3),
        antialiased=header.antialiased or has_filter,
    )
    if dropped_path is not None:
        return only_drawable(splats, dropped_path)
    require_splats(splats)
    return splats


def _read_cloud(
    data: mmap.mmap, header: Header, vertex: Element, dropped_path: FilePath | None
) -> PointCloud:
    colors = cloud_colors(vertex.types)
    require_rows(vertex.count, "element 'vertex'")
    groups = {"position": XYZ, "color": colors}
    tables = read_columns(data, header, vertex, groups)
    if vertex.types[colors[0]] == "u1":
        tables["color"] /= np.float32(255)
    cloud = PointCloud(position=tables["position"], color=tables["color"])
    if dropped_path is not None:
        cloud = only_finite(cloud, dropped_path)
    require_cloud(cloud, colors)
    return cloud
