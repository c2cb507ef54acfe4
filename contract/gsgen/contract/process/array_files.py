"""The one reader of .npy and .npz files: numbers alone, after a check of their declared sizes."""

__all__ = [
    "ARRAY_MAGIC",
    "MAX_HEADER_LENGTH",
    "ArraysUnreadable",
    "array_limit",
    "first_line",
    "read_array",
    "read_array_file",
    "read_array_header",
    "read_arrays",
]

import math
import stat
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Final, NoReturn

import numpy as np

from gsgen.contract.errors import InputUnreadable

ARRAY_MAGIC: Final = b"\x93NUMPY"
"""The first bytes of an .npy file."""

MAX_HEADER_LENGTH: Final = 1 << 16
"""The largest header of an array that is read, in bytes; plain arrays need 128."""

_ZIP_MAGIC = b"PK"
_ARRAY_FILE_SUFFIX = ".npy"
_MIN_FREE_BYTES = 32 << 20
_NUMBER_BYTES = 8  # readers convert to float64
_KINDS = "biufcSU"  # numbers and texts
_MAX_SIZE = 1 << 40
_COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those that NumPy writes
_ENCRYPTION_FLAG = 1
_MAX_MESSAGE_LENGTH = 200


class ArraysUnreadable(InputUnreadable):
    """Raised if a file of arrays is damaged, holds objects, or would take too much memory."""


def read_array_file(path: Path, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Read the array of an .npy file under the name "", or the arrays of an .npz file.

    Args:
        path: The file; its content decides which kind it is.
        names: The arrays to read from an .npz file, of which missing ones are left out; None for
            all. Others may be damaged.

    Raises:
        ArraysUnreadable: The file is damaged, or holds Python objects, or its arrays as float64
            take more than 32 MiB and more than 8 times the file.
    """
    with _array_faults(path):
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ValueError("the file is a folder, a pipe or a device")
        with path.open("rb") as file:
            magic = file.read(len(ARRAY_MAGIC))
            file.seek(0)
            if magic == ARRAY_MAGIC:
                return {"": read_array(file, status.st_size, array_limit(status.st_size))}
            if not magic.startswith(_ZIP_MAGIC):
                raise ValueError(f"the file starts with {magic!r}, neither .npy nor .npz")
            with zipfile.ZipFile(file) as archive:
                return _read_archive(archive, names, array_limit(status.st_size))


def read_arrays(path: Path, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz file, see :func:`read_array_file`.

    Raises:
        ArraysUnreadable: The file is an .npy file, or cannot be read.
    """
    arrays = read_array_file(path, names)
    if "" in arrays:
        _raise_unreadable_array(path, "the file holds one array, expected an .npz archive")
    return arrays


def array_limit(file_bytes: int) -> int:
    """Return how many bytes the arrays of a file may take as float64."""
    return max(_MIN_FREE_BYTES, _NUMBER_BYTES * file_bytes)


def _read_archive(
    archive: zipfile.ZipFile, names: Iterable[str] | None, limit: int
) -> dict[str, np.ndarray]:
    entries = {
        entry.filename.removesuffix(_ARRAY_FILE_SUFFIX): entry
        for entry in archive.infolist()
        if entry.filename.endswith(_ARRAY_FILE_SUFFIX)
    }
    arrays: dict[str, np.ndarray] = {}
    for name in entries if names is None else names:
        if name not in entries:
            continue
        entry = entries[name]
        if entry.flag_bits & _ENCRYPTION_FLAG or entry.compress_type not in _COMPRESSION_METHODS:
            raise ValueError(f"array {name!r:.80} is encrypted or compressed in an unknown way")
        with archive.open(entry) as stream:
            arrays[name] = read_array(stream, entry.file_size, limit)
        limit -= _float64_bytes(arrays[name].shape, arrays[name].dtype)
    return arrays


def read_array(stream: IO[bytes], size: int, limit: int | None = None) -> np.ndarray:
    """Read one array of numbers or texts in the .npy format, which takes the whole stream.

    Args:
        stream: The file.
        size: Its size in bytes.
        limit: How many bytes the array may take as float64; None for any number.

    Raises:
        ValueError: The array is damaged or too large, or holds Python objects.
    """
    start = BytesIO(stream.read(MAX_HEADER_LENGTH))
    shape, dtype = read_array_header(start)
    if dtype.kind not in _KINDS:
        raise ValueError(f"the array holds {dtype}, expected numbers")
    if any(not 0 <= length < _MAX_SIZE for length in shape):
        raise ValueError(f"the array has the shape {list(shape)}")
    needed = start.tell() + math.prod(shape) * dtype.itemsize
    if needed != size:
        raise ValueError(f"{dtype} {list(shape)} takes {needed} bytes, but the array has {size}")
    if limit is not None and _float64_bytes(shape, dtype) > limit:
        raise ValueError(f"{dtype} {list(shape)} takes more memory than the limit of {limit} bytes")
    start.seek(0)
    array = np.lib.format.read_array(_JoinedArray(start, stream), allow_pickle=False)
    if stream.read(1):  # the end of an archive's entry also checks its CRC
        raise ValueError("the array is longer than it declares")
    return np.asarray(array)


def read_array_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype]:
    """Read the header of an .npy file up to the first byte of the data: shape and dtype.

    Raises:
        ValueError: The header is damaged or of an unknown version.
    """
    version = np.lib.format.read_magic(stream)
    # Version 3 is for field names beyond Latin-1, which plain arrays do not have.
    if version not in ((1, 0), (2, 0)):
        raise ValueError(
            f"the array has version {version} of the .npy format, which is not supported"
        )
    reader = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    try:
        shape, _, dtype = reader(stream)
    except Exception as error:  # ValueError, struct.error, SyntaxError, tokenize.TokenError, …
        reason = first_line(str(error)) or type(error).__name__
        raise ValueError(f"the array has an invalid header ({reason})") from error
    return shape, dtype


def _float64_bytes(shape: tuple[int, ...], dtype: np.dtype) -> int:
    return math.prod(shape) * max(_NUMBER_BYTES, dtype.itemsize)


class _JoinedArray:
    """A stream whose first bytes were read already."""

    def __init__(self, start: BytesIO, rest: IO[bytes]) -> None:
        self._start, self._remaining_file = start, rest

    def read(self, count: int = -1, /) -> bytes:
        """Read up to ``count`` bytes."""
        data = self._start.read(count)
        return data if len(data) == count else data + self._remaining_file.read(count - len(data))


@contextmanager
def _array_faults(path: Path) -> Iterator[None]:
    """Convert exceptions of zipfile, zlib and NumPy about damaged files to ArraysUnreadable."""
    try:
        yield
    except OSError as error:
        _raise_unreadable_array(path, error.strerror or str(error), error)
    except MemoryError as error:
        _raise_unreadable_array(path, "the arrays take more memory than is available", error)
    # The libraries document no common base: BadZipFile, zlib.error, EOFError, ValueError,
    # NotImplementedError, RuntimeError, struct.error, tokenize.TokenError and others.
    except Exception as error:
        _raise_unreadable_array(path, str(error) or type(error).__name__, error)


def _raise_unreadable_array(path: Path, reason: str, cause: Exception | None = None) -> NoReturn:
    raise ArraysUnreadable(f"cannot be read: {first_line(reason)}", where=str(path)) from cause


def first_line(text: str) -> str:
    """Return the first line of a library's error message, cut if it is long."""
    # It may quote the file. NumPy's further lines advise to unpickle.
    line = next(iter(text.splitlines()), "")
    return line if len(line) <= _MAX_MESSAGE_LENGTH else f"{line[:_MAX_MESSAGE_LENGTH]}…"
