"""Reads a tileset on a web server over a few connections that stay open."""

__all__ = ["HttpStore"]

from typing import TYPE_CHECKING, Final, final
from urllib.parse import quote, urlsplit

from gsgen.contract.errors import ConfigInvalid
from gsgen.tiles.errors import Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.stores.store import MAX_FILE, Store, missing, too_large

if TYPE_CHECKING:
    from urllib3 import BaseHTTPResponse

CONNECTIONS: Final = 6
_TIMEOUT = 30.0
_RETRIES = 3
_BACKOFF = 0.25
_CHUNK = 1 << 18
_NOT_FOUND = (404, 410)
_TRANSIENT = (429, 500, 502, 503, 504)


@final
class HttpStore(Store):
    """Reads files below a web address.

    Errors of the server and connections that break are tried three times more, at growing
    distance, or when ``Retry-After`` says so.
    """

    def __init__(self, address: str, *, timeout: float = _TIMEOUT) -> None:
        try:
            from urllib3 import PoolManager, Retry, Timeout
        except ImportError as error:
            raise ConfigInvalid(
                "urllib3 is not installed", where=address, hint="pip install 'gsgen[tiles]'"
            ) from error
        parts = urlsplit(address)
        folder = parts.path.rpartition("/")[0]
        self.name = f"{parts.scheme}://{parts.netloc}{folder}"
        retries = Retry(
            _RETRIES,
            backoff_factor=_BACKOFF,
            backoff_jitter=_BACKOFF,
            status_forcelist=_TRANSIENT,
            raise_on_status=False,
        )
        self._pool = PoolManager(
            num_pools=2,
            maxsize=CONNECTIONS,
            retries=retries,
            timeout=Timeout(connect=timeout, read=timeout),
        )

    def size(self, path: str) -> int:
        """Return the size of a file on the web server in bytes, by a HEAD request."""
        with self._request("HEAD", path, {}) as response:
            length = response.headers.get("Content-Length", "")
            if not length.isdigit():
                raise self._failed(path, "the answer has no Content-Length")
            return int(length)

    def read(
        self, path: str, *, start: int = 0, size: int | None = None, limit: int = MAX_FILE
    ) -> bytes:
        """Read bytes of a file on the web server, see :class:`~gsgen.tiles.stores.store.Store`."""
        if size == 0:
            return b""
        ranged = start > 0 or size is not None
        last = "" if size is None else str(start + size - 1)
        # Whole files keep their coding; a range is of the bytes as they are stored.
        headers = {"Accept-Encoding": "identity"}
        if ranged:
            headers["Range"] = f"bytes={start}-{last}"
        with self._request("GET", path, headers) as response:
            if response.status == 416:
                return b""
            partial = ranged and response.status == 206
            count = None if size is None else size + (0 if partial else start)
            data = self._body(response, path, limit + (0 if partial else start), count)
        return data if partial or not start else data[start:]

    def _body(
        self, response: "BaseHTTPResponse", path: str, limit: int, count: int | None
    ) -> bytes:
        """Read at most ``count`` bytes of an HTTP response; raise above ``limit``."""
        from urllib3.exceptions import HTTPError

        body = bytearray()
        try:
            for chunk in response.stream(_CHUNK):
                body += chunk
                if count is not None and len(body) >= count:
                    break
                if len(body) > limit:
                    raise too_large(self.name, path, len(body), limit)
        except HTTPError as error:
            raise self._failed(path, f"the answer broke off ({error})") from error
        return bytes(body if count is None else body[:count])

    def _request(self, method: str, path: str, headers: dict[str, str]) -> "_Answer":
        from urllib3.exceptions import HTTPError

        address = f"{self.name}/{quote(path)}"
        try:
            response = self._pool.request(
                method, address, headers=headers, preload_content=False, redirect=False
            )
        except HTTPError as error:
            raise self._failed(path, f"no answer ({error})") from error
        if response.status in (200, 206, 416):
            return _Answer(response)
        response.drain_conn()
        if response.status in _NOT_FOUND:
            raise missing(self.name, path, f"the server answers {response.status}")
        raise self._failed(path, f"the server answers {response.status}")

    def _failed(self, path: str, actual: str) -> TilesetInvalid:
        return StoreUnavailable(
            actual, location=f"{self.name}/{path}", expected="the file", fault=Fault.CONTENT
        )

    def close(self) -> None:
        """Close all connections to the web server."""
        self._pool.clear()


@final
class _Answer:
    """An HTTP response; its connection returns to the pool, or is closed if bytes remain."""

    def __init__(self, response: "BaseHTTPResponse") -> None:
        self._response = response

    def __enter__(self) -> "BaseHTTPResponse":
        return self._response

    def __exit__(self, *_: object) -> None:
        self._response.close()
        self._response.release_conn()
