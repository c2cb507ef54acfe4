"""Converts PLY files larger than memory: reads, edits and writes their splats in parts."""

__all__ = ["PART_WRITERS", "PlyParts", "open_parts", "with_degree"]

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np

from gsgen.formats.editing.edits import ParsedEdit, no_splats_left
from gsgen.formats.ply.chunks import PlyTable, ply_table, read_ply_rows
from gsgen.formats.ply.layout import splat_names
from gsgen.formats.ply.methods import FILTER_PROPERTY, require_still_splats
from gsgen.formats.ply.values import require_splats
from gsgen.formats.ply.write import write_ply_parts
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.files import FilePath, naming
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.splats import SH_COUNTS, Splats
from gsgen.formats.shared.suspicions import SAMPLED_ROWS, warn_of_suspicions
from gsgen.formats.sog.write import write_sog_parts
from gsgen.formats.spz.spz import write_spz_parts

_CHUNK_ROWS: Final = 1 << 18
_FLOAT_BYTES: Final = 4


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlyParts:
    """The edited splats of a PLY file, in parts of up to 2¹⁸ rows; each iteration reads the file.

    Attributes:
        path: The file.
        table: Where its rows lie.
        edits: Edits of single rows, in their order.
        most_degree: Harmonics above this degree are dropped.
    """

    path: FilePath
    table: PlyTable
    edits: Sequence[ParsedEdit]
    most_degree: int

    def __iter__(self) -> Iterator[Splats]:
        """Yield the edited parts of a PLY file; parts without remaining splats are left out.

        Raises:
            ValueInvalid: A value cannot be drawn; rows count from the start of the part.
        """
        for start in range(0, self.table.count, _CHUNK_ROWS):
            size = min(_CHUNK_ROWS, self.table.count - start)
            part = read_ply_rows(self.path, self.table, start, size)
            with naming(self.path):
                try:
                    require_splats(part)
                except ValueInvalid as error:
                    error.where = f"{error.where}, rows from {start} on"
                    raise
            for edit in self.edits:
                part = edit.apply(part) if len(part) else part
            if len(part):
                yield with_degree(part, self.most_degree)

    @property
    def degree(self) -> int:
        """The SH degree of the splats that are read from the PLY file."""
        return min(self.table.degree, self.most_degree)

    def measure_extent(self) -> tuple[int, float]:
        """Return the number of splats that the edits leave, and the largest absolute coordinate.

        Raises:
            ValueInvalid: The edits leave no splat.
        """
        count, max_coordinate = 0, 0.0
        for part in self:
            count += len(part)
            max_coordinate = max(max_coordinate, float(np.abs(part.position).max()))
        if not count:
            texts = " ".join(edit.text for edit in self.edits)
            raise no_splats_left(texts, self.table.count)
        return count, max_coordinate


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _PartsWithCount:
    """The edited splats of a PLY file, with their number, which a first pass has counted."""

    parts: PlyParts
    count: int

    @property
    def antialiased(self) -> bool:
        return self.parts.table.antialiased

    @property
    def degree(self) -> int:
        return self.parts.degree

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Splats]:
        return iter(self.parts)


PartWriter = Callable[[FilePath, PlyParts, int, float], None]
PART_WRITERS: Final[dict[str, PartWriter]] = {
    "ply": lambda path, parts, count, _: write_ply_parts(path, parts, count),
    "sog": lambda path, parts, count, _: write_sog_parts(
        path, _PartsWithCount(parts=parts, count=count)
    ),
    "spz": write_spz_parts,
}
"""Formats that are written in parts: path, parts, their total count and largest coordinate."""


def with_degree(splats: Splats, degree: int) -> Splats:
    """Return splats without spherical harmonics above a degree."""
    if splats.degree <= degree:
        return splats
    return replace(splats, sh=np.ascontiguousarray(splats.sh[:, : SH_COUNTS[degree]]))


def open_parts(
    path: FilePath,
    edits: Sequence[Callable[[Splats], Splats]],
    *,
    most_degree: int = 4,
    min_bytes: int,
) -> PlyParts | None:
    """Open a PLY file of many splats for reading in parts.

    Returns:
        None where the whole file has to be in memory, or may be: it is small or of another format,
        its rows need Mip-Splatting's filter, or an edit regards several splats at once.
    """
    is_row_wise = [edit for edit in edits if isinstance(edit, ParsedEdit) and edit.is_row_wise]
    if (
        len(is_row_wise) < len(edits)
        or Path(path).suffix.lower() != ".ply"
        or not Path(path).is_file()
    ):
        return None
    table = ply_table(path)
    if table is None or FILTER_PROPERTY in table.columns:
        return None
    names = splat_names(table.degree)
    if table.count * len(names) * _FLOAT_BYTES <= min_bytes:
        return None
    with naming(path):
        require_still_splats(table.columns)
    warn_unused(path, table.unused)
    sample = read_ply_rows(path, table, 0, min(table.count, SAMPLED_ROWS))
    warn_of_suspicions(sample, path, table.count)
    return PlyParts(path=path, table=table, edits=is_row_wise, most_degree=most_degree)
