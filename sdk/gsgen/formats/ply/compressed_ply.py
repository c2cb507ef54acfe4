"""Writes compressed PLY files: 16 bytes per splat, and a byte for each SH coefficient.

The format is that of PlayCanvas (playcanvas/splat-transform), which ``read_ply`` reads too.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64, Int64

from gsgen.formats.ply import packed_rows as rows
from gsgen.formats.ply.header import ANTIALIASED_COMMENT, up_comment
from gsgen.formats.shared.files import FilePath, naming, replace_file
from gsgen.formats.shared.morton import morton_order
from gsgen.formats.shared.splat_values import require_drawable
from gsgen.formats.shared.splats import DEFAULT_UP, Splats

__all__ = ["compressed_order", "write_compressed_ply"]


def compressed_order(splats: Splats) -> Int64[np.ndarray, " n"]:
    """Return the row order in which ``write_compressed_ply`` writes ``splats``."""
    return morton_order(splats.position)


def write_compressed_ply(path: FilePath, splats: Splats) -> None:
    """Write ``splats`` to ``path`` as a compressed PLY file, in Morton order.

    The error is at most half a step. Steps are fractions of the box of 256 neighbours: 1/2047
    for x and z, 1/1023 for y, the same for log scales (clipped to ±20), 1/255 for colours.
    Opacity is within 1/510, quaternions within 1/1446, harmonics from -4 to 4 within 1/32. The
    file is written completely or not at all.

    Raises:
        ValueInvalid: ``splats`` is empty or holds values that cannot be drawn.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with naming(path):
        require_drawable(splats)
    sorted_splats = _sort_splats(splats)
    higher_count = 3 * (splats.sh.shape[1] - 1)
    with replace_file(path) as file:
        box_records, words = _packed_chunks(sorted_splats)
        file.write(_header(len(box_records), splats, higher_count))
        file.write(box_records.astype("<f4").tobytes())
        file.write(words.astype("<u4").tobytes())
        channels = sorted_splats.sh[:, 1:].swapaxes(1, 2).reshape(len(splats), higher_count)
        file.write(rows.pack_sh(channels).tobytes())


def _sort_splats(splats: Splats) -> Splats:
    order = compressed_order(splats)
    limit = np.float32(rows.LARGEST_LOG_SCALE)
    return replace(
        splats,
        position=splats.position[order],
        rotation=splats.rotation[order],
        log_scale=np.clip(splats.log_scale[order], -limit, limit),
        logit_opacity=splats.logit_opacity[order],
        sh=splats.sh[order],
    )


def _packed_chunks(splats: Splats) -> tuple[Float32[np.ndarray, "c 18"], np.ndarray]:
    """Return the bounding box of each chunk of 256 splats, and four packed words per splat."""
    color = rows.color_of(splats.sh[:, 0])
    parts = (splats.position, splats.log_scale, color)
    part_boxes = [_box(part) for part in parts]
    (position_low, position_high), (scale_low, scale_high), (color_low, color_high) = (
        [np.repeat(end, rows.ROWS_PER_CHUNK, axis=0)[: len(splats)] for end in part_box]
        for part_box in part_boxes
    )
    words = [
        rows.pack_in_box(splats.position, position_low, position_high),
        rows.pack_rotation(splats.rotation),
        rows.pack_in_box(splats.log_scale, scale_low, scale_high),
        rows.pack_color(color, splats.logit_opacity, color_low, color_high),
    ]
    ends = [end for part_box in part_boxes for end in part_box]
    return np.concatenate(ends, axis=1), np.stack(words, axis=1)


def _box(
    values: Float32[np.ndarray, "n 3"] | Float64[np.ndarray, "n 3"],
) -> Sequence[Float32[np.ndarray, "c 3"]]:
    """Return the minimum and the maximum of each chunk of 256 rows."""
    starts = np.arange(0, len(values), rows.ROWS_PER_CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    return low.astype(np.float32), high.astype(np.float32)


def _header(box_count: int, splats: Splats, higher_count: int) -> bytes:
    count = len(splats)
    elements = [
        ("chunk", box_count, "float", rows.BOX_PROPERTIES),
        ("vertex", count, "uint", rows.PACKED_PROPERTIES),
    ]
    if higher_count:
        names = tuple(f"f_rest_{index}" for index in range(higher_count))
        elements.append(("sh", count, "uchar", names))
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [ANTIALIASED_COMMENT] if splats.antialiased else []
    lines += [up_comment(splats.up)] if splats.up != DEFAULT_UP else []
    for name, size, kind, properties in elements:
        lines.append(f"element {name} {size}")
        lines += [f"property {kind} {item}" for item in properties]
    return "\n".join([*lines, "end_header\n"]).encode("ascii")
