"""Reads a tileset on a web server over a few connections that stay open."""

__all__ = ["HttpStore"]

import random
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, final
from urllib.parse import quote, urljoin, urlsplit

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
_REDIRECTS = (301, 302, 303, 307, 308)
_MOST_REDIRECTS = 5


@final
class HttpStore(Store):
    """Reads files below a web address.

    Errors of the server, connections that break and answers that are cut short are tried three
    times more, at growing distance, or when ``Retry-After`` says so. Redirects are followed
    within the origin, and to the allowed ones.

    Args:
        address: Of a file in the folder.
        timeout: Seconds without a byte after which an attempt fails; 30 where absent.
        allow_origins: Origins such as ``https://cdn.example.com`` that redirects may lead to.
    """

    def __init__(
        self, address: str, *, timeout: float | None = None, allow_origins: Sequence[str] = ()
    ) -> None:
        try:
            from urllib3 import PoolManager, Retry, Timeout
        except ImportError as error:
            raise ConfigInvalid(
                "urllib3 is not installed", where=address, hint="pip install 'gsgen[tiles]'"
            ) from error
        timeout = _TIMEOUT if timeout is None else timeout
        parts = urlsplit(address)
        folder = parts.path.rpartition("/")[0]
        self.name = f"{parts.scheme}://{parts.netloc}{folder}"
        self._origins = {_origin(address), *map(_origin, allow_origins)}
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
                raise self._read_error(path, "the server's response has no Content-Length")
            return int(length)

    def read(
        self, path: str, *, start: int = 0, size: int | None = None, limit: int = MAX_FILE
    ) -> bytes:
        """Read bytes of a file on the web server, see :class:`~gsgen.tiles.stores.store.Store`."""
        if size == 0:
            return b""
        return self._read_with_retries(lambda: self._read(path, start, size, limit))

    def read_whole(
        self, path: str, on_bytes: Callable[[int], None], limit: int = MAX_FILE
    ) -> bytes:
        """Read a whole file from the web server, and report the progress.

        Args:
            path: Relative to the folder.
            on_bytes: Called with the number of bytes that have come; an exception that it raises
                ends the request and is passed on.
            limit: The most that is read.

        Raises:
            ContentMissing: There is no such file.
            StoreUnavailable: The server cannot be read now.
            TilesetInvalid: The file is larger than ``limit``.
        """

        def attempt() -> bytes:
            on_bytes(0)
            with self._request("GET", path, {"Accept-Encoding": "identity"}) as response:
                return self._read_body(response, path, limit, None, on_bytes)

        return self._read_with_retries(attempt)

    def _read_with_retries(self, attempt: Callable[[], bytes]) -> bytes:
        """Read from the web server, again if a response ends before all bytes have come."""
        for index in range(_RETRIES):
            try:
                return attempt()
            except _IncompleteResponse:
                time.sleep(_BACKOFF * 2**index + random.uniform(0, _BACKOFF))
        return attempt()

    def _read(self, path: str, start: int, size: int | None, limit: int) -> bytes:
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
            data = self._read_body(response, path, limit + (0 if partial else start), count)
        return data if partial or not start else data[start:]

    def _read_body(
        self,
        response: "BaseHTTPResponse",
        path: str,
        limit: int,
        count: int | None,
        on_bytes: Callable[[int], None] = lambda received: None,
    ) -> bytes:
        """Read at most ``count`` bytes of an HTTP response; raise above ``limit``."""
        from urllib3.exceptions import HTTPError

        body = bytearray()
        try:
            for chunk in response.stream(_CHUNK):
                body += chunk
                on_bytes(len(body))
                if count is not None and len(body) >= count:
                    break
                if len(body) > limit:
                    raise too_large(self.name, path, len(body), limit)
        except HTTPError as error:
            raise _IncompleteResponse(
                f"the web server's response ended early ({error})",
                location=f"{self.name}/{path}",
                expected="the whole file",
                hint="Load the file again; if it fails again, check the server's log.",
                fault=Fault.CONTENT,
            ) from error
        return bytes(body if count is None else body[:count])

    def _request(self, method: str, path: str, headers: dict[str, str]) -> "_Response":
        from urllib3.exceptions import HTTPError

        address = f"{self.name}/{quote(path)}"
        for _ in range(_MOST_REDIRECTS + 1):
            try:
                response = self._pool.request(
                    method, address, headers=headers, preload_content=False, redirect=False
                )
            except HTTPError as error:
                raise self._read_error(path, f"the server gives no answer ({error})") from error
            if response.status not in _REDIRECTS:
                break
            response.drain_conn()
            address = self._redirect_address(path, address, response.headers.get("Location", ""))
        else:
            raise self._read_error(path, f"more than {_MOST_REDIRECTS} redirects")
        if response.status in (200, 206, 416):
            return _Response(response)
        response.drain_conn()
        if response.status in _NOT_FOUND:
            raise missing(self.name, path, f"the server answers {response.status}")
        raise self._read_error(path, f"the server answers {response.status}")

    def _redirect_address(self, path: str, address: str, location: str) -> str:
        """Return the address of an HTTP redirect; raise if the address has another origin."""
        target = urljoin(address, location)
        if not location or _origin(target) not in self._origins:
            raise TilesetInvalid(
                f"the server redirects to {target!r:.200}",
                location=f"{self.name}/{path}",
                expected=f"an address of {' or '.join(sorted(self._origins))}",
                hint=f"Trust it with --allow-origin {_origin(target)}.",
                fault=Fault.URI,
            )
        return target

    def _read_error(self, path: str, actual: str) -> TilesetInvalid:
        return StoreUnavailable(
            actual, location=f"{self.name}/{path}", expected="the file", fault=Fault.CONTENT
        )

    def close(self) -> None:
        """Close all connections to the web server."""
        self._pool.clear()


def _origin(address: str) -> str:
    """Return the scheme, host and port of a web address."""
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.netloc}".lower()


class _IncompleteResponse(StoreUnavailable):
    """Raised if an HTTP response ended before all bytes had come."""


@final
class _Response:
    """An HTTP response; its connection is reused, or closed if bytes of the response remain."""

    def __init__(self, response: "BaseHTTPResponse") -> None:
        self._response = response

    def __enter__(self) -> "BaseHTTPResponse":
        return self._response

    def __exit__(self, *_: object) -> None:
        self._response.close()
        self._response.release_conn()
