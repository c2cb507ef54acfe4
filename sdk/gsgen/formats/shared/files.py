"""Opens and replaces files; every fault raises a FormatError that names the file."""

import mmap
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, final

from gsgen.contract.process.atomic_files import is_device, write_fault
from gsgen.contract.process.drafts import temporary_folder
from gsgen.formats.shared.errors import FileUnreadable, FileUnwritable, FormatError, quoted

FilePath = str | os.PathLike[str]
"""The types of path arguments."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class FileContent(os.PathLike[str]):
    """The content of a file without a path, such as a member of an archive, for readers of files.

    Errors and warnings name it by its address, never by the path of a temporary copy.

    Attributes:
        name: The name in error messages, whose suffix counts: that of the archive, and the member,
            or an address.
        data: The bytes, in anonymous memory or of a file that was removed.
        neighbours: Relative path → the bytes of a file beside it.
    """

    name: str
    data: mmap.mmap
    neighbours: Mapping[str, mmap.mmap] = field(default_factory=dict)

    def __fspath__(self) -> str:
        return self.name

    def __str__(self) -> str:
        return self.name


@contextmanager
def naming(path: FilePath) -> Iterator[None]:
    """Add the file path to every FormatError of the ``with`` block that has none."""
    try:
        yield
    except FormatError as error:
        error.path = error.path or os.fspath(path)
        raise


@contextmanager
def open_file(path: FilePath) -> Iterator[BinaryIO]:
    """Open the file at ``path`` for reading; faults raise FileUnreadable."""
    with naming(path):
        if isinstance(path, FileContent):
            yield BytesIO(path.data)
            return
        try:
            _require_regular_file(path)
            with open(path, "rb") as file:
                yield file
        except OSError as error:
            raise FileUnreadable(f"the file cannot be read: {error.strerror or error}") from error


@contextmanager
def map_file(path: FilePath) -> Iterator[mmap.mmap]:
    """Map the file at ``path`` into memory, read-only."""
    if isinstance(path, FileContent):
        with naming(path):
            yield path.data
        return
    with open_file(path) as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        try:
            yield data
        finally:
            # A traceback may hold an array that points into the map. The map is then
            # closed when the array is freed.
            with suppress(BufferError):
                data.close()


def file_beside(path: FilePath, name: str) -> FilePath:
    """Return the file that another one names by a relative path.

    Raises:
        FileUnreadable: The file came from an address, and this one did not come with it.
    """
    if not isinstance(path, FileContent):
        return Path(path).parent / name
    if name not in path.neighbours:
        raise FileUnreadable(f"there is no file {quoted(name)} beside it", path=path.name)
    return FileContent(f"{path.name.rpartition('/')[0]}/{name}", path.neighbours[name])


@contextmanager
def replace_file(path: FilePath) -> Iterator[BinaryIO]:
    """Open a new file that replaces ``path`` when the ``with`` block ends.

    Another process that reads ``path`` sees the old file or the new one, never a part. If the
    body raises, ``path`` is unchanged.
    """
    with naming(path):
        try:
            if is_device(Path(path)):
                raise FileUnwritable("the path is a device or a pipe", expected="a file to write")
            with temporary_folder(Path(path).parent) as folder:
                draft = folder / "draft"
                with open(draft, "xb") as file:
                    yield file
                os.replace(draft, path)
        except OSError as error:
            raise FileUnwritable(f"the file cannot be written: {write_fault(error)}") from error


def stream_size(file: BinaryIO) -> int:
    """Return the number of bytes of an open file, whose position stays."""
    position = file.tell()
    size = file.seek(0, os.SEEK_END)
    file.seek(position)
    return size


def make_folder(path: FilePath) -> None:
    """Create the parent folder of ``path``, and the folders above it."""
    with naming(path):
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileUnwritable(f"the file cannot be written: {write_fault(error)}") from error


def _require_regular_file(path: FilePath) -> None:
    try:
        status = os.stat(path)
    except ValueError as error:  # a NUL byte in the path
        raise FileUnreadable(f"the file cannot be read: {error}") from error
    if stat.S_ISDIR(status.st_mode):
        raise FileUnreadable("the path is a folder", expected="a file")
    if not stat.S_ISREG(status.st_mode):
        raise FileUnreadable("the path is a device, pipe or socket", expected="a regular file")
    if status.st_size == 0:
        raise FileUnreadable(
            "the file is empty", hint="write it again: the program that wrote it may have failed"
        )
