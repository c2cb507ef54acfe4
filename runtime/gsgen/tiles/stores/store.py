"""The base class of file stores, which read a tileset's files by path within size limits."""

__all__ = ["MAX_STORE_FILE_BYTES", "Store", "check_range", "missing", "too_large"]

from abc import ABC, abstractmethod
from typing import Final, Self

from gsgen.tiles.errors import ContentMissing, Fault, TilesetInvalid

MAX_STORE_FILE_BYTES: Final = 1 << 30
"""The most bytes that are read of one file, unless the caller sets a lower limit."""


class Store(ABC):
    """Base class of file stores: reads files by their paths relative to a folder, from many threads.

    Attributes:
        name: The folder, archive or address, for messages.
    """

    name: str

    @abstractmethod
    def size(self, path: str) -> int:
        """Return the size of a tileset's file in bytes.

        Raises:
            ContentMissing: There is no such file.
            StoreUnavailable: The store cannot be read now.
        """

    @abstractmethod
    def read(
        self,
        path: str,
        *,
        start: int = 0,
        size: int | None = None,
        limit: int = MAX_STORE_FILE_BYTES,
    ) -> bytes:
        """Return the bytes of a file of a tileset, or a range of the bytes.

        Args:
            path: Relative to the folder.
            start: The first byte.
            size: How many; all that follow where absent. Fewer come where the file ends.
            limit: The most that is read; more is an error.

        Raises:
            ContentMissing: There is no such file.
            StoreUnavailable: The store cannot be read now.
            TilesetInvalid: The file is larger than ``limit``, or damaged.
        """

    def for_one_tile(self) -> "Store":
        """Return a view of the store whose reads together have the deadline of one file."""
        return self

    def for_large_file(self) -> "Store":
        """Return a view of the store whose reads together have the deadline of one large file."""
        return self

    def close(self) -> None:  # noqa: B027  # a store of plain files has nothing to close
        """Close the open files and connections of a file store."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def missing(store: str, path: str, reason: str = "the file does not exist") -> ContentMissing:
    """Return the error for a tileset file that does not exist."""
    return ContentMissing(
        reason,
        location=_location(store, path),
        expected="a file that can be read",
        hint="Copy or build the tileset again: a part of it is missing.",
        fault=Fault.CONTENT,
    )


def _location(store: str, path: str) -> str:
    """Return where a file is, for messages: its URL, or a folder or archive and the path in it."""
    return f"{store}/{path}" if "://" in store else f"{store}: {path}"


def too_large(store: str, path: str, size: int, limit: int) -> TilesetInvalid:
    """Return the error for a tileset file above the size limit."""
    return TilesetInvalid(
        f"{size:,} bytes",
        location=_location(store, path),
        expected=f"{limit:,} bytes or fewer",
        fault=Fault.CONTENT,
    )


def check_range(store: str, path: str, whole: int, start: int, size: int | None, limit: int) -> int:
    """Return the number of bytes to read of a tileset's file; raise above the size limit."""
    count = max(whole - start, 0) if size is None else max(min(size, whole - start), 0)
    if count > limit:
        raise too_large(store, path, count, limit)
    return count
