"""Deadlines of web requests, and sockets whose every operation ends at a deadline."""

__all__ = [
    "FETCH_SECONDS",
    "Deadline",
    "DeadlineSocket",
    "NotPublicHostError",
    "connect",
    "fetch_seconds",
    "large_file_deadline",
]

import io
import ipaddress
import math
import os
import socket
import ssl
import time
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Final, final

from gsgen.contract.errors import ConfigInvalid

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

_LARGE_FILE_SECONDS: Final = 3600.0
FETCH_SECONDS: Final = "GSGEN_FETCH_SECONDS"
"""Environment variable: most seconds for one file of a web server, all attempts together."""


def fetch_seconds(default: float) -> float:
    """Return the seconds that ``GSGEN_FETCH_SECONDS`` sets for one file, or the default.

    Raises:
        ConfigInvalid: The variable is not a number above 0.
    """
    text = os.environ.get(FETCH_SECONDS, "")
    if not text:
        return default
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise ConfigInvalid(
            f"{text!r} is not a time limit; expected a number of seconds above 0",
            where=FETCH_SECONDS,
        )
    return seconds


@final
class Deadline:
    """A moment by which something has to be done, some seconds from now.

    Attributes:
        seconds: From the beginning to the deadline.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._end_time = time.monotonic() + seconds

    @property
    def remaining(self) -> float:
        """Seconds until the deadline; 0 or less after it."""
        return self._end_time - time.monotonic()

    def require_time(self) -> float:
        """Return the seconds until the deadline.

        Raises:
            TimeoutError: The deadline has passed.
        """
        seconds = self.remaining
        if seconds <= 0:
            raise TimeoutError("the deadline has passed")
        return seconds

    def within(self, seconds: float) -> "Deadline":
        """Return the earlier of this deadline and one some seconds from now."""
        earlier_deadline = Deadline(seconds)
        earlier_deadline._end_time = min(earlier_deadline._end_time, self._end_time)
        return earlier_deadline


@final
class DeadlineSocket:
    """A connected socket of which no operation outlasts the present deadline.

    Time limits of plain sockets start again with each byte; a peer that sends a byte a second
    holds them for ever.

    Attributes:
        deadline: When reading and writing fails with ``TimeoutError``; it may be replaced.
    """

    def __init__(self, connected_socket: socket.socket, deadline: Deadline) -> None:
        self._socket, self.deadline = connected_socket, deadline

    def sendall(self, data: "ReadableBuffer") -> None:
        """Send all bytes."""
        self._socket.settimeout(self.deadline.require_time())
        self._socket.sendall(data)

    def recv_into(self, buffer: "WriteableBuffer") -> int:
        """Receive bytes into a buffer; return their number, 0 at the end."""
        self._socket.settimeout(self.deadline.require_time())
        return self._socket.recv_into(buffer)

    def makefile(self, mode: str = "rb") -> io.BufferedReader:
        """Return a buffered reader, as ``http.client`` asks of a socket."""
        assert mode == "rb"
        return io.BufferedReader(_SocketReader(self), 1 << 16)

    def close(self) -> None:
        """Do nothing: ``http.client`` closes sockets while a response is still read from them."""

    def disconnect(self) -> None:
        """Close the socket; a thread that reads from it gets the end of the stream."""
        with suppress(OSError):  # the peer closed it already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


@final
class _SocketReader(io.RawIOBase):
    """Reads a socket within its deadline."""

    def __init__(self, source: DeadlineSocket) -> None:
        self._source = source

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: "WriteableBuffer") -> int:
        """Receive bytes into a buffer."""
        return self._source.recv_into(buffer)


def large_file_deadline() -> Deadline:
    """Return the deadline of a model or of many splats: an hour, where the user sets no time.

    Raises:
        ConfigInvalid: ``GSGEN_FETCH_SECONDS`` is not a number above 0.
    """
    return Deadline(fetch_seconds(_LARGE_FILE_SECONDS))


@final
class NotPublicHostError(Exception):
    """Raised if a host that has to be public has an address in a private network."""


def connect(
    host: str, port: int, deadline: Deadline, *, encrypted: bool, must_be_public: bool = False
) -> DeadlineSocket:
    """Connect to a web server: look up its name, connect, and shake hands, before a deadline.

    Args:
        host: Its name or number.
        port: Its port.
        deadline: Of all steps together.
        encrypted: Whether the connection is one of TLS.
        must_be_public: Whether all addresses of the host must be public.

    Raises:
        NotPublicHostError: An address of the host is not public.
        OSError: It cannot be reached; ``TimeoutError`` after the deadline.
        ValueError: The host is not a host name.
    """
    endpoints = _look_up_addresses(host, port, deadline)
    if must_be_public:
        # The addresses that are checked are those that are connected to: no second look-up.
        for _, address in endpoints:
            if not _is_public(str(address[0])):
                raise NotPublicHostError(f"{host}, which is {address[0]}")
    failure: OSError = OSError(f"{host} has no address")
    for index, (family, address) in enumerate(endpoints):
        connection = socket.socket(family, socket.SOCK_STREAM)
        try:
            # An endpoint that does not answer leaves time for those after it.
            connection.settimeout(deadline.require_time() / (len(endpoints) - index))
            connection.connect(address)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if encrypted:
                connection = _encrypt_connection(connection, host, deadline)
            return DeadlineSocket(connection, deadline)
        except OSError as error:
            connection.close()
            failure = error
        except BaseException:
            connection.close()
            raise
    raise failure


_TRANSLATED_NETWORK: Final = ipaddress.IPv6Network("64:ff9b::/96")
"""Addresses of networks without IPv4, each of which stands for one of IPv4 (NAT64)."""


def _is_public(number: str) -> bool:
    """Return whether an address of the Internet Protocol is reached over the public network."""
    address = ipaddress.ip_address(number.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address):
        if address.sixtofour is not None or address.teredo is not None:
            return False  # tunnels, which may end in a private network
        is_translated = address in _TRANSLATED_NETWORK
        inner_address = (
            ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
            if is_translated
            else address.ipv4_mapped
        )
        if inner_address is not None:
            return _is_public(str(inner_address))
    return address.is_global and not address.is_multicast


_Address = tuple[str, int] | tuple[str, int, int, int] | tuple[int, bytes]


def _look_up_addresses(
    host: str, port: int, deadline: Deadline
) -> list[tuple[socket.AddressFamily, _Address]]:
    """Look up the addresses of a host on a thread, since the system's call has no time limit."""
    results: SimpleQueue[list[tuple[socket.AddressFamily, _Address]] | Exception] = SimpleQueue()

    def look_up() -> None:
        try:
            entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            results.put([(family, address) for family, _, _, _, address in entries])
        except (OSError, ValueError) as error:
            results.put(error)

    Thread(target=look_up, name="gsgen-dns", daemon=True).start()
    try:
        result = results.get(timeout=deadline.require_time())
    except Empty:
        raise TimeoutError(f"the name {host} is not resolved in time") from None
    if isinstance(result, Exception):
        raise result
    return result


def _encrypt_connection(connection: socket.socket, host: str, deadline: Deadline) -> ssl.SSLSocket:
    context = ssl.create_default_context()
    encrypted = context.wrap_socket(connection, server_hostname=host, do_handshake_on_connect=False)
    try:
        encrypted.settimeout(deadline.require_time())
        encrypted.do_handshake()  # its time limit is for all of it
    except BaseException:
        encrypted.close()
        raise
    return encrypted
