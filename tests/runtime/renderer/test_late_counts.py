"""Frames that are drawn without waiting for the GPU: their counts come two frames later."""

from typing import Any

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.readback import StagingBuffers
from gsgen.runtime.renderer import renderer as renderers
from gsgen.runtime.renderer.bands import CountsAndImages, DrawnImage
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.late_counts import MAX_FRAMES_IN_FLIGHT
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from support.rendering.splat_scenes import camera, cloud

STEP = 0.02


@pytest.fixture
def own_renderer(device: Device) -> Renderer:
    return Renderer(device, rasteriser="tiles")


@pytest.fixture
def scene() -> Scene:
    return Scene([cloud(300)])


def moved_camera(number: int) -> Camera:
    view = np.eye(4)
    view[0, 3] = STEP * number
    base = camera()
    return Camera(
        view @ base.view, fx=base.fx, fy=base.fy, cx=base.cx, cy=base.cy, width=61, height=47
    )


def pixels(renderer: Renderer, drawn: DrawnImage) -> np.ndarray:
    return renderer.device.read(drawn.image, np.float32, 61 * 47 * 4).reshape(47, 61, 4)


def test_a_steady_frame_reads_the_counts_of_the_second_frame_before(
    own_renderer: Renderer, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    own_renderer.draw(scene, moved_camera(0), wait=False)  # the first one is waited for
    started: list[StagingBuffers] = []
    read: list[int] = []
    original_begin, read_words = StagingBuffers.begin, StagingBuffers.read_words

    def noted_begin(staging: StagingBuffers) -> None:
        started.append(staging)
        original_begin(staging)

    def noted_read(staging: StagingBuffers) -> dict[str, np.ndarray]:
        read.append(max(i for i, entry in enumerate(started) if entry is staging))
        return read_words(staging)

    monkeypatch.setattr(StagingBuffers, "begin", noted_begin)
    monkeypatch.setattr(StagingBuffers, "read_words", noted_read)
    monkeypatch.delattr(Plan, "collect")  # would wait for the frame
    for number in range(8):
        own_renderer.draw(scene, moved_camera(number), wait=False)
        assert read == list(range(max(0, number + 1 - MAX_FRAMES_IN_FLIGHT)))
    assert len(set(map(id, started))) == MAX_FRAMES_IN_FLIGHT  # staging buffers are used again


def test_pictures_are_those_of_frames_that_wait(own_renderer: Renderer, scene: Scene) -> None:
    for number in range(5):
        drawn = own_renderer.draw(scene, moved_camera(number), wait=False)
        actual = pixels(own_renderer, drawn)
        frame = own_renderer.render(scene, moved_camera(number))
        np.testing.assert_array_equal(actual, frame.rgba)
    assert not own_renderer.settle()
    assert not own_renderer.late_counts


def test_room_for_pairs_grows_without_waiting(
    device: Device, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderers, "FIRST_PAIR_CAPACITY", 16)
    own = Renderer(device, rasteriser="tiles")
    nothing = np.eye(4)
    nothing[0, 3] = 1e4  # the scene is beside the image
    away = Camera(nothing, fx=50, fy=50, cx=30, cy=23, width=61, height=47)
    own.draw(scene, away, wait=False)
    collect = Plan.collect
    monkeypatch.delattr(Plan, "collect")
    drawn = [own.draw(scene, moved_camera(0), wait=False) for _ in range(2 + MAX_FRAMES_IN_FLIGHT)]
    monkeypatch.setattr(Plan, "collect", collect, raising=False)
    complete = own.render(scene, moved_camera(0))
    assert drawn[-1].pairs < complete.pairs  # the counts are those of a frame without room
    np.testing.assert_array_equal(pixels(own, drawn[-1]), complete.rgba)


def test_frames_that_are_read_grow_room_before_they_need_it(
    device: Device, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderers, "FIRST_PAIR_CAPACITY", 16)
    own, pairs, drawn = Renderer(device, rasteriser="tiles"), list[int](), list[Plan]()
    draw = Plan.draw

    def noted_draw(plan: Plan, *arguments: Any, **options: Any) -> CountsAndImages:
        drawn.append(plan)
        return draw(plan, *arguments, **options)

    monkeypatch.setattr(Plan, "draw", noted_draw)
    for number in range(12):
        scaled = 76 / 1.06**number
        view = camera(width=61, height=47, fx=scaled, fy=scaled)
        pairs.append(own.render(scene, view).pairs)
    assert pairs[-1] > 1.3 * pairs[0]
    assert len(drawn) == 1 + len(pairs)  # the first frame alone was drawn twice
    assert len(set(map(id, drawn))) > 2  # and buffers grew


def test_incomplete_last_frame_is_reported(
    device: Device, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderers, "FIRST_PAIR_CAPACITY", 16)
    own = Renderer(device, rasteriser="tiles")
    nothing = np.eye(4)
    nothing[0, 3] = 1e4
    own.draw(scene, Camera(nothing, fx=50, fy=50, cx=30, cy=23, width=61, height=47), wait=False)
    own.draw(scene, moved_camera(0), wait=False)
    assert own.settle()
    drawn = own.draw(scene, moved_camera(0), wait=False)  # is waited for
    assert not own.settle()
    np.testing.assert_array_equal(pixels(own, drawn), own.render(scene, moved_camera(0)).rgba)
