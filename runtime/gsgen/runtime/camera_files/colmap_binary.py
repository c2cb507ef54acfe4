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
from gsgen.runtime.camera_files.colmap_models import (
    CAMERA_MODELS,
    MODEL_NAMES,
    ColmapImage,
    ColmapLens,
    unsupported_model,
)

_LENS_STRUCT: Final = struct.Struct("<iiQQ")  # number, model, width, height
_IMAGE_STRUCT: Final = struct.Struct("<i7di")  # number, quaternion, translation, camera
_COUNT_STRUCT: Final = struct.Struct("<Q")
_POINT_BYTES: Final = 24  # bytes of a 2D point of an image
_LONGEST_NAME: Final = 4096
_DAMAGED_HINT: Final = "The file is damaged, or was not written by COLMAP."


def lenses(path: Path) -> dict[int, ColmapLens]:
    """Read the intrinsics in COLMAP's cameras.bin, by camera number."""
    with _open_reader(path) as data:
        lens_by_number: dict[int, ColmapLens] = {}
        for index in range(data.count(_LENS_STRUCT.size)):
            number, model, width, height = data.read_record(_LENS_STRUCT)
            if not 0 <= model < len(MODEL_NAMES):
                raise ConfigInvalid(
                    f"camera {index} has the model {model}, expected 0 to {len(MODEL_NAMES) - 1}",
                    where=str(path),
                )
            if MODEL_NAMES[model] not in CAMERA_MODELS:
                raise unsupported_model(MODEL_NAMES[model], str(path))
            expected = len(CAMERA_MODELS[MODEL_NAMES[model]].split())
            values = data.read_record(struct.Struct(f"<{expected}d"))
            lens_by_number[number] = ColmapLens(MODEL_NAMES[model], width, height, values)
        return lens_by_number


def images(path: Path) -> list[ColmapImage]:
    """Read the images of COLMAP's images.bin, without their 2D points."""
    with _open_reader(path) as data:
        records = []
        for _ in range(data.count(_IMAGE_STRUCT.size + 1 + _COUNT_STRUCT.size)):
            _, *pose, lens = data.read_record(_IMAGE_STRUCT)
            name = data.name()
            data.skip_bytes(data.read_record(_COUNT_STRUCT)[0] * _POINT_BYTES)
            records.append(ColmapImage(name, tuple(pose[:4]), tuple(pose[4:]), lens))
        return records


@final
class _Reader:
    """A memory-mapped binary file of COLMAP with a read position."""

    def __init__(self, data: mmap.mmap, path: Path) -> None:
        self._file_bytes, self._file_path, self._read_offset = data, path, 0

    def count(self, min_bytes: int) -> int:
        """Read the number of records in a COLMAP file, and check it against the file's size."""
        (count,) = self.read_record(_COUNT_STRUCT)
        if count > (len(self._file_bytes) - self._read_offset) // min_bytes:
            raise ConfigInvalid(
                f"declares {count} records, more than its {len(self._file_bytes)} bytes can hold",
                where=str(self._file_path),
                hint=_DAMAGED_HINT,
            )
        return int(count)

    def read_record(self, record_format: struct.Struct) -> tuple[Any, ...]:
        """Read the numbers of one record of a COLMAP file."""
        offset = self._read_offset
        self.skip_bytes(record_format.size)
        return record_format.unpack_from(self._file_bytes, offset)

    def skip_bytes(self, size: int) -> None:
        """Advance the read position of a COLMAP file by some bytes."""
        if size > len(self._file_bytes) - self._read_offset:
            raise ConfigInvalid(
                f"ends at byte {len(self._file_bytes)}, expected {size} bytes from byte {self._read_offset} on",
                where=str(self._file_path),
                hint=_DAMAGED_HINT,
            )
        self._read_offset += size

    def name(self) -> str:
        """Read a zero-terminated text of a COLMAP file."""
        end = self._file_bytes.find(b"\0", self._read_offset, self._read_offset + _LONGEST_NAME)
        if end < 0:
            raise ConfigInvalid(
                f"the image name at byte {self._read_offset} has no final zero byte",
                where=str(self._file_path),
            )
        content = self._file_bytes[self._read_offset : end]
        self._read_offset = end + 1
        return content.decode("utf-8", errors="replace")


@contextmanager
def _open_reader(path: Path) -> Iterator[_Reader]:
    try:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield _Reader(data, path)
    except (OSError, ValueError) as error:  # ValueError: the file is empty
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
