"""A seekable file of a tile store that fetches only the byte ranges that are read."""

__all__ = ["RangedFile"]

import io
from typing import TYPE_CHECKING, final

from gsgen.tiles.stores.store import Store

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer


@final
class RangedFile(io.RawIOBase):
    """A seekable file of a tile store; each read requests one byte range of the file.

    The store belongs to the file, and is closed with it.

    Raises:
        ContentMissing: There is no such file.
        StoreUnavailable: The store cannot be read now.
    """

    def __init__(self, store: Store, path: str) -> None:
        self._store, self._store_path = store, path
        self._size, self._position = store.size(path), 0

    def readable(self) -> bool:
        """Return True, since every file of a tile store can be read."""
        return True

    def seekable(self) -> bool:
        """Return True, since a tile store reads files from any byte position."""
        return True

    def tell(self) -> int:
        """Return the byte position in the file of the next read."""
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the byte position of the file's next read, without fetching anything."""
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        if start + offset < 0:
            raise ValueError(f"the file position is {start + offset}; expected 0 or more")
        self._position = start + offset
        return self._position

    def readinto(self, buffer: "WriteableBuffer") -> int:
        """Fetch the file's next bytes into a buffer; return the number of bytes read."""
        view = memoryview(buffer).cast("B")
        data = self.read_at(self._position, len(view))
        view[: len(data)] = data
        self._position += len(data)
        return len(data)

    def read_at(self, start: int, count: int) -> bytes:
        """Fetch a byte range independently of the file position; safe on several threads."""
        count = min(count, self._size - start)
        return self._store.read(self._store_path, start=start, size=count) if count > 0 else b""

    def close(self) -> None:
        """Close the file, and the tile store that the file is read from."""
        if not self.closed:
            self._store.close()
        super().close()
