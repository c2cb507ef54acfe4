"""Open and replace files so that every trouble is a FormatError that names the file."""

import mmap
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from gsgen.contract.process.atomic_files import is_device
from gsgen.formats.shared.errors import FileUnreadable, FileUnwritable, FormatError

FilePath = str | os.PathLike[str]
"""What a caller may give as a path."""


@contextmanager
def naming(path: FilePath) -> Iterator[None]:
    """Write ``path`` into every FormatError of the body that names no file yet."""
    try:
        yield
    except FormatError as error:
        error.path = error.path or os.fspath(path)
        raise


@contextmanager
def opened(path: FilePath) -> Iterator[BinaryIO]:
    """Open the file at ``path`` to read.

    Raises:
        FileUnreadable: It is missing, empty, no regular file, or reading it fails.
    """
    with naming(path):
        try:
            _require_regular(path)
            with open(path, "rb") as file:
                yield file
        except OSError as error:
            raise FileUnreadable(f"cannot be read: {error.strerror or error}") from error


@contextmanager
def mapped(path: FilePath) -> Iterator[mmap.mmap]:
    """Map the file at ``path`` into memory, read-only.

    Raises:
        FileUnreadable: It is missing, empty, no regular file, or mapping it fails.
    """
    with opened(path) as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        try:
            yield data
        finally:
            # An array of an unfinished read, held by a traceback, may still point into
            # the map; then the map goes when the array does.
            with suppress(BufferError):
                data.close()


@contextmanager
def replacing(path: FilePath) -> Iterator[BinaryIO]:
    """Write a new file and put it at ``path`` once the body is done.

    Whoever reads ``path`` meanwhile sees the old file or the new one, never a part. If
    the body raises, ``path`` is as it was.

    Raises:
        FileUnwritable: The file could not be written or put in place, or is none.
    """
    with naming(path):
        try:
            if is_device(Path(path)):
                raise FileUnwritable("is a device or a pipe", expected="a file to write")
            # Not tempfile: its files are closed to everyone but their owner.
            part = Path(path).parent / f".{secrets.token_hex(8)}.part"
            try:
                with open(part, "xb") as file:
                    yield file
                os.replace(part, path)
            finally:
                part.unlink(missing_ok=True)
        except OSError as error:
            raise FileUnwritable(f"cannot be written: {error.strerror or error}") from error


def make_folder(path: FilePath) -> None:
    """Make the folder that ``path`` is to be written in, and those above it.

    Raises:
        FileUnwritable: It cannot be made.
    """
    with naming(path):
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileUnwritable(f"cannot be written: {error.strerror or error}") from error


def _require_regular(path: FilePath) -> None:
    try:
        status = os.stat(path)
    except ValueError as error:  # a NUL byte in the path
        raise FileUnreadable(f"cannot be read: {error}") from error
    if stat.S_ISDIR(status.st_mode):
        raise FileUnreadable("is a folder", expected="a file")
    if not stat.S_ISREG(status.st_mode):
        raise FileUnreadable("is a device, pipe or socket", expected="a regular file")
    if status.st_size == 0:
        raise FileUnreadable(
            "is empty", hint="make it again: whatever wrote it may have failed"
        )
