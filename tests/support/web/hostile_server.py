"""A server on a plain socket whose every answer breaks a client in another way."""

import gzip
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache

BODY = b'{"asset": {"version": "1.1"}}'
OK = b"HTTP/1.1 200 OK\r\n"
DRIP_SECONDS = 0.05
LONGEST = 20.0  # seconds after which an endless answer ends, so that a test cannot hang
PIECE = bytes(1 << 16)

Answer = Callable[[socket.socket, "HostileServer"], None]


@dataclass
class HostileServer:
    """The server of one answer, and a second one that no client should ever ask.

    Attributes:
        files: Path → a file that is served well.
        strangers: How often the second server was asked.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    port: int = 0
    elsewhere: int = 0
    requests: int = 0
    strangers: int = 0
    stop: threading.Event = field(default_factory=threading.Event)

    def address_of(self, name: str) -> str:
        return f"http://127.0.0.1:{self.port}/a/{name}"

    @property
    def address(self) -> str:
        return self.address_of("tileset.json")


def whole(body: bytes, *headers: bytes) -> bytes:
    lines = b"".join(header + b"\r\n" for header in headers)
    return OK + lines + b"Content-Length: %d\r\n\r\n" % len(body) + body


def send(data: bytes) -> Answer:
    return lambda connection, server: connection.sendall(data)


def repeat(first: bytes, piece: bytes, pause: float = 0.0) -> Answer:
    """Send a beginning, and then a piece again and again."""

    def answer(connection: socket.socket, server: HostileServer) -> None:
        connection.sendall(first)
        end = time.monotonic() + LONGEST
        while time.monotonic() < end and not server.stop.is_set():
            connection.sendall(piece)
            if pause:
                server.stop.wait(pause)

    return answer


def drip(data: bytes) -> Answer:
    """Send one byte after another, slowly."""

    def answer(connection: socket.socket, server: HostileServer) -> None:
        for index in range(len(data)):
            connection.sendall(data[index : index + 1])
            if server.stop.wait(DRIP_SECONDS):
                return

    return answer


def hang(first: bytes = b"") -> Answer:
    """Send a beginning, and then nothing."""

    def answer(connection: socket.socket, server: HostileServer) -> None:
        connection.sendall(first)
        server.stop.wait(LONGEST)

    return answer


def redirect(location: str, status: bytes = b"302 Found") -> Answer:
    def answer(connection: socket.socket, server: HostileServer) -> None:
        target = location.replace("HERE", f"127.0.0.1:{server.port}")
        target = target.replace("ELSEWHERE", f"127.0.0.1:{server.elsewhere}")
        connection.sendall(
            b"HTTP/1.1 %s\r\nLocation: %s\r\nContent-Length: 0\r\n\r\n"
            % (status, target.encode("latin-1"))
        )

    return answer


def reset(first: bytes) -> Answer:
    """Send a beginning, and reset the connection."""

    def answer(connection: socket.socket, server: HostileServer) -> None:
        connection.sendall(first)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    return answer


def busy(retry_after: bytes, status: bytes = b"503 Busy") -> Answer:
    return send(
        b"HTTP/1.1 %s\r\nRetry-After: %s\r\nContent-Length: 0\r\n\r\n" % (status, retry_after)
    )


@cache
def _packed_zeros() -> bytes:
    return gzip.compress(bytes(256 << 20), 1)


def gzip_bomb() -> Answer:
    """A quarter of a gigabyte of zeros in a megabyte."""
    return lambda connection, server: connection.sendall(
        whole(_packed_zeros(), b"Content-Encoding: gzip")
    )


CHUNKED = OK + b"Transfer-Encoding: chunked\r\n\r\n"
ANSWERS: dict[str, Answer] = {
    # Nothing, or too slowly.
    "no-answer": hang(),
    "closed-at-once": send(b""),
    "reset-at-once": reset(b""),
    "status-line-hangs": hang(b"HTTP/1.1 2"),
    "headers-hang": hang(OK + b"Content-Type: x\r\n"),
    "body-hangs": hang(OK + b"Content-Length: 100\r\n\r\n{"),
    "status-line-drips": drip(OK * 50),
    "headers-drip": drip(OK + b"X: y\r\n" * 400),
    "body-drips": drip(OK + b"Content-Length: 4000\r\n\r\n" + bytes(4000)),
    "chunks-drip": repeat(CHUNKED, b"1\r\nx\r\n", DRIP_SECONDS),
    "chunk-extension-drips": repeat(CHUNKED + b"5;", b"x", DRIP_SECONDS),
    "trailers-drip": repeat(CHUNKED + b"1\r\nx\r\n0\r\n", b"X: y\r\n", DRIP_SECONDS),
    "gzip-drips": repeat(
        OK + b"Content-Encoding: gzip\r\n\r\n" + gzip.compress(b"")[:10],
        b"\0\0\0\xff\xff",
        DRIP_SECONDS,
    ),
    # Without end.
    "endless-status-line": repeat(b"HTTP/1.1 200 ", b"O" * 4096),
    "endless-headers": repeat(OK, b"X-Header: value\r\n" * 100),
    "endless-header-line": repeat(OK + b"X: ", b"y" * 4096),
    "endless-body": repeat(OK + b"\r\n", PIECE),
    "endless-chunks": repeat(CHUNKED, b"10000\r\n" + PIECE + b"\r\n"),
    "endless-trailers": repeat(CHUNKED + b"0\r\n", b"X: y\r\n" * 100),
    "endless-continue": repeat(b"", b"HTTP/1.1 100 Continue\r\n\r\n" * 50),
    "endless-early-hints": repeat(b"", b"HTTP/1.1 103 Early Hints\r\nLink: x\r\n\r\n" * 50),
    "endless-empty-gzip-blocks": repeat(
        OK + b"Content-Encoding: gzip\r\n\r\n" + gzip.compress(b"")[:10], b"\0\0\0\xff\xff" * 1000
    ),
    "gzip-bomb": gzip_bomb(),
    "endless-error-body": repeat(b"HTTP/1.1 500 Broken\r\n\r\n", PIECE),
    "dripping-error-body": repeat(b"HTTP/1.1 404 Gone\r\n\r\n", b"x", DRIP_SECONDS),
    "endless-redirect-body": repeat(b"HTTP/1.1 302 Found\r\nLocation: b.json\r\n\r\n", PIECE),
    # Wait.
    "retry-after-hours": busy(b"21600"),
    "retry-after-date": busy(b"Fri, 01 Jan 2100 00:00:00 GMT"),
    "retry-after-huge-number": busy(b"9" * 400, b"429 Slow Down"),
    "retry-after-garbage": busy(b"-1e9 \xff"),
    "always-503": busy(b"0"),
    # Redirects.
    "redirect-loop": redirect("tileset.json"),
    "redirect-chain": redirect("x/tileset.json", b"307 Temporary"),
    "redirect-elsewhere": redirect("http://ELSEWHERE/x.json"),
    "redirect-elsewhere-without-scheme": redirect("//ELSEWHERE/x.json"),
    "redirect-user-at-elsewhere": redirect("http://HERE@ELSEWHERE/x.json"),
    "redirect-to-a-file": redirect("file:///etc/passwd"),
    "redirect-malformed-host": redirect("http://[::1/x.json"),
    "redirect-malformed-port": redirect("http://127.0.0.1:99999x/x.json"),
    "redirect-without-location": send(b"HTTP/1.1 301 Moved\r\nContent-Length: 0\r\n\r\n"),
    "redirect-backslashes": redirect("\\\\ELSEWHERE\\x.json"),
    # Lies.
    "length-too-long": send(OK + b"Content-Length: 500\r\n\r\n" + BODY),
    "length-huge": send(OK + b"Content-Length: 99999999999999999\r\n\r\n" + BODY),
    "length-twice": send(OK + b"Content-Length: 5\r\nContent-Length: 9\r\n\r\n" + BODY),
    "length-negative": send(OK + b"Content-Length: -5\r\n\r\n" + BODY[:10]),
    "chunk-size-garbage": send(CHUNKED + b"zz\r\n" + BODY),
    "chunk-size-negative": send(CHUNKED + b"-5\r\nhello\r\n0\r\n\r\n"),
    "chunk-size-huge": send(CHUNKED + b"f" * 40 + b"\r\n" + BODY),
    "gzip-garbage": send(whole(BODY, b"Content-Encoding: gzip")),
    "gzip-truncated": send(whole(gzip.compress(BODY * 99)[:-20], b"Content-Encoding: gzip")),
    "unknown-coding": send(whole(BODY, b"Content-Encoding: br, gzip")),
    "reset-in-the-body": reset(OK + b"Content-Length: 500\r\n\r\n" + BODY),
    "no-http": send(b"SSH-2.0-OpenSSH_9.2\r\n"),
    "status-not-a-number": send(b"HTTP/1.1 abc OK\r\n\r\n"),
    "null-bytes": send(bytes(1000)),
    "two-thousand-headers": send(OK + b"X: y\r\n" * 2000 + b"\r\n" + BODY),
}
"""Name → what the server answers. None of them is the file that was asked for."""


@contextmanager
def hostile_server(
    answer: Answer, files: dict[str, bytes] | None = None
) -> Iterator[HostileServer]:
    """Serve one hostile answer to every request but those of some files, until the block ends."""
    server = HostileServer(files or {})
    threads: list[threading.Thread] = []
    listeners = [socket.create_server(("127.0.0.1", 0), backlog=64) for _ in range(2)]
    server.port, server.elsewhere = (listener.getsockname()[1] for listener in listeners)

    def reply(connection: socket.socket) -> None:
        with connection, suppress(OSError):
            connection.settimeout(LONGEST)
            while not server.stop.is_set():
                path = _read_request(connection)
                if not path:
                    return
                server.requests += 1
                if path in server.files:
                    connection.sendall(whole(server.files[path]))
                    continue
                answer(connection, server)
                if answer in (ANSWERS["always-503"], ANSWERS["redirect-loop"]):
                    continue  # kept alive
                return

    def accept() -> None:
        with suppress(OSError):
            while True:
                connection, _ = listeners[0].accept()
                thread = threading.Thread(target=reply, args=(connection,))
                threads.append(thread)
                thread.start()

    def count_strangers() -> None:
        with suppress(OSError):
            while True:
                listeners[1].accept()[0].close()
                server.strangers += 1

    accepting = [threading.Thread(target=target) for target in (accept, count_strangers)]
    for thread in accepting:
        thread.start()
    try:
        yield server
    finally:
        server.stop.set()
        for listener in listeners:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        for thread in [*accepting, *threads]:
            thread.join(LONGEST)


def _read_request(connection: socket.socket) -> str:
    """Read a request, and return its path; empty at the end of the connection."""
    data = b""
    while b"\r\n\r\n" not in data:
        piece = connection.recv(4096)
        if not piece:
            return ""
        data += piece
    return data.split()[1].decode()
