"""Reads the files of a tileset in a folder."""

__all__ = ["FolderStore"]

import stat
from pathlib import Path
from typing import final

from gsgen.tiles.errors import Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.stores.store import MAX_STORE_FILE_BYTES, Store, check_range, missing


@final
class FolderStore(Store):
    """Reads files of a folder; links that lead out of it are refused."""

    def __init__(self, folder: Path) -> None:
        self.name = str(folder)
        self._folder = folder
        self._resolved_folder = folder.resolve()

    def size(self, path: str) -> int:
        """Return the bytes of a file in the folder."""
        return self._open_checked_file(path)[1]

    def read(
        self,
        path: str,
        *,
        start: int = 0,
        size: int | None = None,
        limit: int = MAX_STORE_FILE_BYTES,
    ) -> bytes:
        """Read bytes of a file in the folder, see :class:`~gsgen.tiles.stores.store.Store`."""
        file, whole = self._open_checked_file(path)
        count = check_range(self.name, path, whole, start, size, limit)
        try:
            with file.open("rb") as stream:
                stream.seek(start)
                return stream.read(count)
        except OSError as error:
            raise self._unreadable_file_error(path, error) from error

    def _open_checked_file(self, path: str) -> tuple[Path, int]:
        """Return the path and size of a regular file in the folder; raise for any other file."""
        file = self._folder / path
        try:
            status = file.stat()
            is_inside_folder = file.resolve().is_relative_to(self._resolved_folder)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise missing(self.name, path) from error
        except (OSError, ValueError) as error:
            raise self._unreadable_file_error(path, error) from error
        if not is_inside_folder:
            raise TilesetInvalid(
                "the path is a link that leads out of the folder",
                location=f"{self.name}: {path}",
                expected="a file within the folder of the tileset",
                fault=Fault.URI,
            )
        if not stat.S_ISREG(status.st_mode):
            raise missing(self.name, path, "it is a folder, device or pipe")
        return file, status.st_size

    def _unreadable_file_error(self, path: str, error: OSError | ValueError) -> StoreUnavailable:
        reason = getattr(error, "strerror", None) or str(error)
        return StoreUnavailable(
            f"cannot be read: {reason}",
            location=f"{self.name}: {path}",
            expected="a file that can be read",
            fault=Fault.CONTENT,
        )
