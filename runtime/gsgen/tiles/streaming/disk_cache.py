"""A cache of downloaded files on disk, with a cap on its bytes."""

__all__ = ["DiskCache", "default_cache_folder"]

import contextlib
import hashlib
import os
import re
import tempfile
from pathlib import Path
from threading import Lock
from typing import Final, final

_NAMED_BY_DIGEST: Final = re.compile(r"-([0-9a-f]{8})\.glb$")


def default_cache_folder() -> Path:
    """Return the folder of cached tiles, ``gsgen/tiles`` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "gsgen" / "tiles"


@final
class DiskCache:
    """A disk cache of downloaded files whose names contain a digest of their bytes.

    The least recently used files leave first. Several processes may share the folder. A folder
    that cannot be written is as good as an empty cache.

    Args:
        folder: Made when the first file is stored.
        max_bytes: The most that all files together take.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder, self._max_bytes = folder, max_bytes
        self._lock = Lock()
        self._total = sum(size for _, size, _ in self._files())

    @property
    def total_bytes(self) -> int:
        """The bytes of all cached files, as far as this process knows."""
        return self._total

    def get(self, store: str, path: str) -> bytes | None:
        """Return the content of a file in the disk cache; None if the file is absent or incomplete.

        Args:
            store: Name of the store.
            path: Of the file in it.
        """
        match = _NAMED_BY_DIGEST.search(path)
        if match is None:
            return None
        file = self._file(store, path)
        try:
            data = file.read_bytes()
            if hashlib.sha256(data).hexdigest()[:8] != match[1]:
                self._remove(file, len(data))
                return None
            os.utime(file)
        except OSError:
            return None
        return data

    def put(self, store: str, path: str, data: bytes) -> None:
        """Store a file in the disk cache, unless it may change or is incomplete."""
        match = _NAMED_BY_DIGEST.search(path)
        if match is None or len(data) > self._max_bytes:
            return
        if hashlib.sha256(data).hexdigest()[:8] != match[1]:
            return
        file = self._file(store, path)
        with self._lock:
            self._make_room(len(data))
            with contextlib.suppress(OSError):
                self._folder.mkdir(parents=True, exist_ok=True)
                before = file.stat().st_size if file.exists() else 0
                handle, draft = tempfile.mkstemp(dir=self._folder, suffix=".tmp")
                with os.fdopen(handle, "wb") as stream:
                    stream.write(data)
                os.replace(draft, file)
                self._total += len(data) - before

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

    def _make_room(self, size: int) -> None:
        if self._total + size <= self._max_bytes:
            return
        files = sorted(self._files())
        self._total = sum(entry[1] for entry in files)  # other processes write, too
        for _, length, file in files:
            if self._total + size <= self._max_bytes:
                break
            self._remove(file, length)

    def _remove(self, file: Path, size: int) -> None:
        with contextlib.suppress(OSError):
            file.unlink()
            self._total -= size
