"""Reads a tileset on a web server over a few connections that stay open."""

__all__ = ["HttpStore"]

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from typing import BinaryIO, final
from urllib.parse import quote, unquote, urlsplit

from gsgen.contract.fetching.client import WebClient
from gsgen.contract.fetching.deadline import Deadline
from gsgen.contract.fetching.errors import (
    AddressNotAllowed,
    FetchFailed,
    FileMissing,
    ServerUnavailable,
)
from gsgen.tiles.errors import ContentMissing, Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.stores.store import MAX_STORE_FILE_BYTES, Store


@final
class HttpStore(Store):
    """Reads files below a web address, as :class:`~gsgen.contract.fetching.client.WebClient` does.

    Args:
        address: Of a file in the folder. Its query, such as a signature, is sent for this file
            alone: other files have addresses without one.
        timeout: Seconds for each file; by default those of the client.
        allow_origins: Origins such as ``https://cdn.example.com`` that redirects may lead to.

    Raises:
        TilesetInvalid: The address is malformed.
        ConfigInvalid: An allowed origin is malformed.
    """

    def __init__(
        self, address: str, *, timeout: float | None = None, allow_origins: Sequence[str] = ()
    ) -> None:
        with _translate_faults(address):
            self._client = WebClient(address, seconds=timeout, allow_origins=allow_origins)
        self._deadline: Deadline | None = None
        parts = urlsplit(address)
        folder, _, name = parts.path.rpartition("/")
        self._queries = {unquote(name): f"?{parts.query}"} if parts.query else {}
        self.name = f"{parts.scheme}://{parts.netloc}{folder}"

    def size(self, path: str) -> int:
        """Return the size of a file on the web server in bytes, by a HEAD request."""
        with _translate_faults(self._full_location(path)):
            return self._client.size(self._url_of_path(path))

    def read(
        self,
        path: str,
        *,
        start: int = 0,
        size: int | None = None,
        limit: int = MAX_STORE_FILE_BYTES,
        on_bytes: Callable[[int], None] = lambda count: None,
    ) -> bytes:
        """Read bytes of a file on the web server, see :class:`~gsgen.tiles.stores.store.Store`.

        ``on_bytes`` is called with the number of bytes that have come; an exception that it raises
        ends the request and is passed on.
        """
        if size == 0:
            return b""
        with _translate_faults(self._full_location(path)):
            return self._client.read(
                self._url_of_path(path),
                max_bytes=limit,
                start=start,
                size=size,
                on_bytes=on_bytes,
                deadline=self._deadline,
            )

    def read_version(
        self, path: str, validator: str, limit: int, on_bytes: Callable[[int], None]
    ) -> tuple[bytes | None, str]:
        """Read a whole file unless it is the version of a validator; return that of its version."""
        with _translate_faults(self._full_location(path)):
            return self._client.read_version(
                self._url_of_path(path),
                validator,
                max_bytes=limit,
                on_bytes=on_bytes,
                deadline=self._deadline,
            )

    def save(self, path: str, into: BinaryIO, limit: int = MAX_STORE_FILE_BYTES) -> None:
        """Copy a whole file from the web server into an empty file; errors as in reading."""
        with _translate_faults(self._full_location(path)):
            self._client.copy(
                self._url_of_path(path), into, max_bytes=limit, deadline=self._deadline
            )

    def for_one_tile(self) -> "HttpStore":
        """Return a view of the store whose reads together have the deadline of one file."""
        return self._view(self._client.deadline())

    def for_large_file(self) -> "HttpStore":
        """Return a view of the store whose reads together have the deadline of one large file."""
        return self._view(self._client.deadline(is_large=True))

    def _view(self, deadline: Deadline) -> "HttpStore":
        view = copy(self)
        view._deadline = deadline
        return view

    def _url_of_path(self, path: str) -> str:
        quoted_path = quote(path.encode("utf-8", "surrogatepass"))
        return self._full_location(quoted_path) + self._queries.get(path, "")

    def _full_location(self, path: str) -> str:
        return f"{self.name}/{path}"

    def close(self) -> None:
        """Close all connections to the web server; requests that run end with an error."""
        self._client.close()


@contextmanager
def _translate_faults(location: str) -> Iterator[None]:
    """Translate errors of the web client into those of tilesets."""
    try:
        yield
    except FetchFailed as error:
        kind: type[TilesetInvalid] = TilesetInvalid
        if isinstance(error, FileMissing):
            kind = ContentMissing
        elif isinstance(error, ServerUnavailable):
            kind = StoreUnavailable
        fault = Fault.URI if isinstance(error, AddressNotAllowed) else Fault.CONTENT
        raise kind(error.message, location=location, hint=error.hint, fault=fault) from error
