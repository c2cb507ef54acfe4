"""A tileset is drawn as its splats are, whatever the network does."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import write_ply
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.placed_source import DrawSettings, PlacedSource
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.loading.leaves import open_splats
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.serving.faults import FailureRule, NetworkFaults
from gsgen.tiles.streaming import tiles_source
from gsgen.tiles.streaming.session import SessionOptions, open_session
from gsgen.tiles.streaming.tiles_source import TilesSource, open_stream
from support.commands import gsgen_here
from support.tiles.builds import build
from support.tiles.serving import served
from support.tiles.tile_scenes import scattered

VIEW = Camera.look_at((9, -7, 4), (0.5, 0.2, 0), up=(0, 0, 1), width=96, height=64)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_ply(folder / "scene.ply", scattered(6_000, degree=1))
    build([folder / "scene.ply"], folder / "tiles")
    return folder / "tiles"


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


def psnr(a: np.ndarray | None, b: np.ndarray | None) -> float:
    assert a is not None
    assert b is not None
    return float(10 * np.log10(1 / np.mean((a - b) ** 2)))


def test_a_complete_cut_of_leaves_is_the_picture_of_all_splats(
    town: Path, renderer: Renderer
) -> None:
    source = open_stream(town / "tileset.json", settings=StreamSettings(max_error=0.01))
    frame = Player([source], renderer=renderer).render(FrameRequest(VIEW))
    splats = SplatData.from_splats(open_splats(town / "tileset.json"))
    expected = renderer.render(Scene([splats]), VIEW)
    assert 0.95 * len(splats) < source.count <= len(splats)  # tiles out of view are not drawn
    assert not source.is_streaming
    assert frame.visible == expected.visible
    assert psnr(frame.rgba, expected.rgba) > 60
    source.close()


def test_tiles_of_a_film_come_before_their_frames(town: Path) -> None:
    """Over a slow network, a session that knows the cameras has the tiles of the next frame."""
    first = Camera.look_at((9, -7, 4), (9, -14, 4), up=(0, 0, 1), width=96, height=64)
    frustums = [Frustum.from_camera(camera) for camera in (first, VIEW)]
    hits = []
    for is_known in (False, True):
        with served(town, NetworkFaults(latency=0.01)) as address:
            options = SessionOptions(max_error=4.0, cache_bytes=0, fade_seconds=0)
            session = open_session(f"{address}tileset.json", options)
            if is_known:
                session.expect(frustums)
            for _ in range(60):
                frame = session.frame(frustums[0])
                session.wait(0.05)
            assert frame.is_complete
            hits.append(session.frame(frustums[1]).missing == 0)
            session.close()
    assert hits == [False, True]


def test_no_frame_writes_more_than_the_upload_budget(
    town: Path, renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tiles larger than the budget arrive in parts: the bytes of all queue writes are counted."""
    writes: list[int] = []
    write = Device.write

    def count(self: Device, buffer: Any, data: np.ndarray, offset: int = 0) -> None:
        if buffer.label in {"rows of a pool", "appearance of a pool"}:
            writes.append(data.nbytes)
        write(self, buffer, data, offset)

    monkeypatch.setattr(Device, "write", count)
    pictures, most = [], []
    for budget in (3 * 128 * (40 + 48), 4 << 20):
        options = SessionOptions(
            max_error=0.01, cache_bytes=0, slot_rows=128, upload_budget=budget, fade_seconds=0
        )
        session = open_session(town, options)
        source = TilesSource("town", session, up=(0, 0, 1), extent=(np.zeros(3), 1.0), wait=0)
        player, sizes = Player([source], renderer=renderer), []
        for _ in range(600):
            frame = player.render(FrameRequest(VIEW))
            sizes.append(sum(writes))
            writes.clear()
            if not source.is_streaming:
                break
            session.wait(0.05)
        assert max(sizes) <= budget
        assert sum(sizes) == session.tree.splats[session.resident].sum() * (40 + 48)
        pictures.append(frame.rgba)
        most.append(max(sizes))
        source.close()
    assert most[0] < most[1]
    np.testing.assert_array_equal(pictures[0], pictures[1])


def test_a_coarse_cut_draws_fewer_splats_and_nearly_the_same_picture(
    town: Path, renderer: Renderer
) -> None:
    source = open_stream(town, settings=StreamSettings(max_error=64))
    frame = Player([source], renderer=renderer).render(FrameRequest(VIEW))
    expected = renderer.render(Scene([SplatData.from_splats(open_splats(town))]), VIEW)
    assert 0 < source.count < 0.7 * 6000
    assert psnr(frame.rgba, expected.rgba) > 20
    source.close()


def test_a_placed_tileset_follows_its_transform_and_settings(
    town: Path, renderer: Renderer
) -> None:
    transform = np.diag([2.0, 2, 2, 1])
    transform[:3, 3] = 1, 2, 3
    inner = open_stream(town, settings=StreamSettings(max_error=0.01))
    placed = PlacedSource(inner, transform, DrawSettings(opacity_scale=0.5, sh_degree=0))
    eye, target = (transform[:3, :3] @ p + transform[:3, 3] for p in ([9, -7, 4], [0.5, 0.2, 0]))
    view = Camera.look_at(tuple(eye), tuple(target), up=(0, 0, 1), width=96, height=64)
    frame = Player([placed], renderer=renderer).render(FrameRequest(view))
    splats = SplatData.from_splats(open_splats(town))
    still = tiles_source.SplatSet(splats, transform, opacity_scale=0.5, degree=0)
    assert psnr(frame.rgba, renderer.render(Scene([still]), view).rgba) > 60
    placed.close()


class SteppingClock:
    """A clock that stands still until it is moved."""

    time = 0.0

    def now(self) -> float:
        return self.time


def test_a_fade_has_no_hole_and_no_pop(town: Path, renderer: Renderer) -> None:
    """A camera comes nearer in one step: finer tiles take the place of coarser ones in 15 frames."""
    session = open_session(town, SessionOptions(max_error=4.0, cache_bytes=0, slot_rows=128))
    clock = SteppingClock()
    session._clock = clock
    source = TilesSource("town", session, up=(0, 0, 1), extent=(np.zeros(3), 1.0), wait=0)
    player = Player([source], renderer=renderer)
    far = Camera.look_at((90, -70, 40), (0.5, 0.2, 0), up=(0, 0, 1), width=96, height=64)
    for view in (far, VIEW):  # all tiles of both cuts arrive, and the far one is drawn
        while True:
            player.render(FrameRequest(view))
            clock.time += 1.0
            if not source.is_streaming:
                break
            session.wait(0.05)
    zoomed = Camera.look_at(
        (90, -70, 40), (0.5, 0.2, 0), up=(0, 0, 1), width=96, height=64, fov_y=4
    )
    while True:
        before = player.render(FrameRequest(zoomed)).rgba
        if not source.is_streaming:
            break
        clock.time += 1.0
    # The limit of the error changes, and not the camera: pictures differ by their levels alone.
    session._options = SessionOptions(max_error=400.0, cache_bytes=0, slot_rows=128)
    clock.time += 30  # a window that stood still
    pictures = [before]
    for _ in range(20):
        clock.time += 1 / 60
        pictures.append(player.render(FrameRequest(zoomed)).rgba)
    assert not source.is_streaming
    images = np.stack([picture for picture in pictures if picture is not None])
    total = np.abs(images[-1] - images[0]).max()
    steps = np.abs(np.diff(images, axis=0)).max()
    solid = np.minimum(images[0][..., 3], images[-1][..., 3])
    opacity_dip = (solid - images[..., 3].min(axis=0)).max()
    print(f"change {total:.3f}, largest step {steps:.3f}, largest hole {opacity_dip:.3f}")
    assert total > 0.1
    assert steps < 0.35 * total
    assert opacity_dip < 0.26  # two opaque layers at half of their opacity let a quarter through
    source.close()


def test_render_draws_a_picture_despite_server_faults(town: Path, tmp_path: Path) -> None:
    for failure in ("404", "503", "cut"):
        faults = NetworkFaults(failures=(FailureRule(failure, 0.4),), seed=3)  # type: ignore[arg-type]
        index = town / "tileset.json"
        copy = tmp_path / failure
        copy.mkdir()
        with served(town, faults) as address:
            completed = gsgen_here(
                *("render", f"{address}/{index.name}", "-o", tmp_path / f"{failure}.png"),
                *("--width", "64", "--height", "48", "--wait", "4", "--cache", "0"),
            )
            for _ in range(20):  # the index itself may fail
                if (tmp_path / f"{failure}.png").exists():
                    break
                completed = gsgen_here(
                    *("render", f"{address}/{index.name}", "-o", tmp_path / f"{failure}.png"),
                    *("--width", "64", "--height", "48", "--wait", "4", "--cache", "0"),
                )
        assert completed.code == (4 if " missing, or " in completed.err else 0), completed.err
        assert np.asarray(Image.open(tmp_path / f"{failure}.png")).max() > 20
        assert "Traceback" not in completed.err


def test_a_scene_file_places_a_tileset_among_others(town: Path, tmp_path: Path) -> None:
    write_ply(tmp_path / "ball.ply", scattered(50, degree=0))
    document = {
        "gsgen_scene": "1.0",
        "models": [
            {"path": str(town / "tileset.json"), "translate": [1, 0, 0]},
            {"path": "ball.ply"},
        ],
    }
    (tmp_path / "scene.json").write_text(json.dumps(document))
    completed = gsgen_here(
        *("render", tmp_path / "scene.json", "-o", tmp_path / "a.png", "--sse", "0.1"),
        *("--width", "192", "--height", "144", "--json"),
    )
    assert completed.code == 0, completed.err
    assert json.loads(completed.out)["gaussians"] == 6050


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--cache", "lots"], "--cache: 'lots' is not a number of bytes"),
        (["--predictor", "crystal-ball"], "crystal-ball"),
    ],
)
def test_invalid_options_state_the_expected_values(
    town: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    completed = gsgen_here("render", town / "tileset.json", "-o", tmp_path / "a.png", *words)
    assert completed.code == 2
    assert message in completed.err
    assert not (tmp_path / "a.png").exists()
