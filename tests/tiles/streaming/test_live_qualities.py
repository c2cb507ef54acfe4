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
from gsgen.tiles.loading.quality_ladder import quality_ladder
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
    ladder = quality_ladder(tileset)
    assert ladder is not None
    assert (np.diff(ladder.worth.mean(axis=0)) < 0).all()
    for row, files in enumerate(ladder.files):
        assert [store.size(uri) for uri in files] == ladder.size[row].tolist()
    first_files = [files[0] for files in ladder.files]
    assert first_files == [tile.contents[0].uri for tile in tileset.tiles()]


@pytest.mark.parametrize(("quality", "steps"), [(0, 3), (2, 2), (4, 0)])
def test_no_file_is_finer_than_the_index_that_was_opened(
    town: Path, quality: int, steps: int
) -> None:
    tileset = load_tileset(FolderStore(town), f"tileset-q{quality}.json")
    ladder = quality_ladder(tileset)
    assert (0 if ladder is None else ladder.size.shape[1]) == steps
    if ladder:
        assert ladder.files[0][0] == tileset.root.contents[0].uri


@pytest.mark.parametrize("name", ["files", "bytes", "worth"])
def test_there_is_no_ladder_unless_every_tile_tells_all(
    town: Path, tmp_path: Path, name: str
) -> None:
    """Such a tileset is drawn from the files that its index names."""
    document = json.loads((town / "tileset.json").read_text())
    properties = document["root"]["children"][-1]["metadata"]["properties"]
    for entries in (None, properties[name][:2], "text"):
        properties[name] = entries
        (tmp_path / "tileset.json").write_text(json.dumps(document))
        assert quality_ladder(load_tileset(FolderStore(tmp_path), "tileset.json")) is None


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
