"""A streamed SOG is drawn by the planner of tilesets, from files that each come once."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import open_splats, write_ply
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.source import StillFrameSource
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.stores.http_store import HttpStore
from gsgen.tiles.streaming.session import SessionOptions, open_session
from gsgen.tiles.streaming.tiles_source import TilesSource, open_stream
from support.commands import gsgen_here
from support.tiles.builds import build
from support.tiles.serving import served
from support.tiles.tile_scenes import scattered
from tiles.build.test_streamed_sog import STREAMED

VIEW = Camera.look_at((9, -7, 4), (0.5, 0.2, 0), up=(0, 0, 1), width=96, height=64)
FAR = Camera.look_at((90, -70, 40), (0.5, 0.2, 0), up=(0, 0, 1), width=96, height=64)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_ply(folder / "scene.ply", scattered(6_000))
    build([folder / "scene.ply"], folder / "sog", STREAMED)
    return folder / "sog"


def test_a_complete_cut_is_the_picture_of_all_splats(town: Path) -> None:
    renderer = Renderer(Device.open(), rasteriser="tiles")
    splats = SplatData.from_splats(open_splats(town / "lod-meta.json"))
    expected = renderer.render(Scene([splats]), VIEW)
    source = open_stream(town / "lod-meta.json", settings=StreamSettings(max_error=0.01))
    frame = Player([source], renderer=renderer).render(FrameRequest(VIEW))
    assert frame.visible == expected.visible
    assert np.mean((frame.rgba - expected.rgba) ** 2) < 1e-6
    source.close()
    # From afar, coarse levels are enough.
    source = open_stream(town / "lod-meta.json", settings=StreamSettings())
    Player([source], renderer=renderer).render(FrameRequest(FAR))
    assert source.count < len(splats) / 3
    source.close()


def stream_all(address: str, cache_folder: Path) -> None:
    """Stream until a camera has all that it needs, in a session of its own."""
    options = SessionOptions(max_error=0.01, cache_folder=cache_folder)
    session = open_session(f"{address}lod-meta.json", options)
    frame = session.frame(Frustum.from_camera(VIEW))
    while not frame.is_complete:
        session.wait(0.05)
        frame = session.frame(Frustum.from_camera(VIEW))
    session.close()
    assert frame.missing == 0


def test_a_server_is_asked_for_each_file_once(
    town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first session reads no file twice, and keeps all on disk for the second one."""
    asked: list[str] = []
    read = HttpStore.read

    def count(store: HttpStore, path: str, **rest: Any) -> bytes:
        if "on_bytes" in rest:  # of a tile
            asked.append(path)
        return read(store, path, **rest)

    monkeypatch.setattr(HttpStore, "read", count)
    counts = []
    with served(town) as address:
        for _ in range(2):
            stream_all(address, tmp_path / "cache")
            counts.append(len(asked))
    assert len(asked) == len(set(asked))
    assert any(path.endswith(".webp") for path in asked)
    assert counts == [len(asked)] * 2


def test_files_without_a_digest_are_kept_while_their_server_has_the_same(
    town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of files as other programs name them, a second session reads those that have changed."""
    folder = tmp_path / "foreign"
    shutil.copytree(town, folder)
    index = json.loads((folder / "lod-meta.json").read_text())
    for number, name in enumerate(index["filenames"]):
        (folder / name).parent.rename(folder / str(number))
        index["filenames"][number] = f"{number}/meta.json"
    (folder / "lod-meta.json").write_text(json.dumps(index))
    sent: list[str] = []
    read_version = HttpStore.read_version

    def count(store: HttpStore, path: str, *rest: Any) -> tuple[bytes | None, str]:
        data, validator = read_version(store, path, *rest)
        if data is not None:
            sent.append(path)
        return data, validator

    monkeypatch.setattr(HttpStore, "read_version", count)
    counts = []
    with served(folder) as address:
        for _ in range(3):
            stream_all(address, tmp_path / "cache")
            counts.append(len(sent))
            if len(counts) == 2:
                os.utime(folder / sent[0], (0, 0))  # another version, as far as the server tells
    assert counts == [len(set(sent)), counts[0], counts[0] + 1]
    assert sent[-1] == sent[0]


def test_a_folder_or_address_may_hold_a_streamed_sog(town: Path) -> None:
    """Where there is no tileset.json, lod-meta.json is read; validation is for tilesets alone."""
    with served(town) as address:
        for source in (town, address):
            result = gsgen_here("tiles", "info", source)
            assert (result.code, result.err) == (0, "")
            assert "6,000 in leaves" in result.out
        result = gsgen_here("tiles", "info", f"{address}none/")
        assert result.code == 4
        assert "none/tileset.json" in result.err
        assert "lod-meta.json" not in result.err
        result = gsgen_here("validate", address)
        assert result.code == 4
        assert "tileset.json" in result.err


def test_frames_stream_what_conversions_read_whole(town: Path, tmp_path: Path) -> None:
    path = town / "lod-meta.json"
    assert isinstance(open_source(path), StillFrameSource)
    source = open_source(path, stream=lambda path, provider: open_stream(path, provider))
    assert isinstance(source, TilesSource)
    source.close()
    whole = tmp_path / "whole.ply"
    gsgen_here("convert", path, whole)
    assert len(open_splats(whole)) == 6_000
    pictures = []
    with served(town) as address:
        for scene in (path, f"{address}lod-meta.json", whole):
            gsgen_here("render", scene, "-o", tmp_path / "frame.png", "--size", "64x48")
            pictures.append(np.asarray(Image.open(tmp_path / "frame.png"), np.float64))
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.abs(pictures[0] - pictures[2]).mean() < 0.2 * np.abs(pictures[2]).mean()
