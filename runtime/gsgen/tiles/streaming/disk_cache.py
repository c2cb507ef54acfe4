"""A cache of downloaded files on disk, with a cap on its bytes."""

__all__ = ["DiskCache", "default_cache_folder", "digest_in_path"]

import contextlib
import hashlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Lock
from typing import BinaryIO, Final, final

from platformdirs import user_cache_path

from gsgen.tiles.format.uris import DIGEST_IN_PATH

# The lock leaves it one writer; the next one replaces what a killed process left.
_DRAFT_NAME: Final = "draft.tmp"


def default_cache_folder() -> Path:
    """Return the folder of cached tiles, ``gsgen/tiles`` in the user's cache folder."""
    return user_cache_path("gsgen", appauthor=False) / "tiles"


@final
class DiskCache:
    """A disk cache of downloaded files, whose bytes are verified by their SHA-256.

    Where no SHA-256 is given, the file's path has to hold its first digits. Files that may change
    are kept with the validator by which their server knows the version.
    The least recently used files leave first. Several processes may share the folder: each locks
    the file ``FOLDER.lock`` to store a file, and adds the file's bytes to the sum that stands in it.
    A folder that cannot be written is as good as an empty cache.

    Args:
        folder: Made when the first file is stored.
        max_bytes: The most that all files together take.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder, self._max_bytes = folder, max_bytes
        self._lock = Lock()

    @property
    def total_bytes(self) -> int:
        """The number of bytes of all cached files, also of those stored by other processes."""
        return sum(size for _, size, _ in self._files())

    def get(self, store: str, path: str, digest: str | None = None) -> bytes | None:
        """Return the content of a file in the disk cache; None if the file is absent or incomplete.

        Args:
            store: Name of the store.
            path: Of the file in it.
            digest: SHA-256 of the content in hexadecimal; if None, its start is in the path.
        """
        digest = digest or digest_in_path(path)
        if digest is None:
            return None
        file = self._file(store, path)
        try:
            data = file.read_bytes()
            if not hashlib.sha256(data).hexdigest().startswith(digest):
                file.unlink()
                return None
            os.utime(file)
        except OSError:
            return None
        return data

    def put(self, store: str, path: str, data: bytes, digest: str | None = None) -> None:
        """Store a file in the disk cache, unless it may change or is incomplete."""
        digest = digest or digest_in_path(path)
        if digest and hashlib.sha256(data).hexdigest().startswith(digest):
            self._write(self._file(store, path), data)

    def get_version(self, store: str, path: str) -> tuple[str, bytes]:
        """Return the validator and the content of a file that may change; empty if it is absent."""
        file = self._file(store, path)
        with contextlib.suppress(OSError):
            head, _, data = file.read_bytes().partition(b"\n")
            digest, _, validator = head.partition(b" ")
            if hashlib.sha256(validator + data).hexdigest().encode() == digest:
                os.utime(file)
                return validator.decode(), data
        return "", b""

    def put_version(self, store: str, path: str, validator: str, data: bytes) -> None:
        """Store a file that may change, with the validator of its version."""
        if validator:
            digest = hashlib.sha256(validator.encode() + data).hexdigest()
            self._write(self._file(store, path), f"{digest} {validator}\n".encode() + data)

    def _write(self, file: Path, data: bytes) -> None:
        """Store bytes; the least recently used files leave for them."""
        if len(data) > self._max_bytes:
            return
        with self._lock, contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            with self._open_locked_file() as total_file:
                total = self._evict_for_size(_read_total_size(total_file), len(data))
                # Before the file: a crash may count it, but never lose it.
                _write_total_size(total_file, total)
                draft = self._folder / _DRAFT_NAME
                draft.write_bytes(data)
                draft.replace(file)

    @contextlib.contextmanager
    def _open_locked_file(self) -> Iterator[BinaryIO]:
        """Open and lock the file ``FOLDER.lock``, which holds the total of the cached bytes."""
        lock_path = self._folder.with_name(f"{self._folder.name}.lock")
        with open(os.open(lock_path, os.O_RDWR | os.O_CREAT, 0o666), "r+b", buffering=0) as file:
            _lock(file.fileno())  # until the file is closed
            yield file

    def _file(self, store: str, path: str) -> Path:
        return self._folder / hashlib.sha256(f"{store}\n{path}".encode()).hexdigest()

    def _files(self) -> list[tuple[float, int, Path]]:
        """Return the time of last use, size and path of every cached file."""
        files = []
        with contextlib.suppress(OSError):
            for entry in os.scandir(self._folder):
                with contextlib.suppress(OSError):
                    status = entry.stat()
                    files.append((status.st_mtime_ns / 1e9, status.st_size, Path(entry.path)))
        return files

    def _evict_for_size(self, total: int | None, size: int) -> int:
        """Delete the least recently used files until a new file fits; return the new total bytes.

        Args:
            total: Sum of the bytes of all files, or more; None if it is not known.
            size: Bytes of the new file.
        """
        if total is not None and total + size <= self._max_bytes:
            return total + size
        files = sorted(self._files())
        total = sum(length for _, length, _ in files)
        for _, length, file in files:
            if total + size <= self._max_bytes:
                break
            with contextlib.suppress(FileNotFoundError):
                file.unlink()
            total -= length
        return total + size


def digest_in_path(path: str) -> str | None:
    """Return the first digits of a file's SHA-256, if its path holds them."""
    match = DIGEST_IN_PATH.search(path)
    return match[1] if match else None


def _read_total_size(total_file: BinaryIO) -> int | None:
    text = total_file.read(32).strip()
    return int(text) if text.isdigit() else None


def _write_total_size(total_file: BinaryIO, total: int) -> None:
    total_file.seek(0)
    total_file.write(b"%-32d" % total)


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_LOCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX)
