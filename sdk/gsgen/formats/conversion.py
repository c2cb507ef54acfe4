"""Convert files of splats, and measure what that cost."""

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

__all__ = ["Conversion", "convert"]


@final
@dataclass(frozen=True, slots=True)
class Conversion:
    """What was converted.

    Attributes:
        source: The file that was read.
        target: The file that was written.
        format: Of the target.
        count: How many splats or points.
        degree: The SH degree before, and as it was written; None for points.
        sizes: Bytes of both files.
        lost: What was dropped, in words.
        differences: How far off the rest is; empty for points.
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
    """Read ``source``, write it to ``target``, read that back and compare.

    Args:
        source: A file that ``open_splats`` reads. Packed rows become splats.
        target: Where to; a file that is there is replaced, a folder that is not is made.
        codec: The format of the target.
        sh_degree: Drop harmonics above this degree.
        drop_invalid: Leave out rows of a PLY file that cannot be drawn, and warn of them.
        write: Writes instead of the codec, say with other options.
        step: Is told what is being done.

    Raises:
        FormatError: A file cannot be read or written; NotSupported if the format is not
            written here, or cannot hold bare points.
    """
    writer = write or codec.write
    if writer is None:
        names = [one.name for one in CODECS if one.write]
        raise NotSupported(
            f"{codec.title} is read but not written here",
            expected=f"one of {', '.join(names)}",
            path=str(target),
        )
    step(f"reading {source}")
    before = Path(source).stat().st_size if Path(source).is_file() else 0
    content = open_splats(source, drop_invalid=drop_invalid)
    if isinstance(content, PointCloud):
        return _points(source, target, codec, content, before)
    splats = splats_of_rows(content) if isinstance(content, PackedRows) else content
    kept = _cut(splats, min(codec.most_degree, 4 if sh_degree is None else sh_degree))
    step(f"writing {target}")
    make_folder(target)
    writer(target, kept)
    step(f"comparing {target} with {source}")
    back = codec.read(target)
    assert isinstance(back, Splats)  # what was written are splats
    order = codec.order(kept) if codec.order else np.arange(len(kept))
    return Conversion(
        source=str(source),
        target=str(target),
        format=codec.name,
        count=len(kept),
        degree=(splats.degree, kept.degree),
        sizes=(before, Path(target).stat().st_size),
        lost=_lost(splats, kept, codec),
        differences=differences(_ordered(kept, order), back),
    )


def _points(
    source: FilePath, target: FilePath, codec: Codec, points: PointCloud, before: int
) -> Conversion:
    if codec.name != "ply":
        raise NotSupported(
            "holds coloured points, which have no size, no rotation and no opacity",
            expected=f"splats, to write {codec.title}",
            hint="write a PLY file; `gsgen export static` makes a generator of them",
            path=str(source),
        )
    make_folder(target)
    write_ply(target, points)
    sizes = before, Path(target).stat().st_size
    return Conversion(
        str(source), str(target), codec.name, len(points), None, sizes, (), ()
    )


def _cut(splats: Splats, degree: int) -> Splats:
    if splats.degree <= degree:
        return splats
    return replace(splats, sh=np.ascontiguousarray(splats.sh[:, : SH_COUNTS[degree]]))


def _ordered(splats: Splats, order: np.ndarray) -> Splats:
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    return replace(splats, **{name: getattr(splats, name)[order] for name in names})


def _lost(splats: Splats, kept: Splats, codec: Codec) -> tuple[str, ...]:
    lost = []
    if kept.degree < splats.degree:
        lost.append(f"harmonics above degree {kept.degree}")
    if splats.antialiased and "antialiased" not in codec.keeps_flags:
        lost.append("that the splats are antialiased (Mip-Splatting)")
    if splats.color_space == "linear" and "color_space" not in codec.keeps_flags:
        lost.append("that the colours are linear")
    if codec.order:
        lost.append("the order of the splats")
    return tuple(lost)
