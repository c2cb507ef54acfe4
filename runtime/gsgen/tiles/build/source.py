"""Divides scene files into chunks of splats, which build tasks read one at a time."""

__all__ = [
    "BLOCK_ROWS",
    "CHUNK_BYTES",
    "Chunk",
    "SceneFile",
    "chunks_of",
    "open_scenes",
    "read_chunk",
    "row_dtype",
]

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.formats import FormatError, FormatWarning, PackedRows, PointCloud, Splats, splats_of_rows
from gsgen.formats.inputs import STANDARD_INPUT, resolve_input
from gsgen.formats.ply.chunks import PlyTable, ply_table, read_ply_rows
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.files import naming
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.origins import Origin, middle_origin, origin_text, relative_to
from gsgen.formats.shared.splats import DEFAULT_UP, MAX_FLOAT32_OFFSET, NO_ORIGIN, SH_COUNTS
from gsgen.formats.shared.suspicions import SAMPLED_ROWS, warn_of_suspicions
from gsgen.formats.tileset_paths import names_tileset
from gsgen.tiles.loading.leaves import open_splats

CHUNK_BYTES: Final = 64 << 20
"""Bytes of a PLY file that one task reads."""

BLOCK_ROWS: Final = 1 << 14
"""Chunks begin at multiples of so many rows of a file."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFile:
    """A splat file of a scene: its path, number of splats and layout.

    Attributes:
        path: Where it is.
        count: Its splats, those that cannot be drawn included.
        degree: Their SH degree, at most 3.
        size: Bytes.
        modified: When it was last written, in nanoseconds.
        table: Where a PLY file has its rows; None for a file that is decoded as a whole.
        antialiased: Whether the splats are trained with the filter of Mip-Splatting.
        color_space: Of their colours.
        up: The declared upward direction.
        origin: The point that positions are relative to.
    """

    path: str
    count: int
    degree: int
    size: int
    modified: int
    table: PlyTable | None
    antialiased: bool = False
    color_space: Literal["srgb", "linear"] = "srgb"
    up: tuple[float, float, float] = DEFAULT_UP
    origin: tuple[float, float, float] = NO_ORIGIN


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """A range of the splats in a scene file, which one build task reads.

    Attributes:
        index: Of the chunk, in the order of the scenes.
        file: The file.
        first: Row of the file to begin with.
        count: Rows.
        source: Index of the first row among the rows of all files.
    """

    index: int
    file: SceneFile
    first: int
    count: int
    source: int


def open_scenes(paths: Sequence[Path], origin: Origin | None = None) -> list[SceneFile]:
    """Open scene files and return their splat counts, SH degrees and layouts.

    All get one origin: the given one, or else the middle of those that their positions need.

    Raises:
        InputUnreadable: A file is missing, damaged or holds something else than splats.
        ConfigInvalid: Files disagree on the colour space or on antialiasing.
    """
    files = [_open_scene_file(path) for path in paths]
    first = files[0]
    for file in files:
        for name in ("color_space", "antialiased", "up"):
            actual, expected = getattr(file, name), getattr(first, name)
            if actual != expected:
                raise ConfigInvalid(
                    f"{name} is {actual}, expected {expected} as in {first.path}",
                    where=file.path,
                    hint="Build one tileset for each kind of scene.",
                )
    common_origin = origin or middle_origin([file.origin for file in files])
    for file in files:
        distance = float(np.abs(np.subtract(file.origin, common_origin)).max())
        if distance > MAX_FLOAT32_OFFSET:
            text = (
                f"{file.path}: positions are {distance:,.0f} units from the origin "
                f"{origin_text(common_origin)} of the tileset, where float32 has steps of "
                f"{np.spacing(np.float32(distance)):.2g}"
            )
            warnings.warn(text, FormatWarning, stacklevel=2)
    return [replace(file, origin=common_origin) for file in files]


def _open_scene_file(path: Path) -> SceneFile:
    try:
        if path.name == STANDARD_INPUT and not path.exists():
            raise NotSupported(
                "standard input cannot be read twice, as a build does",
                expected="a file of splats",
                hint="Save it to a file first.",
                path=str(path),
            )
        if path.is_dir() and not names_tileset(path):
            path = Path(resolve_input(path))
        table = ply_table(path) if _is_ply(path) else None
        status = path.stat()
        if table is None:
            return _decode_scene_file(path, status.st_size, status.st_mtime_ns)
    except FormatError as error:
        raise _unreadable_input_error(error) from error
    except OSError as error:
        raise InputUnreadable(
            f"cannot be read: {error.strerror or error}", where=str(path)
        ) from error
    if table.count == 0:
        raise InputUnreadable("the file has 0 splats; expected at least one", where=str(path))
    warn_unused(path, table.unused)
    with naming(path):
        sample = read_ply_rows(path, table, 0, min(table.count, SAMPLED_ROWS))
    warn_of_suspicions(sample, path, table.count)
    return SceneFile(
        path=str(path),
        count=table.count,
        degree=min(table.degree, MAX_DEGREE),
        size=status.st_size,
        modified=status.st_mtime_ns,
        table=table,
        antialiased=table.antialiased,
        color_space=table.color_space,
        up=table.up,
    )


def _is_ply(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) in (b"ply\n", b"ply\r")


def _decode_scene_file(path: Path, size: int, modified: int) -> SceneFile:
    splats = _read_whole_file(path)
    return SceneFile(
        path=str(path),
        count=len(splats),
        degree=min(splats.degree, MAX_DEGREE),
        size=size,
        modified=modified,
        table=None,
        antialiased=splats.antialiased,
        color_space=splats.color_space,
        up=splats.up,
        origin=splats.origin,
    )


def _read_whole_file(path: Path) -> Splats:
    content = open_splats(path, drop_invalid=True)
    if isinstance(content, PackedRows):
        return splats_of_rows(content)
    if isinstance(content, PointCloud):
        raise InputUnreadable(
            "holds coloured points without size and opacity; expected splats",
            where=str(path),
            hint="Train splats from the points first.",
        )
    return content


def _unreadable_input_error(error: FormatError) -> InputUnreadable:
    expected = f"; expected {error.expected}" if error.expected else ""
    where = ": ".join(part for part in (error.path, error.where) if part)
    return InputUnreadable(f"{error.message}{expected}", where=where, hint=error.hint)


def chunks_of(files: Sequence[SceneFile], chunk_bytes: int = CHUNK_BYTES) -> list[Chunk]:
    """Divide the scene files into chunks of splats, in order."""
    parts = [(file, first, count) for file in files for first, count in _ranges(file, chunk_bytes)]
    source, chunks = 0, []
    for index, (file, first, count) in enumerate(parts):
        chunks.append(Chunk(index=index, file=file, first=first, count=count, source=source))
        source += count
    return chunks


def _ranges(file: SceneFile, chunk_bytes: int) -> Iterator[tuple[int, int]]:
    step = file.count
    if file.table is not None:
        blocks = chunk_bytes // (file.table.row_bytes * BLOCK_ROWS)
        step = max(1, blocks) * BLOCK_ROWS
    for first in range(0, file.count, step):
        yield first, min(step, file.count - first)


def read_chunk(chunk: Chunk) -> Splats:
    """Read all splats of a chunk of a scene file, including splats that cannot be drawn."""
    try:
        if chunk.file.table is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FormatWarning)  # opening the file has said it
                splats = _read_whole_file(Path(chunk.file.path))
        else:
            splats = read_ply_rows(chunk.file.path, chunk.file.table, chunk.first, chunk.count)
        return relative_to(splats, chunk.file.origin)
    except FormatError as error:
        raise _unreadable_input_error(error) from error


def row_dtype(degree: int) -> np.dtype[Any]:
    """Return the NumPy dtype of a splat in the build's temporary files, for an SH degree."""
    return np.dtype(
        [
            ("source", "<u8"),
            ("position", "<f4", (3,)),
            ("rotation", "<f4", (4,)),
            ("log_scale", "<f4", (3,)),
            ("logit_opacity", "<f4"),
            ("sh", "<f4", (SH_COUNTS[degree], 3)),
        ]
    )
