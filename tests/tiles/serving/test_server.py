"""`gsgen tiles serve`: what it answers, to whom, and what holds it."""

import gzip
import hashlib
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path

import numpy as np
import pytest

from gsgen.runtime.web import local_server
from gsgen.tiles.serving.server import TileServer, serve_folder
from support.commands import gsgen_here

BODY = bytes(np.random.default_rng(0).integers(0, 256, 300_000, dtype=np.uint8))

# As they are sent: none of them may give a file.
ESCAPES = [
    "/../secret.txt",
    "/t/../../secret.txt",
    "/%2e%2e/secret.txt",
    "/%2E%2E/secret.txt",
    "/.%2e/secret.txt",
    "/%2e./secret.txt",
    "/..%2fsecret.txt",
    "/%2e%2e%2fsecret.txt",
    "/t/%2e%2e/%2e%2e/secret.txt",
    "/%252e%252e/secret.txt",
    "/%252e%252e%252fsecret.txt",
    "/..%252fsecret.txt",
    "/%25%32%65%25%32%65/secret.txt",
    "/..\\secret.txt",
    "/..%5csecret.txt",
    "/%2e%2e%5csecret.txt",
    "/t\\..\\..\\secret.txt",
    "/C:/secret.txt",
    "/c%3a/secret.txt",
    "/etc/passwd",
    "//etc/passwd",
    "/%2fetc/passwd",
    "/%2f%2fetc/passwd",
    "/./../secret.txt",
    "/.../secret.txt",
    "/..;/secret.txt",
    "/..%00/secret.txt",
    "/%00",
    "/t/a.glb%00.txt",
    "/..%c0%afsecret.txt",
    "/%c0%ae%c0%ae/secret.txt",
    "/%uff0e%uff0e/secret.txt",
    "/file:///etc/passwd",
    "file:///etc/passwd",
    "/link.txt",
    "/folder-link/secret.txt",
    "/t",
    "/t/",
    "/t/a.glb/",
    "/fifo",
    "/t//a.glb",
]
HIDDEN = ["/.env", "/.git/config", "/t/.hidden.glb", "/%2eenv", "/alias", "/alias-folder/config"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    import os

    root = tmp_path / "files"
    (root / "t").mkdir(parents=True)
    (root / ".git").mkdir()
    (root / "t" / "a.glb").write_bytes(BODY)
    (root / "t" / "a b.glb").write_bytes(b"spaced")
    (root / "100%25.glb").write_bytes(b"percent")
    for name in (".env", ".git/config", "t/.hidden.glb"):
        (root / name).write_text("hidden")
    (root / "alias").symlink_to(root / ".env")
    (root / "alias-folder").symlink_to(root / ".git")
    (tmp_path / "secret.txt").write_bytes(b"not for you")
    (root / "link.txt").symlink_to(tmp_path / "secret.txt")
    (root / "folder-link").symlink_to(tmp_path)
    os.mkfifo(root / "fifo")
    return root


@contextmanager
def serving(folder: Path, cors: Sequence[str] = ()) -> Iterator[TileServer]:
    with serve_folder(folder, cors=cors) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def server(folder: Path) -> Iterator[TileServer]:
    with serving(folder) as running:
        yield running


def ask(server: TileServer, path: str, method: str = "GET", **headers: str) -> HTTPResponse:
    connection = HTTPConnection(*server.server_address[:2], timeout=10)
    connection.putrequest(
        method, "/x", skip_host="Host" in headers, skip_accept_encoding="Accept_Encoding" in headers
    )
    connection._buffer[0] = f"{method} {path} HTTP/1.1".encode()  # type: ignore[attr-defined]
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    response = connection.getresponse()
    response.data = response.read()  # type: ignore[attr-defined]
    connection.close()
    return response


def raw(server: TileServer, data: bytes) -> bytes:
    with socket.create_connection(server.server_address[:2], timeout=10) as connection:
        connection.sendall(data)
        received = b""
        while piece := connection.recv(65536):
            received += piece
        return received


@pytest.mark.parametrize("path", ESCAPES)
def test_path_that_leaves_the_folder_is_not_found(server: TileServer, path: str) -> None:
    response = ask(server, path)
    assert response.status == 404
    assert b"not for you" not in response.data


@pytest.mark.parametrize("path", HIDDEN)
def test_hidden_file_is_not_found(server: TileServer, path: str) -> None:
    assert ask(server, path).status == 404


def test_a_path_is_decoded_once(server: TileServer) -> None:
    assert ask(server, "/t/a%20b.glb").data == b"spaced"
    assert ask(server, "/t/a%2520b.glb").status == 404
    assert ask(server, "/100%2525.glb").data == b"percent"


def test_ranges_and_etags(server: TileServer) -> None:
    full = ask(server, "/t/a.glb")
    assert (full.status, full.data) == (200, BODY)
    assert full.headers["Content-Type"] == "model/gltf-binary"
    assert full.headers["X-Content-Type-Options"] == "nosniff"
    same = ask(server, "/t/a.glb", If_None_Match=full.headers["ETag"])
    assert (same.status, same.data) == (304, b"")
    tail = ask(server, "/t/a.glb", Range="bytes=-7")
    assert (tail.status, tail.data) == (206, BODY[-7:])
    last = len(BODY) - 1
    assert tail.headers["Content-Range"] == f"bytes {last - 6}-{last}/{len(BODY)}"
    large = ask(server, "/t/a.glb", Range="bytes=1000-299000")
    assert (large.status, large.data) == (206, BODY[1000:299_001])
    whole = ask(server, "/t/a.glb", Range="bytes=0-")
    assert (whole.status, whole.data) == (200, BODY)
    assert ask(server, "/t/a.glb", Range=f"bytes={len(BODY)}-").status == 416
    assert ask(server, "/t/a.glb", Range="bytes=0-3", If_Range='"other"').status == 200
    head = ask(server, "/t/a.glb", "HEAD")
    assert (head.headers["Content-Length"], head.data) == (str(len(BODY)), b"")


@pytest.mark.parametrize("name", ["0_1f{}/meta.json", "0_1f/means_l{}.webp", "t/tile{}.glb"])
def test_only_files_that_are_named_by_their_bytes_never_change(
    folder: Path, server: TileServer, name: str
) -> None:
    """Eight digits may be a date, too."""
    digest = hashlib.sha256(BODY).hexdigest()[:8]
    for suffix, is_immutable in ((f"-{digest}", True), ("-20240115", False), ("", False)):
        file = folder / name.format(suffix)
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(BODY)
        for _ in range(2):
            answer = ask(server, f"/{name.format(suffix)}")
            assert ("immutable" in answer.headers["Cache-Control"]) is is_immutable
    file = folder / name.format(f"-{digest}")
    file.write_bytes(BODY + b"other")
    assert ask(server, f"/{file.relative_to(folder)}").headers["Cache-Control"] == "no-cache"


@pytest.mark.parametrize(
    ("accepted", "is_packed"),
    [
        ("gzip", True),
        ("br, GZIP;q=0.5", True),
        ("deflate, *", True),
        ("gzip; q=1.000", True),
        ("", False),
        ("identity", False),
        ("br", False),
        ("gzip;q=0", False),
        ("*, gzip;q=0.000", False),
    ],
)
def test_json_is_packed_for_those_who_take_it(
    folder: Path, server: TileServer, accepted: str, is_packed: bool
) -> None:
    text = b'{"root": 0}' * 2000
    (folder / "t" / "tileset.json").write_bytes(text)
    answer = ask(server, "/t/tileset.json", Accept_Encoding=accepted)
    assert answer.headers["Content-Encoding"] == ("gzip" if is_packed else None)
    assert answer.headers["Vary"] == "Accept-Encoding"
    assert int(answer.headers["Content-Length"]) == len(answer.data)
    assert (gzip.decompress(answer.data) if is_packed else answer.data) == text
    assert (len(answer.data) < 200) is is_packed
    # Both forms are files of their own to caches, and ranges are those of the file itself.
    tag = answer.headers["ETag"]
    same = ask(server, "/t/tileset.json", Accept_Encoding=accepted, If_None_Match=tag)
    assert (same.status, same.headers["ETag"], same.headers["Vary"]) == (
        304,
        tag,
        "Accept-Encoding",
    )
    assert (tag == ask(server, "/t/tileset.json").headers["ETag"]) is not is_packed
    part = ask(server, "/t/tileset.json", Accept_Encoding=accepted, Range="bytes=2-5")
    assert (part.status, part.data, part.headers["Content-Encoding"]) == (206, text[2:6], None)
    head = ask(server, "/t/tileset.json", "HEAD", Accept_Encoding=accepted)
    assert head.headers["Content-Length"] == answer.headers["Content-Length"]
    assert ask(server, "/t/a.glb", Accept_Encoding=accepted).data == BODY


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost", 200),
        ("LOCALHOST:8000", 200),
        ("127.0.0.1", 200),
        ("[::1]:80", 200),
        ("192.168.1.5:8000", 200),
        (socket.gethostname(), 200),
        (f"{socket.gethostname()}.local", 200),
        ("a.localhost", 200),
        ("evil.example", 421),
        ("evil.example:8000", 421),
        ("localhost.evil.example", 421),
        ("127.0.0.1.evil.example", 421),
        ("evillocalhost", 421),
        ("localhost@evil.example", 421),
        ("[::1", 421),
        ("", 421),
    ],
)
def test_host_of_another_site_is_refused(server: TileServer, host: str, status: int) -> None:
    assert ask(server, "/t/a.glb", Host=host).status == status


def test_request_without_a_host_or_with_two_is_refused(server: TileServer) -> None:
    assert b" 400 " in raw(server, b"GET / HTTP/1.1\r\n\r\n")[:20]
    twice = b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"
    assert b" 400 " in raw(server, twice)[:20]
    assert b" 200 " in raw(server, b"GET /t/a.glb HTTP/1.0\r\n\r\n")[:20]


@pytest.mark.parametrize(
    ("cors", "origin", "allowed"),
    [
        ((), "https://viewer.example", None),
        ((), "null", None),
        (("https://viewer.example",), "https://viewer.example", "https://viewer.example"),
        (("https://viewer.example",), "https://other.example", None),
        (("https://viewer.example",), "https://viewer.example.other.example", None),
        (("*",), "https://viewer.example", "*"),
    ],
)
def test_pages_of_other_origins_read_only_what_the_user_allows(
    folder: Path, cors: Sequence[str], origin: str, allowed: str | None
) -> None:
    with serving(folder, cors) as server:
        for method in ("GET", "OPTIONS"):
            headers = ask(server, "/t/a.glb", method, Origin=origin).headers
            assert headers["Access-Control-Allow-Origin"] == allowed
            blocked = headers["Cross-Origin-Resource-Policy"] == "same-origin"
            assert blocked is (allowed is None)


def test_headers_without_end_are_refused(server: TileServer) -> None:
    for line in (b"GET / HTTP/1.1\r\nX: " + b"y" * 100_000, b"GET /" + b"y" * 100_000):
        with socket.create_connection(server.server_address[:2], timeout=10) as connection:
            connection.sendall(line[:40_000])
            assert b" 431 " in connection.recv(100)
    assert ask(server, "/t/a.glb").status == 200


def test_headers_that_drip_end_in_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_server, "_FIRST_REQUEST_SECONDS", 0.3)
    with (
        serving(folder) as server,
        socket.create_connection(server.server_address[:2], timeout=10) as connection,
    ):
        start = time.monotonic()
        with suppress(OSError):  # a reset, or a broken pipe
            while time.monotonic() < start + 5:
                connection.sendall(b"G")
                time.sleep(0.02)
        assert time.monotonic() - start < 2


def test_four_hundred_half_open_connections_keep_nobody_out(server: TileServer) -> None:
    """Those that wait longest make room, and threads stay within their number."""
    waiting = []
    for _ in range(400):
        connection = socket.create_connection(server.server_address[:2], timeout=10)
        connection.sendall(b"GET /t/a.glb HTT")
        waiting.append(connection)
    start = time.monotonic()
    assert ask(server, "/t/a.glb").data == BODY
    assert time.monotonic() - start < 2
    threads = [t for t in threading.enumerate() if "process_request_thread" in t.name]
    assert len(threads) <= local_server._MAX_CONNECTIONS + 1
    for connection in waiting:
        connection.close()


def test_body_of_a_request_is_not_read_as_the_next_request(server: TileServer) -> None:
    hidden = b"GET /t/a%20b.glb HTTP/1.1\r\nHost: localhost\r\n\r\n"
    request = b"GET /100%%2525.glb HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n"
    assert raw(server, request % len(hidden) + hidden).count(b"HTTP/1.1 ") == 1


def test_log_has_no_control_characters(folder: Path) -> None:
    lines: list[str] = []
    with serve_folder(folder, log=lines.append) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        raw(server, b"GET /\x1b[31mred\x9b HTTP/1.0\r\n\r\n")
        server.shutdown()
        thread.join()
    assert lines
    assert all(line.isprintable() for line in lines)


def test_file_that_may_not_be_read_is_not_found(
    folder: Path, server: TileServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, mode: str) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    assert ask(server, "/t/a.glb").status == 404


def test_malformed_cors_origin_is_named(folder: Path) -> None:
    completed = gsgen_here("tiles", "serve", folder, "--port", "0", "--cors", "viewer.example")
    assert completed.code == 2
    assert "--cors: 'viewer.example' is not an origin" in completed.err
