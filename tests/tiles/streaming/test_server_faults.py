"""Each fault of a server: `gsgen render` draws a picture, and one line names the address."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.fetching import client
from gsgen.formats import write_ply
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.commands import gsgen_here
from support.tiles.builds import build
from support.tiles.tile_scenes import scattered

pytestmark = pytest.mark.slow


SLOW, STALLED = 0.2, 3.0  # seconds a byte, and in all


class FaultyServer(ThreadingHTTPServer):
    """Serves a folder; the answers of one path have a fault."""

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), FaultyHandler)
        self.folder, self.path, self.fault = folder, "", ""

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/"


class FaultyHandler(BaseHTTPRequestHandler):
    """Answers as the server's fault says, written by hand: sizes and bodies may differ."""

    server: FaultyServer

    def do_GET(self) -> None:
        path = self.path.lstrip("/")
        data = (self.server.folder / path).read_bytes()
        fault = self.server.fault if path == self.server.path else ""
        if fault == "not-found":
            self.send_error(404)
        elif fault == "server-error":
            self.send_error(503)
        elif fault == "redirect":
            self.send_response(302)
            self.send_header("Location", f"http://elsewhere.example/{path}")
            self.send_header("Content-Length", "0")
            self.end_headers()
        elif fault == "stalled":
            time.sleep(STALLED)
        elif fault == "slow":
            self.answer(data, data[:10], pause=SLOW)
        elif fault == "cut-short":
            self.answer(data, data[: len(data) // 2])
        elif fault == "wrong-length":
            self.answer(data[:-100], data[:-100])
        elif fault == "other-bytes":
            self.answer(data, bytes(len(data)))
        else:
            self.answer(data, data)

    def do_HEAD(self) -> None:
        self.do_GET()

    def answer(self, body: bytes, sent: bytes, pause: float = 0.0) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "HEAD":
            return
        for start in range(0, len(sent), 1 if pause else len(sent)):
            self.wfile.write(sent[start : start + 1] if pause else sent)
            time.sleep(pause)

    def log_message(self, format: str, *args: object) -> None:
        pass


@contextmanager
def serving(folder: Path) -> Iterator[FaultyServer]:
    with FaultyServer(folder) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_ply(folder / "scene.ply", scattered(3_000, degree=0))
    build([folder / "scene.ply"], folder / "tiles")
    return folder / "tiles"


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("not-found", "answers 404"),
        ("server-error", "answers 503"),
        ("cut-short", "ended early"),
        ("slow", "did not come within 0.5 s"),
        ("stalled", "did not come within 0.5 s"),
        ("wrong-length", "expected"),
        ("other-bytes", "expected"),
        ("redirect", "redirects to 'http://elsewhere.example/"),
    ],
)
def test_faulty_file_leaves_a_picture_and_a_warning(
    town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, words: str
) -> None:
    monkeypatch.setattr(client, "_BACKOFF", 0.01)
    monkeypatch.setenv("GSGEN_FETCH_SECONDS", "0.5")
    leaf = next(tile for tile in open_tileset(town).tiles() if not tile.children)
    picture = tmp_path / "picture.png"
    with serving(town) as server:
        server.path, server.fault = leaf.contents[0].uri, fault
        address = server.address
        completed = gsgen_here(
            *("render", f"{address}tileset.json", "-o", picture, "--sse", "0.1"),
            *("--width", "64", "--height", "48", "--wait", "3", "--cache", "0"),
        )
    assert completed.code == 0, completed.err
    lines = completed.err.splitlines()
    matching_lines = [line for line in lines if words in line]
    assert len(matching_lines) == len(lines) == 1, completed.err
    assert matching_lines[0].startswith(f"gsgen: {address}")
    assert address + server.path in matching_lines[0]
    assert np.asarray(Image.open(picture)).max() > 20
