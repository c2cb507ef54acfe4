"""Reads COLMAP's cameras.bin and images.bin: little-endian records after a count.

Counts in a file are checked against its size before records are read.
"""

__all__ = ["images", "lenses"]

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.colmap_models import MODELS, NAMES, ColmapImage, ColmapLens

_LENS: Final = struct.Struct("<iiQQ")  # number, model, width, height
_IMAGE: Final = struct.Struct("<i7di")  # number, quaternion, translation, camera
_COUNT: Final = struct.Struct("<Q")
_POINT: Final = 24  # bytes of a 2D point of an image
_LONGEST_NAME: Final = 4096
_DAMAGED: Final = "The file is damaged, or was not written by COLMAP."


def lenses(path: Path) -> dict[int, ColmapLens]:
    """Read the intrinsics in COLMAP's cameras.bin, by camera number."""
    with _opened(path) as data:
        by_number: dict[int, ColmapLens] = {}
        for index in range(data.count(_LENS.size)):
            number, model, width, height = data.take(_LENS)
            if not 0 <= model < len(NAMES):
                raise ConfigInvalid(
                    f"camera {index} has the model {model}, expected 0 to {len(NAMES) - 1}",
                    where=str(path),
                )
            expected = len(MODELS[NAMES[model]].split())
            values = data.take(struct.Struct(f"<{expected}d"))
            by_number[number] = ColmapLens(NAMES[model], width, height, values)
        return by_number


def images(path: Path) -> list[ColmapImage]:
    """Read the images of COLMAP's images.bin, without their 2D points."""
    with _opened(path) as data:
        records = []
        for _ in range(data.count(_IMAGE.size + 1 + _COUNT.size)):
            _, *pose, lens = data.take(_IMAGE)
            name = data.name()
            data.skip(data.take(_COUNT)[0] * _POINT)
            records.append(ColmapImage(name, tuple(pose[:4]), tuple(pose[4:]), lens))
        return records


@final
class _Reader:
    """A memory-mapped binary file of COLMAP with a read position."""

    def __init__(self, data: mmap.mmap, path: Path) -> None:
        self._data, self._path, self._at = data, path, 0

    def count(self, least: int) -> int:
        """Read the number of records in a COLMAP file, and check it against the file's size."""
        (count,) = self.take(_COUNT)
        if count > (len(self._data) - self._at) // least:
            raise ConfigInvalid(
                f"declares {count} records, more than its {len(self._data)} bytes can hold",
                where=str(self._path),
                hint=_DAMAGED,
            )
        return int(count)

    def take(self, form: struct.Struct) -> tuple[Any, ...]:
        """Read the numbers of one record of a COLMAP file."""
        offset = self._at
        self.skip(form.size)
        return form.unpack_from(self._data, offset)

    def skip(self, size: int) -> None:
        """Advance the read position of a COLMAP file by some bytes."""
        if size > len(self._data) - self._at:
            raise ConfigInvalid(
                f"ends at byte {len(self._data)}, expected {size} bytes from byte {self._at} on",
                where=str(self._path),
                hint=_DAMAGED,
            )
        self._at += size

    def name(self) -> str:
        """Read a zero-terminated text of a COLMAP file."""
        end = self._data.find(b"\0", self._at, self._at + _LONGEST_NAME)
        if end < 0:
            raise ConfigInvalid(
                f"the image name at byte {self._at} has no final zero byte", where=str(self._path)
            )
        content = self._data[self._at : end]
        self._at = end + 1
        return content.decode("utf-8", errors="replace")


@contextmanager
def _opened(path: Path) -> Iterator[_Reader]:
    try:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield _Reader(data, path)
    except (OSError, ValueError) as error:  # ValueError: the file is empty
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
