"""What is on the surface after what was done, pixel by pixel."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.errors import SceneUnreadable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.media.pictures import PICTURE_MODES, picture_of
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.playback.post_process import PostProcessor
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import MeshData
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_source import SceneSource, sources_of
from gsgen.runtime.sources.source import GeneratorSource
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from support.rendering.failing_devices import memory_of
from support.rendering.viewers import SIZE, Hand


def expected(
    hand: Hand, painter: SurfaceRenderer, mode: str = "color", **options: object
) -> np.ndarray:
    """Return what `gsgen render` would draw."""
    viewer = hand.viewer
    camera = viewer.controls.camera(*SIZE)
    frame = painter.renderer.render(
        viewer.playback.scene(),
        camera,
        outputs=(PICTURE_MODES[mode],),
        background=(0, 0, 0, 1),
        **options,
    )
    result = picture_of(frame, mode, viewer.playback.depths(camera))
    result = result[..., :3] if result.ndim == 3 else np.repeat(result[..., None], 3, axis=-1)
    return result.astype(int)


@pytest.mark.parametrize(("key", "mode"), list(zip("12345", PICTURE_MODES, strict=True)))
def test_each_mode_is_that_of_render(
    still: Hand, painter: SurfaceRenderer, key: str, mode: str
) -> None:
    still.key(key)
    result = still.bare()[..., :3]
    reference = expected(still, painter, mode)
    assert np.abs(result - reference).max() <= 1
    assert len(np.unique(reference)) > 20  # there is something to be compared


@pytest.mark.parametrize("key", ["1", "2"])
def test_a_window_larger_than_a_buffer_is_drawn_in_bands(
    still: Hand, painter: SurfaceRenderer, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    still.key(key)
    expected = still.bare()
    drawn = painter.drawn
    monkeypatch.setattr(painter.renderer.device, "largest_binding", 16 * SIZE[0] * 33)
    monkeypatch.setattr(painter.renderer, "_pairs", 4 * SIZE[0] * 33)
    painter._last_view = None
    other = Hand(still.viewer.playback, painter)
    other.key(key)
    assert np.array_equal(other.bare(), expected)
    assert [band.first for band in painter._last_view[1].bands] == [0, 32, 64, 96]
    assert painter.drawn.visible >= drawn.visible > 0


def test_linear_colours_are_shown_as_srgb(cloud: SplatData, painter: SurfaceRenderer) -> None:
    hand = Hand(LivePlayback(sources_of(Scene([cloud], "linear"))), painter)
    original = Hand(LivePlayback(sources_of(cloud)), painter).bare()
    result = hand.bare()
    assert np.abs(result[..., :3] - expected(hand, painter)).max() <= 1
    assert result[..., :3].mean() > original[..., :3].mean() + 1


def test_dragging_orbits_and_r_resets(still: Hand) -> None:
    first = still.bare()
    still.drag((80, 60), (110, 70))
    turned = still.bare()
    assert np.abs(turned - first).mean() > 2
    still.key("r")
    assert np.array_equal(still.bare(), first)


def test_shift_middle_and_right_drags_are_other_drags(still: Hand) -> None:
    first, ends = still.bare(), ((80, 60), (110, 70))
    results = {}
    for button, modifiers in ((1, ()), (1, ("Shift",)), (2, ()), (3, ())):
        still.drag(*ends, button, *modifiers)
        results[button, modifiers] = still.bare()
        still.key("r")
    assert np.array_equal(results[1, ("Shift",)], results[3, ()])
    others = [first, results[1, ()], results[3, ()], results[2, ()]]
    for number, entry in enumerate(others):
        for other in others[:number]:
            assert not np.array_equal(entry, other)


def test_moving_without_a_button_has_no_effect(still: Hand) -> None:
    first = still.bare()
    still.send("pointer_move", x=9, y=9, button=0, modifiers=())
    assert np.array_equal(still.bare(), first)


def test_keys_fly_while_they_are_held(still: Hand) -> None:
    still.look()
    eye = still.viewer.controls.eye
    still.press("w")
    still.look(0.1)
    near = still.viewer.controls.eye
    assert near[2] > eye[2]
    still.send("key_up", key="w", modifiers=())
    still.look(0.1)
    np.testing.assert_array_equal(still.viewer.controls.eye, near)
    still.press("Shift", "Shift")
    still.press("W", "Shift")
    still.look(0.1)
    fast = still.viewer.controls.eye
    assert fast[2] - near[2] == pytest.approx(4 * (near[2] - eye[2]))


def test_double_click_focuses_the_surface_point(painter: SurfaceRenderer) -> None:
    row = np.array([[0.6, 0.3, 0.5, 0.95, 0.01, 0, 0, 0.01, 0, 0.01]], np.float32)
    hand = Hand(
        LivePlayback(sources_of(SplatData(row, np.ones((1, 3), np.float32), "rgb"))), painter
    )
    brightness = hand.bare()[..., :3].sum(axis=-1)
    y, x = np.unravel_index(brightness.argmax(), brightness.shape)
    hand.send("double_click", x=float(x), y=float(y), button=1, modifiers=())
    np.testing.assert_allclose(hand.viewer.controls.pivot, row[0, :3], atol=0.02)
    after = hand.bare()[..., :3].sum(axis=-1)
    assert after[60, 80] > 0.9 * brightness.max()
    hand.send("double_click", x=2.0, y=2.0, button=1, modifiers=())  # nothing is there
    np.testing.assert_allclose(hand.viewer.controls.pivot, row[0, :3], atol=1e-6)


def test_keys_cycle_harmonics_antialiasing_and_backgrounds(still: Hand) -> None:
    first = still.bare()
    actual = [first]
    for _ in range(4):
        still.key("g")
        actual.append(still.bare())
    assert still.viewer.playback.sh_degree == 3
    assert not np.array_equal(actual[1], first)  # degree 0
    assert np.array_equal(actual[4], first)  # 3 is more than there is
    still.key("g")
    still.key("x")
    still.key("x")
    assert still.viewer.playback.antialias == "mip"
    assert not np.array_equal(still.bare(), first)
    still.key("x")
    still.key("b")
    assert still.bare()[0, 0].tolist() == [255, 255, 255, 255]
    for _ in range(3):
        still.key("b")
    assert np.array_equal(still.bare(), first)


def test_help_and_numbers_lie_over_the_picture(still: Hand) -> None:
    bare = still.bare()
    message = still.look()
    changed = np.abs(message - bare).max(axis=-1) > 0
    assert changed[10:40, 10:60].mean() > 0.9  # its paper
    assert not changed[:9].any()
    assert not changed[:, :9].any()
    still.key("h")
    helped = still.look()
    assert (np.abs(helped - bare).max(axis=-1) > 0).mean() > 0.5
    still.key("Escape")  # closes the help first
    assert not still.viewer.closed
    assert np.array_equal(still.look(), message)
    still.key("Escape")
    assert still.viewer.closed


def test_playback_keeps_its_frame_rate(moving: Hand) -> None:
    moving.settled()
    assert moving.viewer.playback.number == 0
    moving.key(" ")
    numbers = []
    for _ in range(12):
        moving.look(0.1)
        numbers.append(moving.viewer.playback.number)
    assert numbers[:3] == [1, 2, 3]
    assert numbers[-2:] == [0, 1]  # it begins again
    moving.key(" ")
    moving.look(1.0)
    assert moving.viewer.playback.number == 1


def test_a_frame_of_the_slider_is_that_of_a_film(
    moving: Hand, drift: Path, painter: SurfaceRenderer
) -> None:
    first = moving.settled()
    slider = moving.viewer.slider
    assert slider is not None
    y = slider.corner[1] + 5
    for x in range(slider.corner[0], SIZE[0]):
        if slider.fraction(x) > 0.45:
            break
    moving.drag((x, y), (x, y))
    number = moving.viewer.playback.number
    assert number in (4, 5, 6)
    result = moving.bare()
    source = GeneratorSource(drift)
    source.update(None, {"time": number / 10})
    frame = painter.renderer.render(
        Scene([source.data]), moving.viewer.controls.camera(*SIZE), background=(0, 0, 0, 1)
    )
    source.close()
    above = slice(0, slider.corner[1])
    assert np.abs(result[above, :, :3] - frame.srgb8[above, :, :3].astype(int)).max() <= 1
    assert not np.array_equal(result[above], first[above])
    moving.key("ArrowLeft")
    assert moving.viewer.playback.number == number - 1
    moving.key("Home")
    moving.key("ArrowLeft")
    assert moving.viewer.playback.number == 10
    moving.drag((slider.corner[0] + 3, y), (slider.corner[0] + 3, y))
    assert moving.viewer.playback.playing


def test_pictures_go_on_while_a_model_computes(
    moving: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera follows the hand; the frame is taken when it is done."""
    moving.settled()
    is_ready = [False]
    monkeypatch.setattr(GeneratorSource, "ready", property(lambda self: is_ready[0]))
    before = moving.bare()
    moving.key("ArrowRight")
    moving.look()
    assert moving.viewer.playback.busy
    version = moving.viewer.playback.version
    moving.drag((80, 50), (110, 60))
    turned = moving.look()
    assert np.abs(turned - before).mean() > 0.5
    assert moving.viewer.playback.busy
    assert moving.viewer.playback.version == version
    is_ready[0] = True
    moving.look()
    assert moving.viewer.playback.version == version + 1


def test_error_is_shown_and_the_window_stays(moving: Hand, monkeypatch: pytest.MonkeyPatch) -> None:
    moving.settled()

    def fail(self: GeneratorSource) -> None:
        raise ConfigInvalid("is 7", where="drift.onnx, frame 1")

    with monkeypatch.context() as patch:
        patch.setattr(GeneratorSource, "finish", fail)
        moving.key("ArrowRight")
        for _ in range(200):
            moving.look()
            if moving.viewer.message:
                break
            time.sleep(0.01)
        assert "drift.onnx, frame 1: is 7" in moving.viewer.message
    moving.key("ArrowRight")
    moving.settled()
    assert moving.viewer.message == ""


def test_p_saves_the_picture_and_a_camera_that_render_takes(
    cloud: SplatData, painter: SurfaceRenderer, tmp_path: Path
) -> None:
    hand = Hand(LivePlayback(sources_of(cloud)), painter, folder=tmp_path / "new")
    hand.drag((80, 60), (110, 70))
    expected = hand.bare()
    hand.key("p")
    hand.key("p")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "view_001.json",
        "view_001.png",
        "view_002.json",
        "view_002.png",
    ]
    with Image.open(tmp_path / "new/view_001.png") as image:
        assert np.abs(np.asarray(image).astype(int) - expected).max() <= 1
    file = tmp_path / "new/view_001.json"
    camera = viewpoint(str(file)).cameras[0]
    np.testing.assert_allclose(camera.view, hand.viewer.controls.camera(*SIZE).view)
    assert json.loads(hand.said[0]) == json.loads(file.read_text())
    assert str(file) in hand.said[1]


def test_another_size_is_another_picture(still: Hand, painter: SurfaceRenderer) -> None:
    still.look()
    still.canvas.set_logical_size(90, 70)
    still.key("i")
    result = still.look()
    assert result.shape == (70, 90, 4)
    camera = still.viewer.controls.camera(90, 70)
    frame = painter.renderer.render(still.viewer.playback.scene(), camera, background=(0, 0, 0, 1))
    assert np.abs(result - frame.srgb8.astype(int)).max() <= 1


def test_a_lost_device_is_opened_again(cloud: SplatData) -> None:
    opened: list[Device] = []

    def open_device() -> Device:
        opened.append(Device.open())
        return opened[-1]

    hand = Hand(LivePlayback(sources_of(cloud)), SurfaceRenderer(open_device))
    before = hand.bare()
    opened[0].raw.destroy()
    hand.look()
    assert len(opened) == 2
    assert "lost" in hand.viewer.message
    hand.key("i")
    assert np.array_equal(hand.look(), before)
    hand.drag((80, 60), (90, 60))
    assert not np.array_equal(hand.look(), before)  # and it is drawn there


def test_viewer_does_not_wait_for_the_gpu(cloud: SplatData, painter: SurfaceRenderer) -> None:
    device = Device(painter.renderer.device.raw)
    device.software = False
    gpu = SurfaceRenderer(lambda: device, rasteriser="tiles")
    hand = Hand(LivePlayback(sources_of(cloud)), gpu)
    hand.press("w")
    for _ in range(20):  # the first ones are coarser, and each size begins with a wait
        hand.look(0.3)
        if gpu.renderer.late_counts:
            break
    rows = dict(hand.viewer._overlay.statistics.rows)
    assert rows["counts"].startswith("2 frames late, waited ")
    gpu.renderer.growths += 3
    hand.look(0.3)
    rows = dict(hand.viewer._overlay.statistics.rows)
    assert rows["buffers"] == f"grew {gpu.renderer.growths}×"
    hand.send("key_up", key="w", modifiers=())
    last = [hand.bare() for _ in range(3)][-1]
    assert not gpu.renderer.late_counts
    other = Hand(LivePlayback(sources_of(cloud)), painter)
    other.viewer.controls = hand.viewer.controls
    assert np.abs(other.bare().astype(int) - last).max() <= 1


def test_out_of_memory_is_shown(still: Hand) -> None:
    still.canvas.set_logical_size(400, 300)
    with memory_of(1 << 20):
        empty_picture = still.look()
    assert "memory of" in still.viewer.message
    assert "smaller image" in still.viewer.message
    assert empty_picture[-1, :, :3].max() == 0  # nothing is behind the message
    still.key("i")
    assert still.look()[..., :3].max() > 60  # it is tried again


def test_dropped_files_replace_the_scene(
    moving: Hand, cloud: SplatData, painter: SurfaceRenderer, tmp_path: Path
) -> None:
    path = tmp_path / "other.npz"
    np.savez(path, gaussians=cloud.rows, appearance=cloud.appearance)
    hand = Hand(
        LivePlayback(sources_of(cloud)),
        painter,
        open_files=lambda paths: LivePlayback(sources_of(paths)),
    )
    hand.settled()
    hand.viewer.drop([tmp_path / "nothing.ply"])
    assert "nothing.ply" in hand.viewer.message
    assert hand.viewer.playback.frames == 1
    hand.viewer.drop([path])
    assert hand.viewer.message == ""
    assert hand.viewer.playback.sources[0].name == str(path)
    assert hand.bare()[..., :3].max() > 60


def test_events_are_passed_to_callbacks(
    cloud: SplatData, painter: SurfaceRenderer, tmp_path: Path
) -> None:
    events: list[dict[str, object]] = []
    dropped_file = tmp_path / "again.ply"
    options = {"folder": tmp_path, "on_event": events.append}
    options["open_files"] = lambda paths: LivePlayback(sources_of(cloud))
    hand = Hand(LivePlayback(sources_of(cloud)), painter, **options)
    hand.look()
    hand.key("p")
    hand.viewer.drop([dropped_file])
    assert events == [
        {
            "event": "picture",
            "path": str(tmp_path / "view_001.png"),
            "camera": str(tmp_path / "view_001.json"),
        },
        {"event": "opened", "scenes": [str(dropped_file)]},
    ]
    assert json.loads(json.dumps(events)) == events
    assert hand.said == []


def test_unreadable_files_are_reported(tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_bytes(b"nothing")
    with pytest.raises(SceneUnreadable, match=r"bad\.ply"):
        sources_of(tmp_path / "bad.ply")


@pytest.mark.parametrize("kind", ["orthographic", "panorama"])
def test_other_cameras_are_looked_through_too(
    cloud: SplatData, painter: SurfaceRenderer, kind: str
) -> None:
    view = viewpoint("look-at:0,0,-4,0,0,0", *SIZE, **{kind: True})
    hand = Hand(LivePlayback(sources_of(cloud)), painter, view=view)
    assert np.abs(hand.bare()[..., :3] - expected(hand, painter)).max() <= 1
    rows = cloud.rows
    ahead = rows[np.abs(rows[:, :2]).sum(axis=1).argmin(), :3]
    camera: Camera = hand.viewer.controls.camera(*SIZE)
    local = camera.view[:3, :3] @ ahead + camera.view[:3, 3]
    if kind == "orthographic":
        pixel = camera.fx * local[:2] + [camera.cx, camera.cy]
    else:
        turn = np.array(
            [np.arctan2(local[0], local[2]), np.arcsin(local[1] / np.linalg.norm(local))]
        )
        pixel = turn * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    hand.send("double_click", x=pixel[0], y=pixel[1], button=1, modifiers=())
    pivot = hand.viewer.controls.pivot - camera.eye
    along = camera.view[:3, :3] @ pivot
    if kind == "panorama":
        np.testing.assert_allclose(
            pivot / np.linalg.norm(pivot), (ahead - camera.eye) / np.linalg.norm(local), atol=0.05
        )
    else:
        np.testing.assert_allclose(along[:2], local[:2], atol=0.05)


def test_post_process_models_apply_to_the_shown_mode(
    cloud: SplatData, painter: SurfaceRenderer, tmp_path: Path
) -> None:
    post = PostProcessor(find("post_process").write(tmp_path), "cpu")
    stage = LivePlayback(sources_of(cloud), post=[post])
    hand = Hand(stage, painter)
    result = hand.bare()[..., :3]
    camera = hand.viewer.controls.camera(*SIZE)
    frame = stage.frame(stage.player(painter.renderer, (0, 0, 0, 1), "color"), camera)
    assert np.abs(result - frame.srgb8[..., :3].astype(int)).max() <= 1
    assert np.abs(result - expected(hand, painter)).max() > 10  # it does something
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(painter.renderer.device, "largest_binding", 16 * SIZE[0] * 33)
        patch.setattr(painter.renderer, "_pairs", 4 * SIZE[0] * 33)
        painter._last_view = None
        assert np.array_equal(Hand(stage, painter).bare()[..., :3], result)
        assert [band.first for band in painter._last_view[1].bands] == [0, 33, 66, 99]
    hand.key("5")  # what is no colour is as it was
    assert np.abs(hand.bare()[..., :3] - expected(hand, painter, "alpha")).max() <= 1
    stage.close()


def test_meshes_and_placed_models_are_drawn_and_listed(
    cloud: SplatData, painter: SurfaceRenderer
) -> None:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)
    mesh = MeshData(corners, np.array([[0, 1, 2]], np.int32))
    turn = np.diag([2.0, 2, 2, 1])
    scene = Scene([SplatSet(cloud, turn, degree=0)], meshes=[mesh])
    hand = Hand(LivePlayback(sources_of(scene)), painter)
    assert np.abs(hand.bare()[..., :3] - expected(hand, painter)).max() <= 1
    center, reach = SceneSource(SplatSet(cloud)).extent()
    far = hand.viewer.playback.sources[0].extent()
    np.testing.assert_allclose(far[0], 2 * center)
    assert far[1] == pytest.approx(2 * reach)
