"""Pictures are those of the float64 oracle, and of gsplat's CUDA rasteriser."""

import numpy as np
import pytest

from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from support.checkpoints.golden_case import golden_case
from support.commands import shared
from support.rendering.splat_scenes import SCENES

BACKGROUND = (0.1, 0.4, 0.7, 0.5)


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-20)))


@pytest.mark.parametrize("name", SCENES)
def test_colours_agree_with_the_oracle(renderer: Renderer, name: str) -> None:
    scene, camera = SCENES[name]()
    frame = renderer.render(scene, camera, background=BACKGROUND)
    expected = oracle.render(scene, camera, background=BACKGROUND)
    assert frame.rgba is not None
    assert frame.rgba.shape == (camera.height, camera.width, 4)
    assert np.isfinite(frame.rgba).all()
    assert decibels(frame.rgba, expected.rgba) >= 110
    error = np.abs(frame.rgba - expected.rgba).max(axis=-1)
    assert np.where(expected.fragile, 0, error).max() <= 2e-5
    assert expected.fragile.mean() < 0.1  # or little was compared
    assert frame.visible >= expected.visible
    if name != "nothing":  # else backgrounds would be compared
        assert expected.rgba[..., 3].max() > BACKGROUND[3] + 0.02


def test_golden_image_of_gsplat_is_reproduced(renderer: Renderer) -> None:
    data, camera, image = golden_case(shared("data/goldens/tiny_case.safetensors"))
    frame = renderer.render(Scene([data]), camera)
    assert np.abs(frame.rgba - image).max() <= 2e-6
    assert np.abs(oracle.render(Scene([data]), camera).rgba - image).max() <= 2e-6


def test_captured_scene_agrees_with_the_oracle(renderer: Renderer) -> None:
    """Points of a real capture, seen by its own cameras with their own principal points."""
    with np.load(shared("data/garden/test_garden.npz")) as archive:
        points, colors = archive["means3d"][::12], archive["colors"][::12]
        views, intrinsics = archive["viewmats"], archive["Ks"]
    rows = np.zeros((len(points), 10), np.float32)
    rows[:, :3], rows[:, 3], rows[:, [4, 7, 9]] = points, 0.8, 4e-5
    scene = Scene([SplatData(rows, colors.astype(np.float32) / 255, "rgb")])
    for view, k in zip(views[:2], intrinsics[:2], strict=True):
        fx, fy, cx, cy = (float(k[array]) for array in ((0, 0), (1, 1), (0, 2), (1, 2)))
        full = Camera(view, fx=fx, fy=fy, cx=cx, cy=cy, width=648, height=420)
        camera = full.scaled(162, 105)
        actual, expected = renderer.render(scene, camera), oracle.render(scene, camera)
        assert decibels(actual.rgba, expected.rgba) >= 80
        error = np.abs(actual.rgba - expected.rgba).max(axis=-1)
        assert np.where(expected.fragile, 0, error).max() <= 1e-4
        assert expected.rgba[..., 3].mean() > 0.2
