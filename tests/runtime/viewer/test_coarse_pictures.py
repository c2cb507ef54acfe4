"""Pictures that are drawn with fewer pixels than the surface has, while something moves."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_source import sources_of
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from support.rendering.viewers import SIZE, Hand


def test_fast_dragging_shows_coarse_pictures(still: Hand, painter: SurfaceRenderer) -> None:
    fine = still.bare()
    painter.seconds = 0.5
    still.send("pointer_down", x=80, y=60, button=1, modifiers=())
    still.send("pointer_move", x=81, y=60, button=0, modifiers=())
    still.look()
    drawn = painter.drawn
    assert drawn is not None
    assert drawn.row == SIZE[0] // 4
    still.send("pointer_move", x=80, y=60, button=0, modifiers=())
    still.send("pointer_up", x=80, y=60, button=1, modifiers=())
    assert np.abs(still.bare() - fine).max() <= 1


def test_a_coarse_picture_is_enlarged_smoothly(still: Hand, painter: SurfaceRenderer) -> None:
    painter.seconds = 0.5
    still.key("i")
    still.send("pointer_down", x=80, y=60, button=1, modifiers=())
    enlarged = still.look()[..., :3]
    still.send("pointer_up", x=80, y=60, button=1, modifiers=())
    assert painter.drawn is not None
    factor = SIZE[0] // painter.drawn.row
    assert factor > 1
    camera = still.viewer.camera(factor)
    frame = painter.renderer.render(
        still.viewer.playback.scene(), camera, background=(0, 0, 0, 1), outputs=("color",)
    )
    coarse = np.clip(frame.rgba[..., :3], 0, 1).astype(np.float64) * 255
    for axis, side in ((0, camera.height), (1, camera.width)):  # blend rows, then columns
        position = np.clip((np.arange(side * factor) + 0.5) / factor - 0.5, 0, side - 1)
        low = np.floor(position).astype(int)
        high, share = np.minimum(low + 1, side - 1), position - low
        share = share.reshape([-1 if dimension == axis else 1 for dimension in range(3)])
        coarse = coarse.take(low, axis) * (1 - share) + coarse.take(high, axis) * share
    assert np.abs(enlarged - coarse).max() <= 1.01
    assert np.ptp(coarse) > 60


@pytest.mark.parametrize("antialias", ["classic", "mip"])
def test_small_splats_cover_as_much_of_a_coarse_picture(
    antialias: str, painter: SurfaceRenderer
) -> None:
    rng = np.random.default_rng(5)
    rows = np.zeros((4000, 10), np.float32)
    rows[:, :2] = rng.uniform(-0.9, 0.9, (4000, 2))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.3, 1e-5  # standard deviations of a quarter of a pixel
    data = SplatData(rows, np.ones((4000, 3), np.float32), "rgb")
    hand = Hand(LivePlayback(sources_of(Scene([SplatSet(data, antialias=antialias)]))), painter)
    hand.look()
    scene = hand.viewer.playback.scene()
    fine, coarse = (painter.renderer.render(scene, hand.viewer.camera(n)) for n in (1, 4))
    widened = replace(hand.viewer.camera(4), dilation=0.3)
    wrong = painter.renderer.render(scene, widened)
    covered = [float(frame.rgba[..., 3].mean()) for frame in (fine, coarse, wrong)]
    assert covered[1] == pytest.approx(covered[0], rel=0.15)
    assert abs(covered[2] - covered[0]) > 0.5 * covered[0]
    right = oracle.render(scene, hand.viewer.camera(4))
    apart = np.abs(coarse.rgba - right.rgba)[~right.fragile]
    assert apart.max() <= 1e-3
