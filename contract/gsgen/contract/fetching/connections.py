"""Connections to web servers that send requests and read headers within a deadline."""

__all__ = ["CONNECTION_ERRORS", "ConnectionPool", "WebConnection"]

import http.client
from threading import Lock
from typing import Final, final

from gsgen.contract.fetching.addresses import Origin
from gsgen.contract.fetching.deadline import Deadline, DeadlineSocket, connect

CONNECTION_ERRORS: Final = (OSError, http.client.HTTPException, ValueError)
"""What broken and hostile servers make ``http.client`` raise."""
_MAX_INTERIM_RESPONSES: Final = 16  # responses with a status from 100 to 199 before the real one
_MAX_IDLE_CONNECTIONS: Final = 8
_LONGEST_NUMBER: Final = 18  # digits of a number that fits 64 bits


@final
class _Response(http.client.HTTPResponse):
    """A response whose interim responses are skipped, but not without end."""

    def _read_status(self) -> tuple[str, int, str]:
        for _ in range(_MAX_INTERIM_RESPONSES):
            version, status, reason = super()._read_status()  # type: ignore[misc]
            if not 100 <= status < 200:
                return version, status, reason
            http.client.parse_headers(self.fp)
        raise http.client.HTTPException(f"more than {_MAX_INTERIM_RESPONSES} interim responses")


@final
class WebConnection(http.client.HTTPConnection):
    """A connection to one origin.

    Attributes:
        origin: Of the server.
        wire: The socket.
        is_reused: Whether it has carried a request before.
        must_be_public: Whether it may lead to public addresses alone.
    """

    response_class = _Response
    wire: DeadlineSocket

    def __init__(self, origin: Origin, *, must_be_public: bool = False) -> None:
        super().__init__(origin.host, origin.port)
        self.origin, self.is_reused, self.must_be_public = origin, False, must_be_public
        if origin.scheme == "https":
            self.default_port = 443  # the Host header leaves it out

    def open(self, deadline: Deadline) -> None:
        """Connect to the server."""
        origin = self.origin
        self.sock = self.wire = connect(
            origin.host,
            origin.port,
            deadline,
            encrypted=origin.scheme == "https",
            must_be_public=self.must_be_public,
        )

    def ask(
        self, method: str, target: str, headers: dict[str, str], deadline: Deadline
    ) -> http.client.HTTPResponse:
        """Send a request, and return the response with its headers.

        Raises:
            OSError: The server cannot be reached, or not in time (``TimeoutError``).
            HTTPException: The response is malformed.
            ValueError: It is.
        """
        if self.sock is None:
            self.open(deadline)
        self.wire.deadline = deadline
        self.request(method, target, headers=headers)
        response = self.getresponse()
        lengths = set(response.headers.get_all("Content-Length", []))
        if len(lengths) > 1 or not all(map(_is_number, lengths)):
            raise http.client.HTTPException("Content-Length is not a number")
        return response

    def disconnect(self) -> None:
        """Close the connection; a thread that reads from it gets an error or the end."""
        if hasattr(self, "wire"):
            self.wire.disconnect()


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= _LONGEST_NUMBER


@final
class ConnectionPool:
    """The open connections of a client; safe to use from many threads.

    Attributes:
        is_closed: Whether requests are refused.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._idle_connections: list[WebConnection] = []
        self._busy_connections: set[WebConnection] = set()
        self.is_closed = False

    def take(self, origin: Origin, *, must_be_public: bool = False) -> WebConnection:
        """Return an idle connection to an origin, or a new one.

        Args:
            origin: The origin.
            must_be_public: Whether a new connection may lead to public addresses alone.

        Raises:
            OSError: The pool is closed.
        """
        with self._lock:
            if self.is_closed:
                raise OSError("the client is closed")
            connection = next(
                (
                    idle_connection
                    for idle_connection in self._idle_connections
                    if idle_connection.origin == origin
                ),
                None,
            )
            if connection is None:
                connection = WebConnection(origin, must_be_public=must_be_public)
            else:
                self._idle_connections.remove(connection)
            self._busy_connections.add(connection)
            return connection

    def release(self, connection: WebConnection, response: http.client.HTTPResponse | None) -> None:
        """Keep a connection whose response was read to its end; close any other."""
        is_connection_reusable = (
            response is not None
            and not response.will_close
            and (response.isclosed() or response.length == 0)
        )
        if response is not None:
            response.close()
        with self._lock:
            self._busy_connections.discard(connection)
            if (
                is_connection_reusable
                and not self.is_closed
                and len(self._idle_connections) < _MAX_IDLE_CONNECTIONS
            ):
                connection.is_reused = True
                self._idle_connections.append(connection)
                return
        connection.disconnect()

    def close(self) -> None:
        """Close all connections; requests that run end with an error."""
        with self._lock:
            self.is_closed = True
            connections = [*self._idle_connections, *self._busy_connections]
            self._idle_connections.clear()
        for connection in connections:
            connection.disconnect()
