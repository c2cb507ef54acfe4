"""Pictures through lenses: where points are, what is beyond the range, and what is not drawn."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from references.lenses import lens_pixel
from references.projected_density import decibels_where_drawn, sampled_alpha
from support.rendering.mesh_scenes import ball
from support.rendering.splat_scenes import LENSES, SCENES, cloud, single


def dots(positions: np.ndarray, size: float = 1e-3) -> SplatData:
    """Balls of an angular size, in radians."""
    rows = np.zeros((len(positions), 10), np.float32)
    rows[:, :3], rows[:, 3] = positions, 0.9
    rows[:, [4, 7, 9]] = (size * np.linalg.norm(positions, axis=1, keepdims=True)) ** 2
    return SplatData(rows, np.ones((len(rows), 3), np.float32), "rgb")


def center_of(alpha: np.ndarray) -> np.ndarray:
    rows, columns = np.indices(alpha.shape) + 0.5
    return np.array([(alpha * columns).sum(), (alpha * rows).sum()]) / alpha.sum()


@pytest.mark.parametrize("name", LENSES)
def test_dots_are_where_the_formulas_put_them(renderer: Renderer, name: str) -> None:
    camera = replace(SCENES[name]()[1], view=np.eye(4)).scaled(244, 188)
    rng = np.random.default_rng(3)
    checked = 0
    for direction in rng.normal(size=(80, 3)) * (1, 1, 1.3):
        position = 4 * direction / np.linalg.norm(direction)
        pixel = np.array(lens_pixel(camera, position.tolist()))
        rho, z = np.hypot(*position[:2]), position[2]
        radius = np.arctan2(rho, z) if camera.kind == "fisheye" else rho / z if z > 0 else np.inf
        alpha = renderer.render(Scene([dots(position[None])]), camera).alpha
        is_inside = (pixel > 8).all() and (pixel < np.array([236, 180])).all()
        if is_inside and radius < camera.ray_limit:
            assert center_of(alpha) == pytest.approx(pixel, abs=0.05)
            checked += 1
        elif radius >= camera.ray_limit:
            assert not alpha.any()
    assert checked > 4


def test_points_beyond_the_fold_of_a_barrel_are_not_folded_back(renderer: Renderer) -> None:
    """At slope 1.6 the polynomial is back in the image, where nothing may be."""
    lens = Distortion.of({"k1": -0.3})
    camera = Camera(
        np.eye(4), fx=60.0, fy=60.0, cx=64.0, cy=64.0, width=128, height=128, distortion=lens
    )
    assert camera.ray_limit == pytest.approx(1.0541, abs=1e-4)
    for slope, is_drawn in ((0.9, True), (1.03, True), (1.08, False), (1.6, False), (1.8, False)):
        position = np.array([[slope * 3, 0, 3.0]])
        u, v = lens_pixel(camera, position[0].tolist())
        assert 0 < u < 128
        assert v == 64
        assert bool(renderer.render(Scene([dots(position)]), camera).visible) == is_drawn


@pytest.mark.parametrize("angle", [0, 45, 89.9, 90, 90.1, 120, 170])
def test_depth_of_a_fisheye_is_the_distance(renderer: Renderer, angle: float) -> None:
    camera = Camera(
        np.eye(4), fx=40.0, fy=40.0, cx=8.0, cy=64.0, width=160, height=128, kind="fisheye"
    )
    turn = np.radians(angle)
    position = 5 * np.array([[np.sin(turn), 0, np.cos(turn)]])
    frame = renderer.render(Scene([dots(position)]), camera, outputs=("color", "depth"))
    column = min(int(8 + 40 * turn), 159)
    assert frame.depth[64, column] == pytest.approx(5, rel=1e-5)
    assert renderer.render(Scene([dots(position)]), replace(camera, near=5.1)).visible == 0


def test_nearer_gaussians_cover_farther_ones_behind_the_camera(renderer: Renderer) -> None:
    """Behind it, the farther one has the greater −z and the smaller z: distances decide."""
    camera = Camera(
        np.eye(4), fx=40.0, fy=40.0, cx=8.0, cy=64.0, width=160, height=128, kind="fisheye"
    )
    direction = np.array([np.sin(2.5), 0, np.cos(2.5)])
    data = dots(np.stack([6 * direction, 3 * direction]), size=0.05)
    data.appearance[:] = [[1, 0, 0], [0, 1, 0]]
    frame = renderer.render(Scene([data]), camera, outputs=("color", "depth"))
    assert frame.ids[64, int(8 + 40 * 2.5)] == 1


@pytest.mark.parametrize("kind", ["distorted", "fisheye"])
def test_meshes_are_refused_by_the_name_of_the_lens(renderer: Renderer, kind: str) -> None:
    name = "lens_barrel" if kind == "distorted" else "fisheye"
    camera = SCENES[name]()[1]
    scene = Scene([single()], meshes=[Mesh(ball(4))])
    words = {"distorted": "is a lens with distortion", "fisheye": "is a fisheye"}[kind]
    with pytest.raises(SceneInvalid, match=rf"camera: {words}.*has meshes\n.*Leave the meshes out"):
        renderer.render(scene, camera)
    assert renderer.render(Scene([single()]), camera).visible == 1  # the renderer goes on


@pytest.mark.parametrize(
    ("name", "degrees"),
    [("lens_cushion", 25), ("lens_rational", 25), ("fisheye", 90), ("fisheye_prism", 60)],
)
def test_small_gaussian_is_like_the_density_of_its_samples(
    renderer: Renderer, name: str, degrees: float
) -> None:
    """Samples are projected one by one: 40 dB for a Gaussian of half a degree."""
    camera = replace(SCENES[name]()[1], view=np.eye(4)).scaled(976, 752)
    angle = np.radians(degrees)
    center = 5 * np.array([0.96 * np.sin(angle), -0.28 * np.sin(angle), np.cos(angle)])
    data = dots(center[None], size=0.008)
    drawn = renderer.render(Scene([data]), camera).alpha
    covariance = np.diag(data.rows[0, [4, 7, 9]].astype(float))
    expected = sampled_alpha(camera, data.rows[0, :3].astype(float), covariance, 0.9, exponent=18)
    assert expected.max() > 0.8
    assert decibels_where_drawn(drawn, expected) >= 40


def test_lens_that_moves_nothing_draws_the_pinhole_bit_by_bit(renderer: Renderer) -> None:
    view = Camera(np.eye(4), fx=50.0, fy=50.0, cx=30.0, cy=24.0, width=61, height=47)
    scene = Scene([cloud(200, 4)])
    same = replace(view, distortion=Distortion())
    assert np.array_equal(renderer.render(scene, same).rgba, renderer.render(scene, view).rgba)


def test_weak_lens_is_close_to_the_pinhole(renderer: Renderer) -> None:
    """Another kernel with the same formulas: a lens of 1e-9 draws the pinhole's picture."""
    view = Camera(np.eye(4), fx=50.0, fy=50.0, cx=30.0, cy=24.0, width=61, height=47)
    scene = Scene([cloud(200, 4, degree=1)])
    weak = replace(view, distortion=Distortion.of({"k1": 1e-9}))
    np.testing.assert_allclose(
        renderer.render(scene, weak).rgba, renderer.render(scene, view).rgba, atol=1e-4
    )


def test_models_hide_nothing_that_a_lens_shows() -> None:
    """Every ray of the image is in the clip space of the projection that models get."""
    for name in LENSES:
        camera = replace(SCENES[name]()[1], view=np.eye(4))
        if camera.kind == "fisheye":
            clip = camera.projection @ [3, -4, -5, 1]
            assert (np.abs(clip[:3]) <= clip[3]).all()
            continue
        rng = np.random.default_rng(6)
        pixels = rng.uniform((0, 0), (camera.width, camera.height), (200, 2))
        slopes = camera.plane_points(pixels)
        points = np.column_stack([4 * slopes, np.full(200, 4.0), np.ones(200)])
        x, y, _, w = camera.projection @ points.T
        assert (np.abs(x) <= 1.001 * w).all()
        assert (np.abs(y) <= 1.001 * w).all()
