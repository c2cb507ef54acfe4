"""Coarse files of tiles come first, and the finest replace them in the end."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.loading.quality_ladder import load_ladder
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.streaming.contents import ContentReader
from gsgen.tiles.streaming.session import SessionOptions, open_session
from gsgen.tiles.streaming.tiles_source import open_stream
from support.tiles.builds import SMALL, build
from support.tiles.tile_scenes import scattered

pytestmark = pytest.mark.slow


VIEW = Camera.look_at((9, -7, 4), (0.5, 0.2, 0), up=(0, 0, 1), width=96, height=64)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_ply(folder / "scene.ply", scattered(8_000, degree=1))
    build([folder / "scene.ply"], folder / "tiles", replace(SMALL, qualities=(0, 2, 4)))
    return folder / "tiles"


def test_the_ladder_names_the_files_of_each_quality(town: Path) -> None:
    store = FolderStore(town)
    tileset = load_tileset(store, "tileset.json")
    ladder = load_ladder(store, "tileset.json", tileset)
    assert ladder is not None
    assert (np.diff(ladder.quality_scores) < 0).all()
    for quality, tiles in enumerate(ladder.tiles):
        for row, tile in enumerate(tiles):
            assert store.size(tile.contents[0].uri) == ladder.size[row, quality]
    assert [tile.contents[0].uri for tile in ladder.tiles[0]] == [
        tile.contents[0].uri for tile in tileset.tiles()
    ]


@pytest.mark.parametrize(("quality", "steps"), [(0, 3), (2, 2), (4, 0)])
def test_no_file_is_finer_than_the_index_that_was_opened(
    town: Path, quality: int, steps: int
) -> None:
    store, index = FolderStore(town), f"tileset-q{quality}.json"
    tileset = load_tileset(store, index)
    ladder = load_ladder(store, index, tileset)
    assert (0 if ladder is None else len(ladder.quality_scores)) == steps
    if ladder:
        assert ladder.tiles[0][0].contents[0].uri == tileset.root.contents[0].uri


def test_there_is_no_ladder_without_all_its_tilesets(town: Path, tmp_path: Path) -> None:
    for file_names in (("tileset-q0.json", "tileset-q2.json"), ()):
        folder = tmp_path / str(len(file_names))
        folder.mkdir()
        for name in ("tileset.json", *file_names):
            (folder / name).write_bytes((town / name).read_bytes())
        store = FolderStore(folder)
        assert load_ladder(store, "tileset.json", load_tileset(store, "tileset.json")) is None
    other = json.loads((town / "tileset-q4.json").read_text())
    other["root"]["children"].pop()
    for name in ("tileset-q0.json", "tileset-q2.json"):
        (folder / name).write_bytes((town / name).read_bytes())
    (folder / "tileset-q4.json").write_text(json.dumps(other))
    assert load_ladder(store, "tileset.json", load_tileset(store, "tileset.json")) is None


def test_coarse_files_come_first_and_the_finest_in_the_end(town: Path, tmp_path: Path) -> None:
    """Every tile in view ends with the rows of its finest file, in its own slots."""
    options = SessionOptions(
        max_error=2.0, cache_bytes=0, fade_seconds=0, slot_rows=128, log=tmp_path / "events.jsonl"
    )
    session = open_session(town, options)
    frustum, latest, qualities = Frustum.from_camera(VIEW), {}, {}
    for _ in range(600):
        frame = session.frame(frustum)
        for arrival in frame.arrivals:
            assert arrival.is_upgrade == (arrival.tile in latest)
            if arrival.is_upgrade:
                assert len(arrival.rows) == len(latest[arrival.tile].rows)
                assert arrival.quality < qualities[arrival.tile][-1]
            latest[arrival.tile] = arrival
            qualities.setdefault(arrival.tile, []).append(arrival.quality)
        if frame.is_complete:
            break
        session.wait(0.05)
    assert frame.is_complete
    assert {tile: quality[0] for tile, quality in qualities.items()} == dict.fromkeys(qualities, 2)
    store = FolderStore(town)
    tileset = load_tileset(store, "tileset-q0.json")
    reader = ContentReader(store, tileset, TileTree.of_tileset(tileset, store), None)
    assert len(frame.drawn) > 4
    for entry in frame.drawn:
        expected = reader.decode(entry.tile, reader.fetch(entry.tile, lambda count: None))
        np.testing.assert_array_equal(latest[entry.tile].rows, expected.rows)
        assert qualities[entry.tile][-1] == 0
    session.close()


def test_a_window_draws_the_finest_qualities_in_the_end(town: Path) -> None:
    renderer = Renderer(Device.open(), rasteriser="tiles")
    settings = StreamSettings(max_error=2.0, wait=0)
    live = open_stream(town, settings=settings)
    player = Player([live], renderer=renderer)
    frame = player.render(FrameRequest(VIEW))
    for _ in range(600):
        frame = player.render(FrameRequest(VIEW))
        if not live.is_streaming:
            break
        live._session.wait(0.05)  # type: ignore[attr-defined]
    live.close()
    still = open_stream(town, settings=replace(settings, wait=30.0))
    expected = Player([still], renderer=renderer).render(FrameRequest(VIEW))
    still.close()
    np.testing.assert_allclose(frame.rgba, expected.rgba, atol=1e-6)
