"""Every hostile answer ends in one error that names the address, on time, and asks no stranger."""

import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import which

import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.fetching import client
from gsgen.contract.fetching.client import WebClient, fetch
from gsgen.contract.fetching.errors import (
    AddressNotAllowed,
    FetchFailed,
    FileMissing,
    ResponseTooLarge,
    ServerUnavailable,
)
from gsgen.contract.fetching.responses import FilePart
from support.web.hostile_server import ANSWERS, BODY, OK, HostileServer, hostile_server, send, whole

SECONDS = 0.15


@pytest.mark.parametrize("name", ANSWERS)
def test_hostile_answer_is_one_error_in_time(name: str) -> None:
    with hostile_server(ANSWERS[name]) as server:
        start = time.monotonic()
        with pytest.raises(FetchFailed) as caught:
            fetch(server.address, max_bytes=1 << 20, seconds=SECONDS)
        elapsed = time.monotonic() - start
        assert elapsed < SECONDS + 1
        assert caught.value.where == server.address
        assert "\n" not in caught.value.message
        assert caught.value.message.isprintable()
        assert server.strangers == 0
        assert server.requests <= 10


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("redirect-elsewhere", AddressNotAllowed),
        ("redirect-malformed-host", AddressNotAllowed),
        ("dripping-error-body", FileMissing),
        ("endless-body", ResponseTooLarge),
        ("length-huge", ResponseTooLarge),
        ("gzip-bomb", ResponseTooLarge),
        ("retry-after-hours", ServerUnavailable),
    ],
)
def test_kind_of_the_error_says_what_to_do(name: str, kind: type[FetchFailed]) -> None:
    with hostile_server(ANSWERS[name]) as server, pytest.raises(kind):
        fetch(server.address, max_bytes=1 << 20, seconds=5)


def test_answer_that_ends_early_is_tried_five_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "_BACKOFF_SECONDS", 0.01)
    with hostile_server(ANSWERS["length-too-long"]) as server:
        with pytest.raises(ServerUnavailable, match="ended early"):
            fetch(server.address, max_bytes=1 << 20, seconds=20)
        assert server.requests == 5


def test_long_wait_is_told_without_waiting() -> None:
    with hostile_server(ANSWERS["retry-after-hours"]) as server:
        start = time.monotonic()
        with pytest.raises(ServerUnavailable, match="asks to wait 21,600 s"):
            fetch(server.address, max_bytes=1 << 20)
        assert time.monotonic() - start < 2


@pytest.mark.parametrize(
    "interim", [b"HTTP/1.1 100 Continue\r\n\r\n", b"HTTP/1.1 103 Hints\r\n\r\n"]
)
def test_a_few_interim_responses_are_skipped(interim: bytes) -> None:
    with hostile_server(send(interim * 3 + whole(BODY))) as server:
        assert fetch(server.address, max_bytes=1 << 20, seconds=5) == BODY


def test_address_with_a_password_or_of_another_scheme_is_refused() -> None:
    for address in ("http://u:p@127.0.0.1/x", "ftp://a/x", "http://", "http://[::1/x", "a.json"):
        with pytest.raises(AddressNotAllowed):
            fetch(address, max_bytes=1)


def test_allowed_origin_without_scheme_is_refused_before_any_request() -> None:
    with pytest.raises(ConfigInvalid, match=r"'cdn\.example\.com' is not an origin"):
        WebClient("http://127.0.0.1/x", allow_origins=["cdn.example.com"])


def test_headers_go_to_the_origin_of_the_address_alone() -> None:
    """A token is sent to the first server, and not to the one that it redirects to."""
    requests: list[bytes] = []

    def keep(connection: socket.socket) -> None:
        requests.append(connection.recv(65536))

    with _answering(lambda c: (keep(c), c.sendall(whole(BODY)))) as second:
        target = f"http://127.0.0.1:{second}/x.json".encode()
        moved = b"HTTP/1.1 302 Found\r\nLocation: %s\r\nContent-Length: 0\r\n\r\n" % target
        with _answering(lambda c: (keep(c), c.sendall(moved))) as first:
            data = fetch(
                f"http://127.0.0.1:{first}/a.json",
                max_bytes=1000,
                seconds=5,
                headers={"Authorization": "Bearer secret"},
                allow_origins=[f"http://127.0.0.1:{second}"],
            )
    assert data == BODY
    assert [b"Bearer secret" in request for request in requests] == [True, False]


@contextmanager
def _answering(reply) -> Iterator[int]:
    """Answer one connection by a function."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def run() -> None:
            connection, _ = listener.accept()
            with connection:
                reply(connection)

        thread = threading.Thread(target=run)
        thread.start()
        yield listener.getsockname()[1]
        thread.join(10)


def test_tls_handshake_that_hangs_ends_in_time() -> None:
    with _answering(lambda connection: time.sleep(2 * SECONDS)) as port:
        start = time.monotonic()
        with pytest.raises(ServerUnavailable, match="did not come within"):
            fetch(f"https://127.0.0.1:{port}/x", max_bytes=1, seconds=SECONDS)
        assert time.monotonic() - start < SECONDS + 1


@pytest.mark.skipif(which("openssl") is None, reason="openssl makes the certificate")
def test_self_signed_certificate_is_refused_at_once(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    command = f"openssl req -x509 -newkey rsa:2048 -nodes -subj /CN=localhost -keyout {key}"
    subprocess.run([*command.split(), "-out", certificate], check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)

    def shake_hands(connection: socket.socket) -> None:
        with pytest.raises(ssl.SSLError):
            context.wrap_socket(connection, server_side=True)

    with (
        _answering(shake_hands) as port,
        pytest.raises(ServerUnavailable, match="certificate verify failed"),
    ):
        fetch(f"https://127.0.0.1:{port}/x", max_bytes=1, seconds=5)


def test_connection_that_is_not_accepted_ends_in_time() -> None:
    """The backlog is full: the kernel drops further handshakes."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as listener:
        port = listener.getsockname()[1]
        waiting = []
        for _ in range(4):
            client = socket.socket()
            client.setblocking(False)
            client.connect_ex(("127.0.0.1", port))
            waiting.append(client)
        start = time.monotonic()
        with pytest.raises(ServerUnavailable):
            fetch(f"http://127.0.0.1:{port}/x", max_bytes=1, seconds=SECONDS)
        assert time.monotonic() - start < SECONDS + 1
        for client in waiting:
            client.close()


def test_name_that_is_not_resolved_ends_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: released.wait(20) and [])
    start = time.monotonic()
    with pytest.raises(ServerUnavailable):
        fetch("http://name.invalid/x", max_bytes=1, seconds=SECONDS)
    assert time.monotonic() - start < SECONDS + 1
    released.set()


def test_closing_the_client_ends_a_request_that_waits() -> None:
    with hostile_server(ANSWERS["no-answer"]) as server:
        waiting = WebClient(server.address, seconds=20)
        errors: list[Exception] = []

        def ask() -> None:
            with pytest.raises(FetchFailed) as caught:
                waiting.read(server.address, max_bytes=1)
            errors.append(caught.value)

        thread = threading.Thread(target=ask)
        thread.start()
        while not server.requests:
            time.sleep(0.005)
        waiting.close()
        thread.join(5)
        assert len(errors) == 1


@pytest.mark.parametrize("text", ["soon", "0", "-1", "nan", "inf"])
def test_malformed_time_limit_is_named(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("GSGEN_FETCH_SECONDS", text)
    with pytest.raises(ConfigInvalid) as caught:
        WebClient("http://127.0.0.1/x")
    assert caught.value.where == "GSGEN_FETCH_SECONDS"


def test_gzip_of_a_server_is_unpacked() -> None:
    import gzip

    with hostile_server(send(whole(gzip.compress(BODY), b"Content-Encoding: gzip"))) as server:
        assert fetch(server.address, max_bytes=100, seconds=5) == BODY


def test_body_without_a_length_ends_with_the_connection() -> None:
    with hostile_server(send(OK + b"\r\n" + BODY)) as server:
        assert fetch(server.address, max_bytes=100, seconds=5) == BODY


@pytest.mark.parametrize(
    ("headers", "validator"),
    [
        ([b'ETag: "1"', b"Last-Modified: Mon, 30 Nov 2026 14:00:00 GMT"], '"1"'),
        ([b'ETag: W/"1"'], 'W/"1"'),
        ([b"Last-Modified: Mon, 30 Nov 2026 14:00:00 GMT"], "Mon, 30 Nov 2026 14:00:00 GMT"),
        ([], ""),
        ([b'ETag: "1"', b"Cache-Control: private, No-Store"], ""),
        ([b'ETag: "1\x01"'], ""),
        ([b'ETag: "\xe9"'], ""),
        ([b'ETag: "%s"' % (b"1" * 2000)], ""),
        ([b'ETag: "1\r\n 2"'], ""),
    ],
)
def test_a_version_comes_with_its_validator_if_that_can_be_sent_back(
    headers: list[bytes], validator: str
) -> None:
    def answer(connection: socket.socket, server: HostileServer) -> None:
        is_known = validator and server.requests == 2
        same = b"HTTP/1.1 304 Not Modified\r\n\r\n"
        connection.sendall(same if is_known else whole(BODY, *headers))

    with hostile_server(answer) as server, WebClient(server.address, seconds=3) as web:
        assert web.read_version(server.address, "", max_bytes=1 << 20) == (BODY, validator)
        version = web.read_version(server.address, validator, max_bytes=1 << 20)
        assert version == ((None if validator else BODY), validator)
    part = FilePart(address="", max_bytes=1, max_undeclared=1, validator=validator)
    name = "If-None-Match" if '"' in validator else "If-Modified-Since"
    assert part.headers == ({name: validator} if validator else {})


def test_an_answer_without_a_body_is_no_file() -> None:
    with (
        hostile_server(send(b"HTTP/1.1 304 Not Modified\r\n\r\n")) as server,
        pytest.raises(ServerUnavailable, match="answers 304"),
    ):
        fetch(server.address, max_bytes=1 << 20, seconds=SECONDS)
