"""Converts splat files to another format, and measures the loss."""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, final

import numpy as np

from gsgen.formats.codecs import CODECS, Codec, Content
from gsgen.formats.loss import Difference, differences
from gsgen.formats.open import open_splats
from gsgen.formats.packed import splats_of_rows
from gsgen.formats.parts import PART_WRITERS, PlyParts, open_parts, with_degree
from gsgen.formats.ply.chunks import PlyTable
from gsgen.formats.ply.ply import write_ply
from gsgen.formats.shared.errors import NotSupported, ValueInvalid
from gsgen.formats.shared.files import FilePath, make_folder
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.origins import Origin, join_splats, near_zero, origin_text
from gsgen.formats.shared.splats import (
    DEFAULT_UP,
    SPLAT_ARRAY_NAMES,
    PackedRows,
    PointCloud,
    Splats,
)
from gsgen.formats.sog.meta import is_streamed_meta
from gsgen.formats.sog.sog import written_bytes
from gsgen.formats.tileset_paths import names_tileset

__all__ = ["Conversion", "convert"]


MAX_COMPARED_VALUES: Final = 1 << 29
"""The most bytes of splats in memory for which the written file is read back and compared.

Larger PLY files are converted in parts, where the target and the edits allow it."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """The result of converting a splat file, with the measured losses.

    Attributes:
        source: The files that were read.
        target: The file that was written.
        format: The name of the target's format.
        count: The number of splats or points that were written.
        degree: The SH degrees of the source and the target; None for points.
        sizes: The sizes of the sources together and of the target, in bytes. That of the sources
            is 0 if one of them is a tileset or an address.
        lost: The dropped properties, in words.
        differences: The error of each kept quantity; empty for points.
        compared: Whether the written file was compared; not above ``MAX_COMPARED_VALUES``.
    """

    source: str
    target: str
    format: str
    count: int
    degree: tuple[int, int] | None
    sizes: tuple[int, int]
    lost: tuple[str, ...]
    differences: tuple[Difference, ...]
    compared: bool = True


def convert(
    source: FilePath | Sequence[FilePath],
    target: FilePath,
    codec: Codec,
    *,
    sh_degree: int | None = None,
    drop_invalid: bool = False,
    origin: Origin | None = None,
    edits: Sequence[Callable[[Splats], Splats]] = (),
    read: Callable[[FilePath], Content] | None = None,
    read_back: Callable[[FilePath], Content] | None = None,
    write: Callable[[FilePath, Splats], None] | None = None,
    step: Callable[[str], None] = lambda words: None,
) -> Conversion:
    """Convert splat file ``source`` to ``target``, and compare the written splats with the source.

    Args:
        source: A file that ``open_splats`` reads, or several, which are merged in this order.
            Packed rows become splats.
        target: The output path. An existing file is replaced, a missing folder is created.
        codec: The format of the target.
        sh_degree: Drop harmonics above this degree.
        drop_invalid: Drop rows that cannot be drawn, and warn about them.
        origin: The point of the sources that positions are relative to; None for one that float32
            needs. Formats without one then store positions relative to it.
        edits: Applied to the merged splats, in this order.
        read: Replaces the reader of the sources, for example to set options.
        read_back: Replaces the reader of the target.
        write: Replaces the writer of the codec, for example to set options.
        step: Called with a description of each step.

    Raises:
        FormatError: A file cannot be read or written; NotSupported if gsgen does not write
            the format, or the format cannot hold points; ValueInvalid if the sources have
            different flags, or no splat is left.
    """
    writer = write or _writer_for_target(codec, target)
    sources = [source] if isinstance(source, str | os.PathLike) else list(source)
    most_degree = min(codec.most_degree, 4 if sh_degree is None else sh_degree)
    can_convert_in_parts = not (read or write or drop_invalid or origin or is_streamed_meta(target))
    if can_convert_in_parts and len(sources) == 1 and codec.name in PART_WRITERS:
        large_parts = open_parts(
            sources[0], edits, most_degree=most_degree, min_bytes=MAX_COMPARED_VALUES
        )
        if large_parts is not None:
            return _convert_parts(large_parts, target, codec, step)
    read = read or partial(open_splats, drop_invalid=drop_invalid, origin=origin)
    parts: list[Splats] = []
    for path in sources:
        step(f"reading {path}")
        content = read(path)
        if isinstance(content, PointCloud):
            if len(sources) > 1 or edits:
                raise _point_cloud_error(path, "splats, which merging and edits need")
            return _convert_points(path, target, codec, content)
        parts.append(splats_of_rows(content) if isinstance(content, PackedRows) else content)
    splats = merge_splats(parts)
    del parts
    for index, edit in enumerate(edits):
        step(f"edit {index + 1} of {len(edits)}")
        splats = edit(splats)
    if origin is None and "origin" not in codec.keeps_flags:
        splats = near_zero(splats)
    reduced = with_degree(splats, most_degree)
    degree = (splats.degree, reduced.degree)
    lost_features = _lost_features(degree, codec, splats, splats.origin)
    del splats
    step(f"writing {target}")
    make_folder(target)
    writer(target, reduced)
    are_splats_compared = (
        sum(getattr(reduced, name).nbytes for name in SPLAT_ARRAY_NAMES) <= MAX_COMPARED_VALUES
    )
    entries: tuple[Difference, ...] = ()
    if are_splats_compared:
        step(f"comparing {target} with the source")
        entries = _compare_written_splats(reduced, target, codec, read_back or codec.read)
    return Conversion(
        source=", ".join(map(str, sources)),
        target=str(target),
        format=codec.name,
        count=len(reduced),
        degree=degree,
        sizes=(_total_bytes(sources), written_bytes(target)),
        lost=lost_features,
        differences=entries,
        compared=are_splats_compared,
    )


def _compare_written_splats(
    splats: Splats, target: FilePath, codec: Codec, read: Callable[[FilePath], Content]
) -> tuple[Difference, ...]:
    """Return the differences between splats and the file that they were written to."""
    with warnings.catch_warnings():
        # The reader of the source has named the origin.
        warnings.filterwarnings("ignore", ".*positions are relative to", FormatWarning)
        read_back_splats = read(target)
    assert isinstance(read_back_splats, Splats)  # every writer writes splats
    if "origin" not in codec.keeps_flags:
        read_back_splats = replace(read_back_splats, origin=splats.origin)
    order = codec.order(splats) if codec.order else np.arange(len(splats))
    return differences(splats[order], read_back_splats)


def _convert_parts(
    parts: PlyParts, target: FilePath, codec: Codec, step: Callable[[str], None]
) -> Conversion:
    """Convert a large PLY file in parts: read once to count the edited splats, again to write."""
    step(f"reading {parts.path}")
    count, max_coordinate = parts.measure_extent()
    step(f"writing {target}")
    make_folder(target)
    PART_WRITERS[codec.name](target, parts, count, max_coordinate)
    degrees = (parts.table.degree, parts.degree)
    return Conversion(
        source=str(parts.path),
        target=str(target),
        format=codec.name,
        count=count,
        degree=degrees,
        sizes=(written_bytes(parts.path), written_bytes(target)),
        lost=_lost_features(degrees, codec, parts.table, next(iter(parts)).origin),
        differences=(),
        compared=False,
    )


def _writer_for_target(codec: Codec, target: FilePath) -> Callable[[FilePath, Splats], None]:
    if codec.write is None:
        names = [entry.name for entry in CODECS if entry.write]
        raise NotSupported(
            f"gsgen reads {codec.title}, but cannot write this format",
            expected=f"one of {', '.join(names)}",
            path=str(target),
        )
    return codec.write


def merge_splats(parts: Sequence[Splats]) -> Splats:
    """Concatenate sets of splats; SH coefficients that a set lacks are zero.

    Raises:
        ValueInvalid: The parts differ in antialiasing, colour space or upward direction.
    """
    for flag in ("antialiased", "color_space", "up"):
        values = {getattr(part, flag) for part in parts}
        if len(values) > 1:
            raise ValueInvalid(
                f"the value differs between the sources: {' and '.join(sorted(map(str, values)))}",
                where=flag,
                expected="the same for all",
                hint="such splats cannot be drawn right in one file",
            )
    return join_splats(parts)


def _total_bytes(paths: Sequence[FilePath]) -> int:
    are_sizes_known = all(Path(path).is_file() and not names_tileset(path) for path in paths)
    return sum(map(written_bytes, paths)) if are_sizes_known else 0


def _point_cloud_error(path: FilePath, expected: str) -> NotSupported:
    return NotSupported(
        "the file holds coloured points, which have no size, rotation or opacity",
        expected=expected,
        hint="write a PLY file; `gsgen export static` makes a generator of them",
        path=str(path),
    )


def _convert_points(
    source: FilePath, target: FilePath, codec: Codec, points: PointCloud
) -> Conversion:
    if codec.name != "ply":
        raise _point_cloud_error(source, f"splats, which {codec.title} needs")
    size = _total_bytes([source])
    make_folder(target)
    write_ply(target, points)
    return Conversion(
        source=str(source),
        target=str(target),
        format=codec.name,
        count=len(points),
        degree=None,
        sizes=(size, written_bytes(target)),
        lost=(),
        differences=(),
    )


def _lost_features(
    degrees: tuple[int, int], codec: Codec, source: Splats | PlyTable, origin: Origin
) -> tuple[str, ...]:
    lost_feature_names = []
    if degrees[1] < degrees[0]:
        lost_feature_names.append(f"harmonics above degree {degrees[1]}")
    if source.antialiased and "antialiased" not in codec.keeps_flags:
        lost_feature_names.append("the flag that the splats are antialiased (Mip-Splatting)")
    if source.color_space == "linear" and "color_space" not in codec.keeps_flags:
        lost_feature_names.append("the flag that the colours are linear")
    if source.up != DEFAULT_UP and "up" not in codec.keeps_flags:
        direction = ", ".join(f"{value:g}" for value in source.up)
        lost_feature_names.append(f"the upward direction ({direction})")
    if any(origin) and "origin" not in codec.keeps_flags:
        lost_feature_names.append(
            f"the origin {origin_text(origin)}, which positions are relative to"
        )
    if codec.order:
        lost_feature_names.append("the order of the splats")
    return tuple(lost_feature_names)
