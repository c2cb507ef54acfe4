"""Converts files of splats to another format and measures the loss."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from gsgen.formats.codecs import CODECS, Codec
from gsgen.formats.loss import Difference, differences
from gsgen.formats.open import open_splats
from gsgen.formats.packed import splats_of_rows
from gsgen.formats.ply.ply import write_ply
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.files import FilePath, make_folder
from gsgen.formats.shared.splats import SH_COUNTS, PackedRows, PointCloud, Splats
from gsgen.formats.sog.sog import written_bytes

__all__ = ["Conversion", "convert"]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """The paths, formats, number of splats and losses of a converted file.

    Attributes:
        source: The file that was read.
        target: The file that was written.
        format: The name of the target's format.
        count: The number of splats or points.
        degree: The SH degrees of the source and the target; None for points.
        sizes: The sizes of both files, in bytes.
        lost: The dropped properties, in words.
        differences: The error of each kept quantity; empty for points.
    """

    source: str
    target: str
    format: str
    count: int
    degree: tuple[int, int] | None
    sizes: tuple[int, int]
    lost: tuple[str, ...]
    differences: tuple[Difference, ...]


def convert(
    source: FilePath,
    target: FilePath,
    codec: Codec,
    *,
    sh_degree: int | None = None,
    drop_invalid: bool = False,
    write: Callable[[FilePath, Splats], None] | None = None,
    step: Callable[[str], None] = lambda words: None,
) -> Conversion:
    """Convert a splat file to another format, then compare the written file with the source.

    Args:
        source: A file that ``open_splats`` reads. Packed rows become splats.
        target: The output path. An existing file is replaced, a missing folder is created.
        codec: The format of the target.
        sh_degree: Drop harmonics above this degree.
        drop_invalid: Drop rows of a PLY file that cannot be drawn, and warn about them.
        write: Replaces the writer of the codec, for example to set options.
        step: Called with a description of each step.

    Raises:
        FormatError: A file cannot be read or written; NotSupported if gsgen does not write
            the format, or the format cannot hold points.
    """
    writer = write or codec.write
    if writer is None:
        names = [entry.name for entry in CODECS if entry.write]
        raise NotSupported(
            f"{codec.title} is a format that gsgen only reads",
            expected=f"one of {', '.join(names)}",
            path=str(target),
        )
    step(f"reading {source}")
    before = written_bytes(source) if Path(source).is_file() else 0
    content = open_splats(source, drop_invalid=drop_invalid)
    if isinstance(content, PointCloud):
        return _convert_points(source, target, codec, content, before)
    splats = splats_of_rows(content) if isinstance(content, PackedRows) else content
    reduced = _with_degree(splats, min(codec.most_degree, 4 if sh_degree is None else sh_degree))
    step(f"writing {target}")
    make_folder(target)
    writer(target, reduced)
    step(f"comparing {target} with {source}")
    back = codec.read(target)
    assert isinstance(back, Splats)  # every writer writes splats
    order = codec.order(reduced) if codec.order else np.arange(len(reduced))
    return Conversion(
        source=str(source),
        target=str(target),
        format=codec.name,
        count=len(reduced),
        degree=(splats.degree, reduced.degree),
        sizes=(before, written_bytes(target)),
        lost=_losses(splats, reduced, codec),
        differences=differences(_ordered(reduced, order), back),
    )


def _convert_points(
    source: FilePath, target: FilePath, codec: Codec, points: PointCloud, before: int
) -> Conversion:
    if codec.name != "ply":
        raise NotSupported(
            "the file holds coloured points, which have no size, rotation or opacity",
            expected=f"splats, which {codec.title} needs",
            hint="write a PLY file; `gsgen export static` makes a generator of them",
            path=str(source),
        )
    make_folder(target)
    write_ply(target, points)
    sizes = before, Path(target).stat().st_size
    return Conversion(
        source=str(source),
        target=str(target),
        format=codec.name,
        count=len(points),
        degree=None,
        sizes=sizes,
        lost=(),
        differences=(),
    )


def _with_degree(splats: Splats, degree: int) -> Splats:
    if splats.degree <= degree:
        return splats
    return replace(splats, sh=np.ascontiguousarray(splats.sh[:, : SH_COUNTS[degree]]))


def _ordered(splats: Splats, order: np.ndarray) -> Splats:
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    return replace(splats, **{name: getattr(splats, name)[order] for name in names})


def _losses(splats: Splats, reduced: Splats, codec: Codec) -> tuple[str, ...]:
    losses = []
    if reduced.degree < splats.degree:
        losses.append(f"harmonics above degree {reduced.degree}")
    if splats.antialiased and "antialiased" not in codec.keeps_flags:
        losses.append("the flag that the splats are antialiased (Mip-Splatting)")
    if splats.color_space == "linear" and "color_space" not in codec.keeps_flags:
        losses.append("the flag that the colours are linear")
    if codec.order:
        losses.append("the order of the splats")
    return tuple(losses)
