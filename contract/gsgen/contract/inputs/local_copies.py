"""Copies the file at an address, with the files that it names beside it, into a folder."""

__all__ = ["MAX_DOWNLOAD_BYTES", "fetch", "kept_folder", "on_disk", "read_start", "remote_file"]

import atexit
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final, final

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.file_kinds.kind import FileKind
from gsgen.contract.file_kinds.recognition import kind_of_file
from gsgen.contract.inputs.addresses import file_name, is_plain_location
from gsgen.contract.inputs.neighbours import named_neighbours, require_whole
from gsgen.contract.inputs.remote_file import ByteProgress, RemoteFile, ignore_progress
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.process.drafts import temporary_folder

MAX_DOWNLOAD_BYTES: Final = 16 << 30
"""Most bytes of a file at an address, together with those of the files that it names."""

_MAX_NEIGHBOURS: Final = 256
_MAX_NAME_LENGTH: Final = 200

ExternalWeights = Callable[[Path], Iterable[str]]
"""Returns the relative paths of the files with a model's weights."""

_kept_folders: Final = ExitStack()
atexit.register(_kept_folders.close)


def _no_weights(model: Path) -> list[str]:
    return []


def kept_folder() -> Path:
    """Return a new temporary folder, which stays until the process ends."""
    return _kept_folders.enter_context(temporary_folder())


@contextmanager
def on_disk(address: str) -> Iterator[Path]:
    """Copy the file at an address for the time of the block.

    Raises:
        InputUnreadable: It cannot be had; the subclass says why.
    """
    with temporary_folder() as folder:
        yield fetch(address, folder)


def remote_file(address: str) -> RemoteFile:
    """Return the file at an address.

    Raises:
        InputUnreadable: The address is malformed, or needs a package that is not installed.
    """
    scheme = address.partition("://")[0]
    if scheme in ("http", "https", "hf"):
        from gsgen.contract.inputs.web_file import hub_file, web_file

        return hub_file(address) if scheme == "hf" else web_file(address)
    from gsgen.contract.inputs.stored_file import StoredFile

    return StoredFile(address)


def read_start(address: str, size: int) -> bytes:
    """Return the first bytes of the file at an address.

    Raises:
        InputUnreadable: It cannot be had; the subclass says why.
    """
    return remote_file(address).read_start(size)


def fetch(
    address: str,
    folder: Path,
    *,
    weights_of: ExternalWeights = _no_weights,
    on_bytes: ByteProgress = ignore_progress,
    max_bytes: int = MAX_DOWNLOAD_BYTES,
) -> Path:
    """Copy the file at an address, and those that it names beside it, into an empty folder.

    A model without the suffix ``.onnx`` gets it, since programs know models by it.

    Args:
        address: Of the file.
        folder: Receives the files.
        weights_of: Returns the files of external weights that a model names.
        on_bytes: Called with the bytes of a file that have come.
        max_bytes: Of all files together; more is an error.

    Raises:
        InputUnreadable: A file cannot be had; the subclass says why.
    """
    remote = remote_file(address)
    download = _Download(folder, max_bytes, on_bytes)
    path = download.save(remote, file_name(address))
    kind = kind_of_file(path)
    if kind is None:
        return path
    require_whole(address, kind)
    if kind.name == "onnx" and path.suffix.lower() != MODEL_SUFFIX:
        path = path.rename(path.with_name(path.name + MODEL_SUFFIX))
    names = list(weights_of(path)) if kind.name == "onnx" else named_neighbours(path, kind)
    _save_neighbours(download, remote, kind, names)
    return path


def _save_neighbours(
    download: "_Download", remote: RemoteFile, kind: FileKind, names: list[str]
) -> None:
    if len(names) > _MAX_NEIGHBOURS:
        raise InputUnreadable(
            f"names {len(names)} files beside it, expected {_MAX_NEIGHBOURS} or fewer",
            where=remote.address,
            hint="Download its folder, and name the file there.",
        )
    for name in names:
        # A name that leads elsewhere is not fetched: the reader of the file refuses it.
        if not (is_plain_location(name) and download.has_room(name)):
            continue
        neighbour = remote.beside(name)
        if neighbour is None:
            raise InputUnreadable(
                f"is {kind.title} that names the file {name!r:.200} beside it, whose address does "
                "not follow from one with a query",
                where=remote.address,
                hint="Download both files into one folder, and name the file there.",
            )
        download.save(neighbour, name)


@final
class _Download:
    """Saves files below a folder, within a budget of bytes for all of them."""

    def __init__(self, folder: Path, max_bytes: int, on_bytes: ByteProgress) -> None:
        self._folder, self._bytes_left, self._on_bytes = folder, max_bytes, on_bytes

    def has_room(self, name: str) -> bool:
        """Return whether a file of this name was not saved, and can be."""
        path = self._folder / name
        if os.path.lexists(path) or max(map(len, path.parts)) > _MAX_NAME_LENGTH:
            return False
        folders = [folder for folder in path.parents if folder.is_relative_to(self._folder)]
        return all(folder.is_dir() or not os.path.lexists(folder) for folder in folders)

    def save(self, remote: RemoteFile, name: str) -> Path:
        """Copy a file under a relative path."""
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with path.open("xb") as file:
                self._copy(remote, file)
                self._bytes_left -= file.tell()
        except BaseException:
            with suppress(OSError):
                path.unlink()
            raise
        return path

    def _copy(self, remote: RemoteFile, file: BinaryIO) -> None:
        remote.copy(file, max_bytes=self._bytes_left, on_bytes=self._on_bytes)
