"""A file of a store as a seekable file, of which only the ranges that are read are fetched."""

__all__ = ["RangedFile"]

import io
from typing import TYPE_CHECKING, final

from gsgen.tiles.stores.store import Store

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer


@final
class RangedFile(io.RawIOBase):
    """A file of a store, for code that reads files: each read is a request for a range.

    The store belongs to the file, and is closed with it.

    Raises:
        ContentMissing: There is no such file.
        StoreUnavailable: The store cannot be read now.
    """

    def __init__(self, store: Store, path: str) -> None:
        self._store, self._path = store, path
        self._size, self._position = store.size(path), 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position of the next read."""
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the position of the next read; nothing is fetched."""
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        if start + offset < 0:
            raise ValueError(f"the position {start + offset} is before the file")
        self._position = start + offset
        return self._position

    def readinto(self, buffer: "WriteableBuffer") -> int:
        """Fetch as many bytes as fit into a buffer, at the position; return their number."""
        view = memoryview(buffer).cast("B")
        data = self.read_at(self._position, len(view))
        view[: len(data)] = data
        self._position += len(data)
        return len(data)

    def read_at(self, start: int, count: int) -> bytes:
        """Fetch a range, whatever the position is; safe to call from several threads."""
        count = min(count, self._size - start)
        return self._store.read(self._path, start=start, size=count) if count > 0 else b""

    def close(self) -> None:
        """Close the file and its store."""
        if not self.closed:
            self._store.close()
        super().close()
