"""Sessions: flights over real and faulty servers always give a frame, within every budget."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

from gsgen.contract.fetching import client
from gsgen.formats import write_ply
from gsgen.runtime.scene.camera import Camera
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.loading.leaves import read_contents
from gsgen.tiles.loading.tileset_loader import load_tileset, open_tileset
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.serving.faults import FailureRule, NetworkFaults
from gsgen.tiles.serving.server import serve_folder
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.streaming.clock import SystemClock
from gsgen.tiles.streaming.contents import ContentReader
from gsgen.tiles.streaming.fetch import FetchLink
from gsgen.tiles.streaming.session import SessionOptions, TilesetSession, open_session
from gsgen.tiles.streaming.session_frame import SessionFrame
from support.tiles.builds import build
from support.tiles.tile_scenes import scattered


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_ply(folder / "scene.ply", scattered(12_000, degree=1))
    build([folder / "scene.ply"], folder / "tiles")
    return folder / "tiles"


@contextmanager
def served(folder: Path, faults: NetworkFaults | None = None) -> Iterator[str]:
    with serve_folder(folder, faults=faults) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.address
        finally:
            server.shutdown()
            thread.join()


def cameras(count: int) -> list[Frustum]:
    """A flight over the scene, towards its middle."""
    eyes = [(18 - 30 * i / count, -16 + 12 * i / count, 6.0) for i in range(count)]
    return [
        Frustum.from_camera(Camera.look_at(eye, (0.5, 0.2, 0), up=(0, 0, 1), width=640, height=360))
        for eye in eyes
    ]


OPTIONS = SessionOptions(slot_rows=128, max_splats=40_000, cache_bytes=0, max_error=4.0)


class Pool:
    """Follows the protocol as a renderer would, and checks every promise of it."""

    def __init__(self, session: TilesetSession) -> None:
        protocol = session
        self.session, self.slots = protocol, {}
        self.rows: dict[int, int] = {}  # uploaded, of tiles that are not whole
        self.parts = 0

    def take(self, frame: SessionFrame) -> None:
        for tile in frame.evicted:
            del self.slots[tile]
            assert tile not in self.rows
        sizes = [arrival.upload_bytes for arrival in frame.arrivals]
        assert sum(sizes) <= self.session.upload_budget or (
            len(sizes) == 1
            and frame.arrivals[0].end_row - frame.arrivals[0].first_row <= self.session.slot_rows
        )
        for arrival in frame.arrivals:
            assert self.rows.pop(arrival.tile, 0) == arrival.first_row
            if not arrival.is_last:
                self.rows[arrival.tile] = arrival.end_row
                self.parts += 1
                assert arrival.end_row % self.session.slot_rows == 0
            if arrival.first_row:
                continue
            assert arrival.tile not in self.slots
            assert arrival.rows.dtype == arrival.appearance.dtype == np.float32
            assert arrival.appearance.shape == (len(arrival.rows), 3 * 4)
            self.slots[arrival.tile] = -(-len(arrival.rows) // self.session.slot_rows)
        assert sum(self.slots.values()) <= self.session.pool_slots
        tiles = [entry.tile for entry in frame.drawn]
        assert tiles == sorted(set(tiles))
        assert set(tiles) <= self.slots.keys() - self.rows.keys()
        assert all(0 < entry.fade <= 1 for entry in frame.drawn)


def complete(session: TilesetSession, frustum: Frustum, pool: Pool) -> SessionFrame:
    for _ in range(600):
        frame = session.frame(frustum)
        pool.take(frame)
        if frame.is_complete:
            return frame
        session.wait(0.05)
    raise AssertionError("the cut never became complete")


def fly(source: str | Path, options: SessionOptions = OPTIONS, frames: int = 40):
    """Fly, hover until all is there; return the session, its last frame and its reports."""
    lines: list[str] = []
    session = open_session(source, options, report=lines.append)
    pool = Pool(session)
    path = cameras(frames)
    for frustum in path:
        pool.take(session.frame(frustum))
        session.wait(0.01)
    last = complete(session, path[-1], pool)
    return session, last, lines


def test_a_complete_cut_is_the_wanted_tiles(town: Path) -> None:
    session, last, lines = fly(town)
    cut = cut_tree(session.tree, cameras(40)[-1], 4.0)
    assert [entry.tile for entry in last.drawn] == np.flatnonzero(cut.selected).tolist()
    assert all(entry.fade == 1 for entry in last.drawn)
    assert len(last.drawn) > 5
    assert session.metrics.hole_frames < 40
    assert lines == []
    session.close()


def test_the_root_arrives_before_any_other_tile_is_requested(town: Path) -> None:
    session = open_session(town, OPTIONS)
    pool, frame = Pool(session), session.frame(cameras(2)[0])
    while not frame.arrivals:
        pool.take(frame)
        assert session.metrics.requests == 1
        session.wait(0.05)
        frame = session.frame(cameras(2)[0])
    assert [arrival.tile for arrival in frame.arrivals] == [0]
    pool.take(frame)
    assert complete(session, cameras(2)[0], pool).drawn
    assert session.metrics.requests > 5
    session.close()


def test_arrivals_hold_the_splats_of_their_tiles_in_morton_order(town: Path) -> None:
    session = open_session(town, replace(OPTIONS, fade_seconds=0))
    store, pool = FolderStore(town), Pool(session)
    tileset = load_tileset(store, "tileset.json")
    arrivals = {}
    for _ in range(300):
        frame = session.frame(cameras(2)[0])
        pool.take(frame)
        arrivals |= {arrival.tile: arrival for arrival in frame.arrivals}
        if frame.is_complete:
            break
        session.wait(0.05)
    assert len(arrivals) > 3
    for tile, arrival in arrivals.items():
        entry = session.tree.tiles[tile]
        (placed,) = read_contents(store, tileset, [(entry, entry.contents[0])])
        expected = placed.positions()
        actual = arrival.rows[:, :3] + arrival.origin
        key = np.lexsort(np.round(expected, 3).T), np.lexsort(np.round(actual, 3).T)
        np.testing.assert_allclose(actual[key[1]], expected[key[0]], atol=2e-3)
        if len(arrival.rows) < 200:
            continue
        steps = np.linalg.norm(np.diff(arrival.rows[:, :3], axis=0), axis=1).mean()
        shuffled = np.random.default_rng(0).permutation(arrival.rows[:, :3])
        assert steps < 0.5 * np.linalg.norm(np.diff(shuffled, axis=0), axis=1).mean()
    session.close()


def test_connections_are_filled_again_between_two_frames(town: Path) -> None:
    """A renderer of few frames gets more tiles a frame than there are connections."""
    options = replace(OPTIONS, connections=1, predictor="none", fade_seconds=0)
    session = open_session(town, options)
    link, pool, frustum = session._fetch_link, Pool(session), cameras(2)[0]
    arrivals, deadline, is_complete = [], monotonic() + 60, False
    while not is_complete:
        assert monotonic() < deadline
        frame = session.frame(frustum)
        pool.take(frame)
        arrivals.append(len(frame.arrivals))
        is_complete = frame.is_complete
        # The queue is empty, and all that was requested is decoded.
        while link.free_request_count < options.connections or link._results.qsize() < (
            len(session._planner.in_flight) + len(link._started_requests)
        ):
            assert monotonic() < deadline
            sleep(0.01)
    assert max(arrivals) > 2 * options.connections
    assert len(arrivals) <= sum(arrivals) / 2
    assert session.metrics.requests == sum(arrivals)
    session.close()


def test_the_queue_is_not_longer_than_frames_can_upload(town: Path) -> None:
    budget = 60_000
    options = replace(OPTIONS, connections=1, predictor="none", upload_budget=budget)
    session = open_session(town, options)
    pool, queued = Pool(session), []
    set_queue = session._fetch_link.queue

    def note(tiles: Iterable[int]) -> None:
        queued.append(list(tiles))
        set_queue(queued[-1])

    session._fetch_link.queue = note
    for _ in range(60):
        pool.take(session.frame(cameras(2)[0]))
        session.wait(0.02)
    sizes = [4 * 22 * int(session.tree.splats[tiles].sum()) for tiles in queued]
    assert 0 < max(sizes) <= 2 * budget
    session.close()


def test_a_small_pool_draws_a_coarser_cut_and_never_overflows(town: Path) -> None:
    options = replace(OPTIONS, max_splats=4000, upload_budget=20_000)
    session, last, _ = fly(town, options)
    assert last.is_complete
    assert 0 < sum(session.tree.splats[entry.tile] for entry in last.drawn) <= 4000
    session.close()


def test_a_tile_beyond_the_upload_budget_arrives_in_parts(town: Path) -> None:
    """No frame exceeds the budget, no part is drawn, and the same tiles are drawn in the end."""
    whole, last, _ = fly(town, OPTIONS)
    whole.close()
    budget = 3 * OPTIONS.slot_rows * 88
    session = open_session(town, replace(OPTIONS, upload_budget=budget))
    assert (session.tree.splats * 88 > budget).any()
    pool = Pool(session)
    for frustum in cameras(40):
        pool.take(session.frame(frustum))
        session.wait(0.01)
    parted = complete(session, cameras(40)[-1], pool)
    session.close()
    assert pool.parts > 5
    assert not pool.rows
    assert [entry.tile for entry in parted.drawn] == [entry.tile for entry in last.drawn]


def test_a_camera_inside_all_tiles_completes_in_a_small_pool(town: Path) -> None:
    """Tiles around a camera have an infinite error; levels that do not fit are left out."""
    tree = TileTree.of_tileset(open_tileset(town))
    inside = tree.center[0] + 1e-3
    contains_camera = (np.abs(inside - tree.center) <= np.abs(tree.half_axes).sum(axis=1)).all(
        axis=1
    )
    slots = -(-tree.splats[contains_camera] // OPTIONS.slot_rows)
    assert len(slots) > 1
    too_few = OPTIONS.slot_rows * (int(slots.sum()) - 1)
    session = open_session(town, replace(OPTIONS, max_splats=too_few, predictor="none"))
    view = Camera.look_at(inside, np.add(inside, (0, 9, 0)), up=(0, 0, 1), width=64, height=48)
    last = complete(session, Frustum.from_camera(view), Pool(session))
    assert last.drawn
    session.close()


def test_a_pool_is_no_larger_than_the_whole_tileset(town: Path) -> None:
    session = open_session(town, replace(OPTIONS, max_splats=10_000_000))
    slots = -(-session.tree.splats // OPTIONS.slot_rows)
    assert session.tree.is_counted
    assert session.pool_slots == slots.sum() < 10_000_000 / OPTIONS.slot_rows
    session.close()
    # Where the numbers of splats are estimates, tiles may need more than those.
    tree = replace(session.tree, is_counted=False)
    link = FetchLink(pytest.fail, pytest.fail, pytest.fail, 6)
    unknown = TilesetSession(
        tree, link, SystemClock(), replace(OPTIONS, max_splats=10_000_000), sh_degree=1
    )
    assert unknown.pool_slots == -(-10_000_000 // OPTIONS.slot_rows)


def test_a_tile_that_another_one_displaces_in_its_own_frame_is_not_uploaded(town: Path) -> None:
    """Tiles that are only prefetched fill the pool, more of them in a frame than it holds."""
    session = open_session(town, replace(OPTIONS, max_splats=2000, predictor="none"))
    reader = ContentReader(
        FolderStore(town), load_tileset(FolderStore(town), "tileset.json"), session.tree, None
    )
    away = Frustum.from_camera(
        Camera.look_at((900, 0, 0), (1000, 0, 0), up=(0, 0, 1), width=64, height=48)
    )
    pool, rng = Pool(session), np.random.default_rng(0)
    for _ in range(10):
        for tile in rng.choice(len(session.tree), 8, replace=False).tolist():
            if not session.resident[tile]:
                session._pending_arrivals[tile] = reader.decode(
                    tile, reader.fetch(tile, lambda count: None)
                )
        frame = session.frame(away)
        assert not {entry.tile for entry in frame.arrivals} & set(frame.evicted)
        pool.take(frame)
        assert set(pool.slots) == set(np.flatnonzero(session.resident).tolist())
    session.close()


@pytest.mark.parametrize(
    "failures",
    [
        (FailureRule(404, 0.3),),
        (FailureRule("cut", 0.3),),
        (FailureRule(503, 0.3),),
        (FailureRule("cut", 1.0),),
        (FailureRule("stall", 0.2),),
    ],
    ids=["404", "cut", "503", "all-cut", "stall"],
)
def test_a_faulty_server_still_gives_frames(
    town: Path, monkeypatch: pytest.MonkeyPatch, failures: tuple[FailureRule, ...]
) -> None:
    monkeypatch.setattr(client, "_BACKOFF_SECONDS", 0.01)
    monkeypatch.setenv("GSGEN_FETCH_SECONDS", "0.3")
    faults = NetworkFaults(failures=(), seed=1)
    with served(town, faults) as address:
        lines: list[str] = []
        source = f"{address}tileset.json"
        session = open_session(source, OPTIONS, report=lines.append)
        faults.failures = failures
        pool, path = Pool(session), cameras(20)
        for frustum in path:
            pool.take(session.frame(frustum))
            session.wait(0.02)
        frame = complete(session, path[-1], pool)
        kind, share = failures[0].failure, failures[0].share
        assert all(line.startswith(address) for line in lines)
        if kind == 404:
            assert lines
            assert all("404" in line for line in lines)
        if share == 1:
            assert frame.drawn == ()
            assert any("ended early" in line for line in lines)
        else:
            assert frame.drawn
        session.close()


def test_a_dead_tile_leaves_its_parent_drawn(town: Path) -> None:
    session = open_session(town, OPTIONS)
    path = cameras(40)
    cut = cut_tree(session.tree, path[-1], 4.0)
    victim = next(
        int(row)
        for row in np.flatnonzero(cut.selected)
        if cut.seen[session.tree.parent[row]] and session.tree.level[row] > 1
    )
    uri = session.tree.tiles[victim].contents[0].uri
    session.close()
    file = town / uri
    data = file.read_bytes()
    file.unlink()
    try:
        session, last, lines = fly(town)
        drawn = {entry.tile for entry in last.drawn}
        assert int(session.tree.parent[victim]) in drawn
        assert victim not in drawn
        assert len(lines) == 1
        assert uri in lines[0]
        session.close()
        file.write_bytes(data[: len(data) // 2])
        session, last, lines = fly(town)
        assert uri in lines[0]
        session.close()
    finally:
        file.write_bytes(data)


class _Redirect(BaseHTTPRequestHandler):
    target = ""

    def do_GET(self) -> None:
        self.send_response(302)
        self.send_header("Location", f"{type(self).target}{self.path.lstrip('/')}")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def do_HEAD(self) -> None:
        self.do_GET()

    def log_message(self, format: str, *args: object) -> None:
        pass


def test_redirects_to_another_origin_need_permission(town: Path) -> None:
    with served(town) as address:
        _Redirect.target = address
        with ThreadingHTTPServer(("127.0.0.1", 0), _Redirect) as server:
            thread = threading.Thread(target=server.serve_forever, args=(0.01,))
            thread.start()
            source = f"http://127.0.0.1:{server.server_address[1]}/tileset.json"
            try:
                with pytest.raises(TilesetInvalid, match="redirects to") as error:
                    open_session(source, OPTIONS)
                assert "--allow-origin" in error.value.hint
                allowed = replace(OPTIONS, allow_origins=(address,))
                session, last, _ = fly(source, allowed, 5)
                assert last.drawn
                session.close()
                _Redirect.target = source.removesuffix("tileset.json")
                with pytest.raises(TilesetInvalid, match="more than 5 redirects"):
                    open_session(source, OPTIONS)
            finally:
                server.shutdown()
                thread.join()


def test_second_session_reads_tiles_from_the_disk_cache(town: Path, tmp_path: Path) -> None:
    options = replace(OPTIONS, cache_bytes=1 << 24, cache_folder=tmp_path)
    log: list[str] = []
    with serve_folder(town, log=log.append) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            for _ in range(2):
                session, last, _ = fly(f"{server.address}tileset.json", options)
                session.close()
                log.append("again")
        finally:
            server.shutdown()
            thread.join()
    first, second = log[: log.index("again")], log[log.index("again") + 1 : -1]
    drawn = {session.tree.tiles[entry.tile].contents[0].uri for entry in last.drawn}
    assert drawn <= {line.split()[-1].lstrip("/") for line in first}
    # What was only prefetched depends on time, and may have been under way at the end.
    assert not drawn & {line.split()[-1].lstrip("/") for line in second}
