"""Plays splat files that are the frames of a sequence: a folder of them, or a pattern of numbers."""

__all__ = ["SequenceSource", "numbered_files", "sequence_files"]

import re
from pathlib import Path
from typing import Final, final

import numpy as np

from gsgen.contract.spec.manifest import Input
from gsgen.formats.codecs import codec_of_suffix
from gsgen.formats.shared.origins import Origin
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.natural_order import natural_key
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.source import Source, StillFrameSource, Values

_FRAME_INPUT: Final = "frame"
_PRINTF_NUMBER_PATTERN: Final = re.compile(r"%(0?\d*)d")
_TRAILING_NUMBER_PATTERN: Final = re.compile(r"\d+$")


def sequence_files(path: Path) -> list[Path]:
    """Return the files of a sequence in the order of their numbers; empty for other paths.

    A sequence is a folder of two or more splat files of one kind whose names end in numbers, and
    nothing else that a reader of folders knows; or a name with a number's pattern, such as
    ``frames/%04d.ply``.
    """
    if path.is_dir():
        frames = [file for file in path.iterdir() if _is_frame(file)]
        suffixes = {file.suffix.lower() for file in frames}
        frames = frames if len(suffixes) == 1 and len(frames) > 1 else []
        return sorted(frames, key=lambda file: natural_key(file.name))
    files = numbered_files(path)
    if files is None:
        return []
    if not files:
        raise SceneUnreadable("matches no file, expected numbered splat files", where=str(path))
    return files


def numbered_files(pattern: Path) -> list[Path] | None:
    """Return the files that a name with a number's pattern matches, in the order of the numbers.

    None for a path without a pattern, such as that of an existing file.
    """
    match = _PRINTF_NUMBER_PATTERN.search(pattern.name)
    if match is None or pattern.exists() or not pattern.parent.is_dir():
        return None
    name_prefix, name_suffix = pattern.name[: match.start()], pattern.name[match.end() :]
    digits = r"\d+" if not match[1].isdecimal() else rf"\d{{{int(match[1])},}}"
    name_pattern = re.compile(re.escape(name_prefix) + digits + re.escape(name_suffix))
    files = [file for file in pattern.parent.iterdir() if name_pattern.fullmatch(file.name)]
    return sorted(files, key=lambda file: natural_key(file.name))


def _is_frame(file: Path) -> bool:
    is_splat_file = codec_of_suffix(file) is not None and not file.name.startswith(".")
    return is_splat_file and _TRAILING_NUMBER_PATTERN.search(file.stem) is not None


@final
class SequenceSource(Source):
    """The Gaussians of a sequence of splat files, one file per frame.

    The input ``frame``, of the role ``frame_index``, chooses the file, from 0. All frames have the
    size of the largest: rows behind a frame's own are not live.

    Args:
        path: The folder, or the pattern, for messages.
        files: The files in order, two or more.
        origin: The point of the files that positions are relative to; None for one of each file.

    Raises:
        SceneUnreadable: A file cannot be read.
        SceneInvalid: Files differ in what their colours are, or in antialiasing.
    """

    def __init__(self, path: Path, files: list[Path], origin: Origin | None = None) -> None:
        self.name, self.files, self._origin = str(path), files, origin
        self.inputs = (
            Input(name=_FRAME_INPUT, role="frame_index", shape=(1,), range=(0, len(files) - 1)),
        )
        first, largest_count, channels = self._open(files[0]), 0, 0
        self.antialias, self.color_space = first.antialias, first.color_space
        for file in files:
            frame = self._open(file)
            self._require_equal_kind(file, frame, first)
            largest_count = max(largest_count, frame.data.count)
            channels = max(channels, frame.data.appearance.shape[1])
        self._shape, self._file_number, self._loaded_number = (largest_count, channels), 0, 0
        rows, appearance = self._pad_rows(first.data)
        self.data = SplatData(
            rows, appearance, first.data.space, count=first.data.count, origin=first.data.origin
        )

    def _open(self, file: Path) -> StillFrameSource:
        return StillFrameSource(file, self._origin)

    def _require_equal_kind(self, file: Path, frame: Source, first: Source) -> None:
        kinds = [
            (source.data.space, source.antialias, source.color_space) for source in (frame, first)
        ]
        if kinds[0] != kinds[1]:
            raise SceneInvalid(
                f"has {', '.join(kinds[0])}, expected {', '.join(kinds[1])} as {self.files[0].name}",
                where=str(file),
                hint="Frames of a sequence have one kind of colours and one antialiasing.",
            )

    def _pad_rows(self, data: SplatData) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows and colours of a frame with the size of the largest, in float32."""
        count, channels = self._shape
        rows = np.zeros((count, data.rows.shape[1]), np.float32)
        appearance = np.zeros((count, channels), np.float32)
        rows[: data.count] = data.rows[: data.count]
        appearance[: data.count, : data.appearance.shape[1]] = data.appearance[: data.count]
        return rows, appearance

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Choose the file of a frame; :meth:`finish` reads it."""
        value = values.get(_FRAME_INPUT, values.get("frame_index", self._file_number))
        number = int(np.asarray(value).reshape(-1)[0])
        if not 0 <= number < len(self.files):
            raise SceneInvalid(
                f"the frame is {number}, expected 0 to {len(self.files) - 1}", where=self.name
            )
        self._file_number = number

    def finish(self) -> None:
        """Read the file of the chosen frame, unless its Gaussians are the current ones."""
        if self._file_number == self._loaded_number:
            return
        data = self._open(self.files[self._file_number]).data
        rows, appearance = self._pad_rows(data)
        self.data.update(rows, appearance, data.count, origin=data.origin)
        self._loaded_number = self._file_number

    def abandon(self) -> None:
        """Return at once: a file is read in :meth:`finish` only."""

    def hold_frames(self, frames: int) -> bool:
        """Return True: each frame has arrays of its own."""
        return True

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the input ``frame``."""
        return {_FRAME_INPUT: (1,)}[name]

    def close(self) -> None:
        """Release nothing, because no file stays open."""
