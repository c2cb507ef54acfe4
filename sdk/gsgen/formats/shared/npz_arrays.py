"""Unpacks arrays from an .npz archive, after a check of their declared sizes."""

import errno
import math
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from typing import Final

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.process.array_files import (
    MAX_HEADER_LENGTH,
    first_line,
    read_array,
    read_array_header,
)
from gsgen.formats.shared.errors import ArchiveDamaged, FormatError, NotSupported, SizeExceeded

ZIP_MAGIC: Final = b"PK\x03\x04"
"""The first bytes of a zip archive."""


@contextmanager
def unpacking(where: str) -> Iterator[None]:
    """Convert exceptions of zipfile, zlib and NumPy about damaged files to ArchiveDamaged."""
    try:
        yield
    except FormatError:
        raise
    except OSError as error:
        if error.errno != errno.EINVAL:  # EINVAL is an offset before the start of the file
            raise
        raise _damaged_archive_error(where, error) from error
    except MemoryError as error:
        raise SizeExceeded("reading takes more memory than is available", where=where) from error
    # The libraries document no common base: BadZipFile, zlib.error, EOFError, ValueError,
    # NotImplementedError, RuntimeError, struct.error, tokenize.TokenError and others.
    except Exception as error:
        raise _damaged_archive_error(where, error) from error


def _damaged_archive_error(where: str, error: Exception) -> ArchiveDamaged:
    return ArchiveDamaged(
        f"the archive cannot be unpacked ({type(error).__name__}: {first_line(str(error))})",
        where=where,
        hint="copy, download or save the file again",
    )


def read_arrays(
    archive: zipfile.ZipFile, keys: Sequence[str], max_bytes: int
) -> list[Shaped[np.ndarray, "..."]]:
    """Read the arrays ``keys`` of an .npz archive if they fit in ``max_bytes`` of memory.

    Raises:
        ArchiveDamaged: An array cannot be unpacked, or its size differs from the declared one.
        NotSupported: An array holds Python objects.
        SizeExceeded: The arrays would take more than ``max_bytes``.
    """
    sizes = {key: _declared_bytes(archive, key) for key in keys}
    if sum(sizes.values()) > max_bytes:
        parts = " and ".join(f"{size} bytes ({key})" for key, size in sizes.items())
        raise SizeExceeded(
            f"the arrays take {parts}",
            expected=f"{max_bytes} bytes or fewer together",
            hint="if you trust the file, read it with a larger max_bytes",
        )
    return [_read_array(archive, key) for key in keys]


def _declared_bytes(archive: zipfile.ZipFile, key: str) -> int:
    """Return the size in bytes that an .npz array declares, checked against its zip entry."""
    entry = archive.getinfo(f"{key}.npy")
    with unpacking(f"array {key}"), archive.open(entry) as stream:
        # This limit holds for any length that the header declares.
        header_bytes = BytesIO(stream.read(MAX_HEADER_LENGTH))
        shape, dtype = read_array_header(header_bytes)
    if dtype.hasobject:
        raise NotSupported(
            "the array holds Python objects",
            where=f"array {key}",
            expected="numbers",
            hint="save it as an array of one numeric type",
        )
    size = math.prod(shape) * dtype.itemsize
    if header_bytes.tell() + size != entry.file_size:
        raise ArchiveDamaged(
            f"the array has {entry.file_size} bytes, but {dtype} {list(shape)} takes "
            f"{header_bytes.tell() + size}, header included",
            where=f"array {key}",
            hint="copy, download or save the file again",
        )
    return size


def _read_array(archive: zipfile.ZipFile, key: str) -> Shaped[np.ndarray, "..."]:
    entry = archive.getinfo(f"{key}.npy")
    with unpacking(f"array {key}"), archive.open(entry) as stream:
        return read_array(stream, entry.file_size)
