"""Reads the frames of a sequence: splat files, in the order of their numbers."""

__all__ = ["FrameFiles"]

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gsgen.contract.errors import InputUnreadable
from gsgen.formats import PackedRows
from gsgen.formats.shared.origins import Origin
from gsgen.reference_plugins.static.static import from_content
from gsgen.runtime.sources.sequence_source import sequence_files
from gsgen.sdk.exporting.constant_generator import Axis, ConstantRows
from gsgen.tiles.loading.leaves import open_splats


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of a sequence in order; all positions are relative to one origin.

    Attributes:
        paths: The files.
        origin: The point that positions are relative to.
        up: The upward axis of the frames; that of each file where absent.
    """

    paths: tuple[Path, ...]
    origin: Origin | None = None
    up: Axis | None = None

    @classmethod
    def of(cls, entries: Sequence[Path], up: Axis | None = None) -> "FrameFiles":
        """Return the files that a folder, a pattern or a list of files names.

        Raises:
            InputUnreadable: A folder holds no sequence.
        """
        paths: list[Path] = []
        for entry in entries:
            files = sequence_files(entry)
            if entry.is_dir() and not files:
                message = "is not a folder of two or more numbered splat files of one kind"
                hint = "Name the files in order, or a pattern such as frames/%04d.ply."
                raise InputUnreadable(message, where=str(entry), hint=hint)
            paths += files or [entry]
        first = open_splats(paths[0])
        return cls(tuple(paths), None if isinstance(first, PackedRows) else first.origin, up)

    def read(self, number: int) -> ConstantRows:
        """Return the packed rows of a frame."""
        rows = from_content(open_splats(self.paths[number], origin=self.origin))
        return rows if self.up is None else replace(rows, up=self.up)
