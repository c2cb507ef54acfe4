"""A client of web servers, with a deadline and a byte budget for each file."""

__all__ = ["WebClient", "fetch"]

import io
import random
import socket
import ssl
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from http.client import HTTPResponse
from typing import BinaryIO, Final, TypeVar, final
from urllib.parse import urljoin

from gsgen.contract.fetching.addresses import WebAddress, parse_address, parse_origin
from gsgen.contract.fetching.connections import CONNECTION_ERRORS, ConnectionPool, WebConnection
from gsgen.contract.fetching.deadline import (
    FETCH_SECONDS,
    Deadline,
    NotPublicHostError,
    fetch_seconds,
    large_file_deadline,
)
from gsgen.contract.fetching.errors import AddressNotAllowed, ServerUnavailable
from gsgen.contract.fetching.response_body import body_chunks
from gsgen.contract.fetching.responses import FilePart, check_status

_SECONDS: Final = 60.0  # for one file, all attempts together
_STALL_SECONDS: Final = 8.0  # for the headers, and for each kilobyte after them
_MAX_RETRY_COUNT: Final = 4
_BACKOFF_SECONDS: Final = 0.25
_MAX_REDIRECTS: Final = 5
_REDIRECT_STATUSES: Final = (301, 302, 303, 307, 308)
_MAX_UNDECLARED_BYTES: Final = 32 << 20
"""Most bytes in memory of a response that is compressed, or does not declare its length."""

_MAX_VALIDATOR: Final = 1000  # characters
_PERMANENT_ERRORS: Final = (ssl.SSLError, ConnectionRefusedError, socket.gaierror)
"""Failures to connect that another attempt would meet, too."""

Result = TypeVar("Result")
ByteProgressCallback = Callable[[int], None]
SizeProgressCallback = Callable[[int, int | None], None]
"""Called with the bytes of a file that have come, and with its size where the server tells it."""


def _ignore_bytes(received: int) -> None:
    """Report no progress."""


def _ignore_size(received: int, total: int | None) -> None:
    """Report no progress."""


def fetch(
    address: str,
    *,
    max_bytes: int,
    seconds: float | None = None,
    headers: Mapping[str, str] | None = None,
    allow_origins: Sequence[str] = (),
) -> bytes:
    """Return the bytes of a file on a web server.

    Args:
        address: Of the file, http or https.
        max_bytes: More is an error.
        seconds: For all attempts together; ``GSGEN_FETCH_SECONDS``, or else 60, where absent.
        headers: Sent to the origin of the address, and to no other.
        allow_origins: Other origins that redirects may lead to.

    Raises:
        FetchFailed: The file cannot be had; the subclass says why.
    """
    with WebClient(
        address, seconds=seconds, headers=headers, allow_origins=allow_origins
    ) as client:
        return client.read(address, max_bytes=max_bytes)


@final
class WebClient:
    """Reads files of one origin over connections that stay open; safe to use from many threads.

    Errors of the server, connections that break and bodies that are cut short are tried four
    times more, at growing distance, or when ``Retry-After`` says so. All attempts for a file end
    at one deadline, and an attempt ends when the headers, or a kilobyte after them, take more than
    eight seconds. Redirects are followed within the origin, and to the allowed ones; of a trusted
    server also to any public host over https, but to none in a private network. Bodies of errors
    are not read.

    Args:
        home_address: An address of the origin.
        seconds: For each file; ``GSGEN_FETCH_SECONDS``, or else 60, where absent.
        headers: Sent to the origin, and to no other.
        allow_origins: Other origins that redirects may lead to.
        allow_public_hosts: Whether redirects may lead to other ports of the server's host, and over
            https to hosts whose addresses are all public, as those of a hub to its storage do.

    Raises:
        AddressNotAllowed: ``home_address`` is malformed.
        ConfigInvalid: An allowed origin or ``GSGEN_FETCH_SECONDS`` is malformed.
    """

    def __init__(
        self,
        home_address: str,
        *,
        seconds: float | None = None,
        headers: Mapping[str, str] | None = None,
        allow_origins: Sequence[str] = (),
        allow_public_hosts: bool = False,
    ) -> None:
        self._home_origin = _parse_address(home_address).origin
        self._allowed_origins = {self._home_origin} | {
            parse_origin(origin, "--allow-origin") for origin in allow_origins
        }
        self._allow_public_hosts = allow_public_hosts
        self._headers = dict(headers or {})
        self._seconds = seconds
        self._stall_seconds = min(self.deadline().seconds, _STALL_SECONDS)
        self._pool = ConnectionPool()

    def size(self, address: str) -> int:
        """Return the size of a file in bytes, by a HEAD request.

        Raises:
            FetchFailed: The server does not tell the size.
        """
        deadline = self.deadline()

        def attempt() -> int:
            with self._open_response("HEAD", address, {}, deadline) as (response, _):
                length = response.getheader("Content-Length")
                if length is None:
                    raise ServerUnavailable(
                        "the server's response has no Content-Length", where=address
                    )
                return int(length)

        return self._fetch_with_retries(attempt, deadline)

    def read(
        self,
        address: str,
        *,
        max_bytes: int,
        start: int = 0,
        size: int | None = None,
        on_bytes: ByteProgressCallback = _ignore_bytes,
        deadline: Deadline | None = None,
    ) -> bytes:
        """Return the bytes of a file on a web server, or a range of them.

        Args:
            address: Of the file.
            max_bytes: More is an error. A response that is compressed, or does not declare its
                length, may have 32 MiB.
            start: The first byte.
            size: How many; all that follow where absent. Fewer come where the file ends.
            on_bytes: Called with the number of bytes that have come; an exception that it raises
                ends the request and is passed on.
            deadline: Of several files together; by default each has its own.

        Raises:
            FetchFailed: The file cannot be had; the subclass says why.
        """
        part = FilePart(
            address=address,
            start=start,
            size=size,
            max_bytes=max_bytes,
            max_undeclared=_MAX_UNDECLARED_BYTES,
        )
        return self._read_part(part, on_bytes, deadline)[0]

    def read_version(
        self,
        address: str,
        validator: str,
        *,
        max_bytes: int,
        on_bytes: ByteProgressCallback = _ignore_bytes,
        deadline: Deadline | None = None,
    ) -> tuple[bytes | None, str]:
        """Return the bytes of a file, and the validator of this version; None if they are the same.

        The validator is empty if the server tells none, or forbids to store the file.

        Args:
            address: Of the file.
            validator: Of the version that is there, its ``ETag`` or date; empty without one.
            max_bytes: As in :meth:`read`.
            on_bytes: As in :meth:`read`.
            deadline: As in :meth:`read`.
        """
        part = FilePart(
            address=address,
            max_bytes=max_bytes,
            max_undeclared=_MAX_UNDECLARED_BYTES,
            validator=validator,
        )
        data, response = self._read_part(part, on_bytes, deadline)
        if response.status == 304:
            return None, validator
        version = response.getheader("ETag") or response.getheader("Last-Modified") or ""
        is_ascii = version.isascii() and version.isprintable() and len(version) <= _MAX_VALIDATOR
        may_keep = "no-store" not in response.getheader("Cache-Control", "").lower()
        return data, version if is_ascii and may_keep else ""

    def _read_part(
        self, part: FilePart, on_bytes: ByteProgressCallback, deadline: Deadline | None
    ) -> tuple[bytes, HTTPResponse]:
        data = io.BytesIO()
        response = self._copy_response_body(
            part, data, lambda received, _: on_bytes(received), deadline or self.deadline()
        )
        return data.getvalue(), response

    def copy(
        self,
        address: str,
        into: BinaryIO,
        *,
        max_bytes: int,
        on_bytes: SizeProgressCallback = _ignore_size,
        deadline: Deadline | None = None,
    ) -> None:
        """Copy a file of a web server into an empty file on disk.

        Args:
            address: Of the file.
            into: Receives the bytes; emptied before each attempt.
            max_bytes: More is an error.
            on_bytes: Called with the number of bytes that have come, and with that of the file.
            deadline: Of several files together; by default each has its own.

        Raises:
            FetchFailed: The file cannot be had; the subclass says why.
        """
        part = FilePart(address=address, max_bytes=max_bytes, max_undeclared=max_bytes)
        self._copy_response_body(part, into, on_bytes, deadline or self.deadline())

    def _copy_response_body(
        self, part: FilePart, into: BinaryIO, on_bytes: SizeProgressCallback, deadline: Deadline
    ) -> HTTPResponse:
        def attempt() -> HTTPResponse:
            into.seek(0)
            into.truncate()
            on_bytes(0, None)
            with self._open_response("GET", part.address, part.headers, deadline) as answer:
                response = answer[0]
                if response.status in (304, 416):
                    return response
                # A coded body has another length than the file.
                total = None if response.getheader("Content-Encoding") else response.length
                before, budget = part.bytes_before(response), part.budget(response)
                chunks = self._chunks(answer, deadline, part.address, before + budget)
                for piece in part.select(chunks, before, budget):
                    into.write(piece)
                    on_bytes(into.tell(), total)
                return response

        return self._fetch_with_retries(attempt, deadline)

    def close(self) -> None:
        """Close all connections; requests that run end with an error."""
        self._pool.close()

    def __enter__(self) -> "WebClient":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def deadline(self, *, is_large: bool = False) -> Deadline:
        """Return the deadline of a file that is requested now.

        Args:
            is_large: Whether it is a model or a file of many splats, which may take an hour where
                the user sets no time.
        """
        if self._seconds is not None:
            return Deadline(self._seconds)
        return large_file_deadline() if is_large else Deadline(fetch_seconds(_SECONDS))

    def _fetch_with_retries(self, attempt: Callable[[], Result], deadline: Deadline) -> Result:
        """Try a request again after transient failures, until the deadline of its file."""
        for backoff in [*(_BACKOFF_SECONDS * 2**index for index in range(_MAX_RETRY_COUNT)), 0.0]:
            try:
                return attempt()
            except ServerUnavailable as error:
                wait = max(error.retry_after, backoff + random.uniform(0, _BACKOFF_SECONDS))
                can_retry_request = error.is_transient and backoff and not self._pool.is_closed
                if not (can_retry_request and wait < deadline.remaining):
                    raise
            time.sleep(wait)
        raise AssertionError("the last attempt returns or raises")

    @contextmanager
    def _open_response(
        self, method: str, address: str, headers: Mapping[str, str], deadline: Deadline
    ) -> Iterator[tuple[HTTPResponse, WebConnection]]:
        """Send a request, follow its redirects, and release the connection in the end."""
        target, current_address = _parse_address(address), address
        for _ in range(_MAX_REDIRECTS + 1):
            connection, response = self._send_request(method, target, address, headers, deadline)
            try:
                if response.status not in _REDIRECT_STATUSES:
                    check_status(response, address, headers)
                    yield response, connection
                    return
                location = response.getheader("Location", "")
            finally:
                self._pool.release(connection, response)
            target, current_address = self._redirect_target(address, current_address, location)
        raise ServerUnavailable(f"more than {_MAX_REDIRECTS} redirects", where=address)

    def _send_request(
        self,
        method: str,
        target: WebAddress,
        address: str,
        headers: Mapping[str, str],
        deadline: Deadline,
    ) -> tuple[WebConnection, HTTPResponse]:
        """Send a request, and return its response, whose body was not read."""
        origin_headers = self._headers if target.origin == self._home_origin else {}
        sent_headers = {"User-Agent": "gsgen", **origin_headers, **headers}
        while True:
            with self._translate_failures(address, deadline):
                must_be_public = target.origin not in self._allowed_origins and (
                    target.origin.host != self._home_origin.host
                )
                connection = self._pool.take(target.origin, must_be_public=must_be_public)
            is_reused = connection.is_reused
            try:
                with self._translate_failures(address, deadline):
                    response = connection.ask(
                        method, target.target, sent_headers, deadline.within(self._stall_seconds)
                    )
            except BaseException as error:
                self._pool.release(connection, None)
                # The server may have closed an idle connection: that is not a failed attempt.
                if is_reused and isinstance(error, ServerUnavailable) and error.is_transient:
                    continue
                raise
            return connection, response

    def _redirect_target(
        self, address: str, current_address: str, location: str
    ) -> tuple[WebAddress, str]:
        """Return the address of an HTTP redirect; raise if its origin is not allowed."""
        allowed = " or ".join(sorted(map(str, self._allowed_origins)))
        try:
            redirected_address = urljoin(current_address, location)
            target = parse_address(redirected_address) if location else None
        except ValueError:
            target = None
        if target is None:
            raise AddressNotAllowed(
                f"the server redirects to {location!r:.200}; expected an address of {allowed}",
                where=address,
            )
        if not self._may_follow(target):
            raise AddressNotAllowed(
                f"the server redirects to {redirected_address!r:.200}; expected an address of {allowed}",
                where=address,
                hint=f"If you trust it, name that address, or a tileset with --allow-origin {target.origin}.",
            )
        return target, redirected_address

    def _may_follow(self, target: WebAddress) -> bool:
        """Return whether a redirect may lead to an address; see ``allow_public_hosts``."""
        if target.origin in self._allowed_origins:
            return True
        is_encrypted = target.origin.scheme == "https"
        is_home_host = target.origin.host == self._home_origin.host
        is_home_scheme = target.origin.scheme == self._home_origin.scheme
        return self._allow_public_hosts and (is_encrypted or (is_home_host and is_home_scheme))

    def _chunks(
        self,
        answer: tuple[HTTPResponse, WebConnection],
        deadline: Deadline,
        address: str,
        max_bytes: int,
    ) -> Iterator[bytes]:
        """Yield the pieces of a response's body."""
        response, connection = answer
        chunks = body_chunks(
            response, connection.wire, deadline, stall=self._stall_seconds, max_bytes=max_bytes
        )
        while True:
            with self._translate_failures(address, deadline, has_begun=True):
                chunk = next(chunks, None)
            if chunk is None:
                return
            yield chunk

    @contextmanager
    def _translate_failures(
        self, address: str, deadline: Deadline, *, has_begun: bool = False
    ) -> Iterator[None]:
        """Translate exceptions of sockets and ``http.client`` into those of this room."""
        start = (
            "the web server's response ended early" if has_begun else "the server gives no answer"
        )
        try:
            yield
        except NotPublicHostError as error:
            raise AddressNotAllowed(
                f"the server redirects to {error}; expected a public host", where=address
            ) from error
        except TimeoutError as error:
            if deadline.remaining <= 0:
                text = f"the file did not come within {deadline.seconds:g} s"
            elif has_begun:
                text = f"less than a kilobyte came within {self._stall_seconds:g} s"
            else:
                text = f"{start} within {self._stall_seconds:g} s"
            raise ServerUnavailable(
                text, where=address, hint=f"{FETCH_SECONDS} sets the seconds for a file."
            ) from error
        except CONNECTION_ERRORS as error:
            reason = ascii(str(error) or type(error).__name__)[1:-1]  # it may quote the server
            raise ServerUnavailable(
                f"{start} ({reason:.200})",
                where=address,
                is_transient=not isinstance(error, _PERMANENT_ERRORS),
            ) from error


def _parse_address(address: str) -> WebAddress:
    try:
        return parse_address(address)
    except ValueError as error:
        raise AddressNotAllowed(f"is not a web address: {error}", where=address) from error
