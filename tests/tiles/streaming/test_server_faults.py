"""Each fault of a server: the other tiles are drawn, and one line counts those that are missing."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.fetching import client
from gsgen.formats import write_ply
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.serving.faults import NetworkFaults, parse_failure
from gsgen.tiles.streaming import tiles_source
from gsgen.tiles.streaming.fetch import ByteProgressCallback, FetchLink
from gsgen.tiles.streaming.session import SessionOptions, open_session
from gsgen.tiles.streaming.tiles_source import open_stream
from support.commands import gsgen_here
from support.tiles import foreign_tiles as foreign
from support.tiles.builds import build
from support.tiles.serving import served
from support.tiles.tile_scenes import scattered
from support.web.hostile_server import ANSWERS, hostile_server

pytestmark = pytest.mark.slow


SLOW, STALLED = 0.2, 3.0  # seconds a byte, and in all
REDIRECTS = {
    "redirect": "http://elsewhere.example/x.glb",
    "malformed-redirect": "http://[::1/x.glb",
    "redirect-without-host": "http://:80/x.glb",
}


class FaultyServer(ThreadingHTTPServer):
    """Serves a folder; the answers of some paths have a fault."""

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), FaultyHandler)
        self.folder, self.fault = folder, ""
        self.paths: set[str] = set()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/"


class FaultyHandler(BaseHTTPRequestHandler):
    """Answers as the server's fault says, written by hand: sizes and bodies may differ."""

    server: FaultyServer

    def do_GET(self) -> None:
        path = self.path.lstrip("/")
        data = (self.server.folder / path).read_bytes()
        fault = self.server.fault if path in self.server.paths else ""
        if fault == "not-found":
            self.send_error(404)
        elif fault == "server-error":
            self.send_error(503)
        elif fault in REDIRECTS:
            self.send_response(302)
            self.send_header("Location", REDIRECTS[fault])
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
        with suppress(ConnectionError):  # the client has gone
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


FAULTS = {
    "not-found": "answers 404",
    "server-error": "answers 503",
    "cut-short": "ended early",
    "slow": "did not come within 0.5 s",
    "stalled": "did not come within 0.5 s",
    "wrong-length": "expected",
    "other-bytes": "expected",
    "redirect": "redirects to 'http://elsewhere.example/",
    "malformed-redirect": "redirects to 'http://[::1/",
    "redirect-without-host": "redirects to 'http://:80/",
}


@pytest.fixture(autouse=True)
def short_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "_BACKOFF_SECONDS", 0.01)
    monkeypatch.setenv("GSGEN_FETCH_SECONDS", "0.5")


@pytest.mark.parametrize("fault", FAULTS)
def test_picture_without_a_tile_is_written_and_fails(
    town: Path, tmp_path: Path, fault: str
) -> None:
    leaf = next(tile for tile in open_tileset(town).tiles() if not tile.children)
    picture = tmp_path / "picture.png"
    with serving(town) as server:
        server.paths, server.fault = {leaf.contents[0].uri}, fault
        address = server.address
        words = (
            *("render", f"{address}tileset.json", "-o", picture, "--sse", "0.1"),
            *("--width", "64", "--height", "48", "--wait", "3", "--cache", "0"),
        )
        completed = gsgen_here(*words)
        assert np.asarray(Image.open(picture)).max() > 20
        accepted = gsgen_here(*words, "--allow-missing")
    line, *hints = completed.err.splitlines()
    assert completed.code == 4, completed.err
    assert line.startswith(f"gsgen: {address}tileset.json: 1 tile is missing, or drawn coarser: ")
    assert f"{address}{leaf.contents[0].uri}" in line
    assert FAULTS[fault] in line
    assert hints == ["  --allow-missing accepts such pictures."]
    assert accepted.code == 0
    assert accepted.err.replace("note:", "gsgen:").splitlines() == [line]


def test_picture_without_any_tile_fails(town: Path, tmp_path: Path) -> None:
    contents = [content.uri for tile in open_tileset(town).tiles() for content in tile.contents]
    with serving(town) as server:
        server.paths, server.fault = set(contents), "not-found"
        completed = gsgen_here(
            *("render", f"{server.address}tileset.json", "-o", tmp_path / "a.png"),
            *("--width", "64", "--height", "48", "--wait", "3", "--cache", "0", "--json"),
        )
    assert completed.code == 4
    assert " missing, or drawn coarser: " in completed.err
    assert json.loads(completed.out)["gaussians"] == 0


@pytest.mark.parametrize("fault", ["stalled", "malformed-redirect", "cut-short"])
def test_six_stuck_tiles_do_not_stop_the_others(town: Path, fault: str) -> None:
    """As many as there are connections: their slots are free again, and the rest arrives."""
    leaves = [tile for tile in open_tileset(town).tiles() if not tile.children]
    assert len(leaves) > 8
    view = Frustum.from_camera(
        Camera.look_at((0, 0, 400), (0, 0, 0), up=(0, 1, 0), width=640, height=480)
    )
    with serving(town) as server:
        server.paths, server.fault = {leaf.contents[0].uri for leaf in leaves[:6]}, fault
        options = SessionOptions(max_error=0.01, cache_bytes=0, connections=6, fade_seconds=0)
        lines: list[str] = []
        with closing(
            open_session(f"{server.address}tileset.json", options, report=lines.append)
        ) as session:
            end = time.monotonic() + 8
            frame = session.frame(view)
            while not frame.is_complete and time.monotonic() < end:
                session.wait(0.05)
                frame = session.frame(view)
            assert frame.is_complete
            assert len(frame.absent_tiles) == len(set(lines)) == 6
            tiles = [session.tree.tiles[index] for index in np.flatnonzero(session.resident)]
    assert {leaf.contents[0].uri for leaf in leaves[6:]} <= {
        content.uri for tile in tiles for content in tile.contents
    }


def test_fault_of_gsgen_on_a_thread_is_raised_and_frees_its_slot() -> None:
    def fetch(tile: int, on_bytes: ByteProgressCallback) -> bytes:
        raise ZeroDivisionError(tile)

    link: FetchLink[bytes, bytes] = FetchLink(fetch, lambda tile, data: data, lambda tile: 1, 2)
    link.request(0)
    link.wait(5)
    assert link.free_request_count == 2
    with pytest.raises(ZeroDivisionError):
        link.poll()


@pytest.mark.parametrize("name", ANSWERS)
def test_hostile_tile_is_one_line_and_leaves_the_other_drawn(name: str) -> None:
    """A tileset of two tiles, of which one is answered well."""
    metadata = {"class": "tile", "properties": {"bytes": [1000]}}
    tile = {"boundingVolume": foreign.box(100), "geometricError": 0, "metadata": metadata}
    child = {**tile, "content": {"uri": "bad.glb"}}
    root = {
        **tile,
        "refine": "ADD",
        "geometricError": 50,
        "content": {"uri": "good.glb"},
        "children": [child],
    }
    files = {
        "/a/tileset.json": foreign.tileset(root),
        "/a/good.glb": foreign.gltf(foreign.cloud(0)),
    }
    view = Frustum.from_camera(
        Camera.look_at((0, 0, 400), (0, 0, 0), up=(0, 1, 0), width=640, height=480)
    )
    lines: list[str] = []
    with hostile_server(ANSWERS[name], files) as server:
        options = SessionOptions(max_error=0.01, cache_bytes=0, fade_seconds=0)
        with closing(open_session(server.address, options, report=lines.append)) as session:
            end = time.monotonic() + 8
            frame = session.frame(view)
            while not frame.is_complete and time.monotonic() < end:
                session.wait(0.05)
                frame = session.frame(view)
            assert frame.is_complete
            assert [entry.tile for entry in frame.drawn] == [0]
            assert frame.absent_tiles == (1,)
            assert session._fetch_link.free_request_count == options.connections
        assert server.strangers == 0
    assert len(lines) == 1
    assert server.address_of("bad.glb") in lines[0]
    assert lines[0].isprintable()


@pytest.mark.parametrize("name", ["length-huge", "no-answer", "dripping-error-body"])
def test_size_that_a_server_does_not_tell_is_no_fault_of_the_tileset(name: str) -> None:
    tile = {"boundingVolume": foreign.box(100), "geometricError": 0, "refine": "ADD"}
    root = {**tile, "content": {"uri": "bad.glb"}, "children": [{**tile}]}
    files = {"/a/tileset.json": foreign.tileset(root)}
    view = Frustum.from_camera(
        Camera.look_at((0, 0, 400), (0, 0, 0), up=(0, 1, 0), width=64, height=48)
    )
    with (
        hostile_server(ANSWERS[name], files) as server,
        closing(open_session(server.address, SessionOptions(cache_bytes=0))) as session,
    ):
        end = time.monotonic() + 5
        frame = session.frame(view)
        while not frame.is_complete and time.monotonic() < end:
            session.wait(0.05)
            frame = session.frame(view)
        assert frame.absent_tiles == (0,)
        assert server.address_of("bad.glb") in session.first_failure


@pytest.mark.parametrize("failure", ["503:0.3", "cut:0.3", "stall:0.1"])
def test_picture_is_complete_although_many_answers_fail(
    town: Path, monkeypatch: pytest.MonkeyPatch, failure: str
) -> None:
    monkeypatch.setattr(tiles_source, "_RETRY_SECONDS", 0.1)
    faults = NetworkFaults(failures=(), seed=5)
    view = Camera.look_at((0, 0, 400), (0, 0, 0), up=(0, 1, 0), width=64, height=48)
    with served(town, faults) as address:
        settings = StreamSettings(max_error=0.1, cache_bytes=0)
        with closing(open_stream(Path(f"{address}tileset.json"), settings=settings)) as source:
            faults.failures = (parse_failure(failure),)
            source.update(view, {})
            assert source.shortfall is None
            assert source.count > 0
