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

BEHIND = (0.1, 0.4, 0.7, 0.5)


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-20)))


@pytest.mark.parametrize("name", SCENES)
def test_colours_agree_with_the_oracle(renderer: Renderer, name: str) -> None:
    scene, camera = SCENES[name]()
    seen = renderer.render(scene, camera, background=BEHIND)
    wanted = oracle.render(scene, camera, background=BEHIND)
    assert seen.rgba is not None
    assert seen.rgba.shape == (camera.height, camera.width, 4)
    assert np.isfinite(seen.rgba).all()
    assert decibels(seen.rgba, wanted.rgba) >= 110
    error = np.abs(seen.rgba - wanted.rgba).max(axis=-1)
    assert np.where(wanted.fragile, 0, error).max() <= 2e-5
    assert wanted.fragile.mean() < 0.1  # or little was compared
    assert seen.visible >= wanted.visible
    if name != "nothing":  # else backgrounds would be compared
        assert wanted.rgba[..., 3].max() > BEHIND[3] + 0.02


def test_golden_image_of_gsplat_is_reproduced(renderer: Renderer) -> None:
    data, camera, image = golden_case(shared("data/goldens/tiny_case.safetensors"))
    seen = renderer.render(Scene([data]), camera)
    assert np.abs(seen.rgba - image).max() <= 2e-6
    assert np.abs(oracle.render(Scene([data]), camera).rgba - image).max() <= 2e-6


def test_captured_scene_agrees_with_the_oracle(renderer: Renderer) -> None:
    """Points of a real capture, seen by its own cameras with their own principal points."""
    with np.load(shared("data/garden/test_garden.npz")) as held:
        points, colors = held["means3d"][::12], held["colors"][::12]
        views, intrinsics = held["viewmats"], held["Ks"]
    rows = np.zeros((len(points), 10), np.float32)
    rows[:, :3], rows[:, 3], rows[:, [4, 7, 9]] = points, 0.8, 4e-5
    scene = Scene([SplatData(rows, colors.astype(np.float32) / 255, "rgb")])
    for view, k in zip(views[:2], intrinsics[:2], strict=True):
        fx, fy, cx, cy = (float(k[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        full = Camera(view, fx=fx, fy=fy, cx=cx, cy=cy, width=648, height=420)
        camera = full.scaled(162, 105)
        seen, wanted = renderer.render(scene, camera), oracle.render(scene, camera)
        assert decibels(seen.rgba, wanted.rgba) >= 80
        error = np.abs(seen.rgba - wanted.rgba).max(axis=-1)
        assert np.where(wanted.fragile, 0, error).max() <= 1e-4
        assert wanted.rgba[..., 3].mean() > 0.2
