"""A web server for this machine: many connections, limits of time and size, one Host, no CORS."""

__all__ = ["LocalHandler", "LocalServer"]

import io
import ipaddress
import socket
from abc import ABC, abstractmethod
from collections.abc import Collection
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from threading import Lock
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from gsgen.contract.fetching.deadline import Deadline, DeadlineSocket

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_MAX_CONNECTIONS: Final = 256
_FIRST_REQUEST_SECONDS: Final = 10.0
_IDLE_SECONDS: Final = 60.0
_SEND_SECONDS: Final = 60.0
_MAX_HEADERS: Final = 32 << 10  # bytes of a request
_ANY_ORIGIN: Final = "*"


class LocalServer(ThreadingHTTPServer):
    """Base of gsgen's web servers, with a thread for each of at most 256 connections.

    Where there are more, the one that has waited longest for its next request is closed, so that
    connections which send nothing keep no others out.

    A page of another site whose name was pointed at this machine (DNS rebinding) is refused by its
    Host header: hosts are numeric addresses, ``localhost``, this machine's name and ``host``.

    Attributes:
        cors: Origins whose pages may read the answers; ``*`` for all.

    Args:
        host: The address to listen at.
        port: The port; 0 for one that is free.
        handler: Answers requests.
        cors: See above.

    Raises:
        OSError: The port is taken, or the host is not an address of this machine.
    """

    daemon_threads = True
    request_queue_size = 256  # with fewer, the kernel lets clients wait for a second and more

    def __init__(
        self, host: str, port: int, handler: "type[LocalHandler]", *, cors: Collection[str] = ()
    ) -> None:
        self.cors = frozenset(cors)
        host_name = socket.gethostname().lower()
        self._names = {"localhost", host.lower(), host_name, f"{host_name}.local"}
        self._lock = Lock()
        self._waiting_sockets: dict[socket.socket, None] = {}  # for a request; the longest first
        self._answering_sockets: set[socket.socket] = set()
        super().__init__((host, port), handler)

    def server_bind(self) -> None:
        """Bind the socket, without asking name servers for this machine's name."""
        TCPServer.server_bind(self)
        host, port = self.server_address[:2]
        self.server_name, self.server_port = str(host), port

    @property
    def address(self) -> str:
        """The URL of the server's root."""
        host, port = self.server_address[:2]
        return f"http://{host if isinstance(host, str) else host.decode()}:{port}/"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection on a thread; where there are too many, close the idlest."""
        with self._lock:
            if len(self._waiting_sockets) + len(self._answering_sockets) >= _MAX_CONNECTIONS:
                longest_idle_socket = next(iter(self._waiting_sockets), request)
                with suppress(OSError):  # the client closed it already
                    longest_idle_socket.shutdown(socket.SHUT_RDWR)  # its thread ends
                self._waiting_sockets.pop(longest_idle_socket, None)
            self._waiting_sockets[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Forget and close a connection."""
        with self._lock:
            self._waiting_sockets.pop(request, None)
            self._answering_sockets.discard(request)
        super().shutdown_request(request)

    def set_answering(self, connection: socket.socket, *, is_answering: bool) -> None:
        """Note whether a connection is being answered, or waits for its next request."""
        with self._lock:
            self._waiting_sockets.pop(connection, None)
            self._answering_sockets.discard(connection)
            if is_answering:
                self._answering_sockets.add(connection)
            else:
                self._waiting_sockets[connection] = None

    def server_close(self) -> None:
        """Stop listening, and close all connections."""
        super().server_close()
        with self._lock:
            for connection in (*self._waiting_sockets, *self._answering_sockets):
                with suppress(OSError):  # the client closed it already
                    connection.shutdown(socket.SHUT_RDWR)

    def is_own_host(self, text: str) -> bool:
        """Return whether a Host header names this machine."""
        try:
            host = urlsplit(f"//{text}").hostname or ""
            if host in self._names or host.endswith(".localhost"):
                return True
            ipaddress.ip_address(host)
        except ValueError:
            return False
        return True  # a numeric address cannot be pointed elsewhere


class LocalHandler(BaseHTTPRequestHandler, ABC):
    """Reads the requests of one connection within limits of time and size."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "gsgen", ""
    disable_nagle_algorithm = True  # or the last packet waits 40 ms for an acknowledgement
    wbufsize = 1 << 17  # headers and a small body leave in one packet
    server: LocalServer

    @abstractmethod
    def answer(self, *, with_body: bool) -> None:
        """Answer a request for ``self.path``, with the headers alone for HEAD."""

    def do_GET(self) -> None:
        """Answer an HTTP GET request."""
        self.answer(with_body=True)

    def do_HEAD(self) -> None:
        """Answer an HTTP HEAD request with the headers alone."""
        self.answer(with_body=False)

    def do_OPTIONS(self) -> None:
        """Answer the request by which a browser asks for permission (CORS)."""
        self.send_response(HTTPStatus.NO_CONTENT)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def setup(self) -> None:
        """Prepare the connection: reads end at a deadline and at a number of bytes."""
        super().setup()
        self._reader = _RequestReader(self.connection)
        self.rfile = io.BufferedReader(self._reader, 1 << 13)
        self._seconds = _FIRST_REQUEST_SECONDS

    def handle(self) -> None:
        """Answer requests until the client goes away, or breaks a limit."""
        try:
            super().handle()
        except _HeadersTooLarge:
            with suppress(OSError):
                self.connection.sendall(
                    b"HTTP/1.1 431 Request Header Fields Too Large\r\n"
                    b"Connection: close\r\nContent-Length: 0\r\n\r\n"
                )
        except OSError:  # the client went away
            self.close_connection = True

    def finish(self) -> None:
        """Send the rest of an answer, if the client is still there."""
        with suppress(OSError):
            super().finish()

    def handle_one_request(self) -> None:
        """Answer one request."""
        self.server.set_answering(self.connection, is_answering=False)
        self._reader.start_request(self._seconds)
        self._seconds = _IDLE_SECONDS
        super().handle_one_request()

    def parse_request(self) -> bool:
        """Parse a request; refuse one for another host."""
        self.server.set_answering(self.connection, is_answering=True)
        if not super().parse_request():
            return False
        self.connection.settimeout(_SEND_SECONDS)
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 and not (self.request_version == "HTTP/1.0" and not hosts):
            self.send_error(HTTPStatus.BAD_REQUEST, "a request needs one Host header")
            return False
        if not all(map(self.server.is_own_host, hosts)):
            hint = "Ask for localhost, this machine's name or its numeric address."
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST, explain=hint)
            return False
        if "Content-Length" in self.headers or "Transfer-Encoding" in self.headers:
            self.close_connection = True  # the body stays unread
        return True

    def end_headers(self) -> None:
        """End the headers of an answer, after those that all answers have."""
        self.send_header("X-Content-Type-Options", "nosniff")
        self._send_cors()
        super().end_headers()

    def _send_cors(self) -> None:
        """Allow pages of other origins to read the answer, if the server's user said so."""
        origin = self.headers.get("Origin", "") if hasattr(self, "headers") else ""
        if _ANY_ORIGIN in self.server.cors:
            origin = _ANY_ORIGIN
        elif origin not in self.server.cors:
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            return
        self.send_header("Access-Control-Allow-Origin", origin)
        self.send_header("Vary", "Origin")
        self.send_header("Access-Control-Allow-Headers", "Range, If-None-Match, If-Range")
        self.send_header("Access-Control-Allow-Methods", "GET, HEAD, OPTIONS")
        exposed_headers = "Content-Range, Content-Length, ETag, Accept-Ranges"
        self.send_header("Access-Control-Expose-Headers", exposed_headers)

    def log_message(self, format: str, *words: object) -> None:
        """Print no log line of ``http.server``."""


class _HeadersTooLarge(OSError):
    """Raised if the headers of a request have more bytes than the limit."""


class _RequestReader(io.RawIOBase):
    """Reads a connection until the deadline and the most bytes of the present request."""

    def __init__(self, connection: socket.socket) -> None:
        self._source = DeadlineSocket(connection, Deadline(_FIRST_REQUEST_SECONDS))
        self._bytes_left = _MAX_HEADERS

    def start_request(self, seconds: float) -> None:
        """Begin the next request, which has to come within some seconds."""
        self._source.deadline = Deadline(seconds)
        self._bytes_left = _MAX_HEADERS

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: "WriteableBuffer") -> int:
        """Receive bytes into a buffer."""
        if self._bytes_left <= 0:
            raise _HeadersTooLarge
        size = self._source.recv_into(memoryview(buffer)[: self._bytes_left])
        self._bytes_left -= size
        return size
