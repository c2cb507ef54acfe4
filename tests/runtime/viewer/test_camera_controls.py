"""What a drag does to the camera, told by where points are seen before and after."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.viewer.camera_controls import CAMERA_KEYS, Controls, unproject
from references.lenses import lens_pixel

UP = np.array([0.0, -1.0, 0.0])
CENTER = np.array([0.3, -0.2, 0.5])
SIZE = (320, 180)


def orbit(**words: float) -> Camera:
    return Camera.orbit(CENTER.tolist(), 4.0, width=320, height=180, **words)


def controls(camera: Camera | None = None) -> Controls:
    return Controls(camera or orbit(azimuth=20, elevation=10), UP, CENTER, 1.0)


def project_point(camera: Camera, point: np.ndarray) -> np.ndarray:
    x, y, z = camera.view[:3, :3] @ point + camera.view[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def toward(camera: Camera, share: float) -> np.ndarray:
    """Return a point between the middle and the camera, or beyond the middle."""
    return CENTER + share * (camera.eye - CENTER)


def test_controls_start_at_the_given_camera() -> None:
    home_camera = orbit(azimuth=20, elevation=10)
    camera = controls(home_camera).camera(*SIZE)
    np.testing.assert_allclose(camera.view, home_camera.view, atol=1e-12)
    assert (camera.fx, camera.cx, camera.near) == (home_camera.fx, home_camera.cx, home_camera.near)


def test_resized_window_keeps_the_visible_region() -> None:
    controller = controls()
    for size in ((640, 180), (320, 500), (640, 360)):
        camera = controller.camera(*size)
        for corner in ((-1, -1), (1, 1)):
            half = np.array([160, 90]) / orbit().fx * corner
            x, y = half * camera.fx + [camera.cx, camera.cy]
            assert -1e-9 <= x <= size[0] + 1e-9
            assert -1e-9 <= y <= size[1] + 1e-9


@pytest.mark.parametrize("drag", [(30, 0), (-30, 0), (0, 20), (0, -20)])
def test_near_points_follow_the_pointer(drag: tuple[int, int]) -> None:
    controller = controls()
    before = controller.camera(*SIZE)
    near, eye = toward(before, 0.4), before.eye
    controller.orbit(*drag)
    after = controller.camera(*SIZE)
    moved = project_point(after, near) - project_point(before, near)
    assert moved @ drag > 0
    np.testing.assert_allclose(
        project_point(after, CENTER), project_point(before, CENTER), atol=1e-9
    )
    assert np.linalg.norm(after.eye - CENTER) == pytest.approx(np.linalg.norm(eye - CENTER))


@pytest.mark.parametrize("drag", [(30, 0), (-30, 0), (0, 20), (0, -20)])
def test_looking_around_keeps_the_eye_position(drag: tuple[int, int]) -> None:
    controller = controls()
    before = controller.camera(*SIZE)
    controller.look(*drag)
    after = controller.camera(*SIZE)
    np.testing.assert_allclose(after.eye, before.eye, atol=1e-9)
    assert (project_point(after, CENTER) - project_point(before, CENTER)) @ drag > 0


def test_panning_keeps_the_grasped_point_under_the_pointer() -> None:
    controller = controls()
    before = controller.camera(*SIZE)
    controller.pan(17, -9, *SIZE)
    after = controller.camera(*SIZE)
    np.testing.assert_allclose(
        project_point(after, CENTER) - project_point(before, CENTER), [17, -9], atol=1e-9
    )


def test_no_drag_goes_over_the_pole_or_wears_the_rotation_out() -> None:
    controller = controls()
    for _ in range(300):
        controller.orbit(3.7, 41.0)
    turn = controller.camera(*SIZE).view[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert -1 < turn[2] @ UP < -0.99  # it looks down: the camera stands above
    assert turn[1] @ UP < 0  # and what is up is up


def test_a_tilted_camera_goes_on_tilted() -> None:
    upright = orbit(azimuth=20)
    tilted_camera = orbit(azimuth=20)
    roll = np.array([[0.8, 0.6, 0, 0], [-0.6, 0.8, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    tilted_camera = Camera(
        roll @ upright.view,
        fx=upright.fx,
        fy=upright.fy,
        cx=160,
        cy=90,
        width=320,
        height=180,
        near=upright.near,
    )
    controller = controls(tilted_camera)
    controller.orbit(5, 0)
    side = controller.camera(*SIZE).view[0, :3] @ UP
    assert side == pytest.approx(tilted_camera.view[0, :3] @ UP, abs=0.05)
    assert abs(side) > 0.5


def test_the_wheel_comes_nearer_and_never_through() -> None:
    controller = controls()
    far = np.linalg.norm(controller.eye - CENTER)
    controller.wheel(-100)
    near = np.linalg.norm(controller.eye - CENTER)
    assert near < far
    controller.wheel(100)
    assert np.linalg.norm(controller.eye - CENTER) == pytest.approx(far)
    for _ in range(100):
        controller.wheel(-1000)
    camera = controller.camera(*SIZE)
    assert 0 < np.linalg.norm(camera.eye - CENTER) < 1e-3
    assert camera.near < np.linalg.norm(camera.eye - CENTER)


def test_a_flat_camera_is_magnified_in_place_of_coming_nearer() -> None:
    home_camera = orbit().flattened(4.0)
    controller = controls(home_camera)
    controller.wheel(-100)
    camera = controller.camera(*SIZE)
    np.testing.assert_allclose(camera.eye, home_camera.eye, atol=1e-9)
    assert camera.fx > home_camera.fx


@pytest.mark.parametrize("key", CAMERA_KEYS)
def test_keys_move_along_their_axes(key: str) -> None:
    controller = controls()
    before = controller.camera(*SIZE)
    assert controller.fly(frozenset({key}), 0.5, is_fast=False)
    slow = before.view[:3, :3] @ (controller.eye - before.eye)
    np.testing.assert_allclose(slow, 0.25 * np.array(CAMERA_KEYS[key]), atol=1e-12)
    assert controller.fly(frozenset({key}), 0.5, is_fast=True)
    both = before.view[:3, :3] @ (controller.eye - before.eye)
    assert np.linalg.norm(both) > 4 * np.linalg.norm(slow)
    assert not controller.fly(frozenset({"z"}), 0.5, is_fast=False)


def test_focus_turns_to_a_point_and_then_around_it() -> None:
    controller = controls()
    eye, point = controller.eye, CENTER + np.array([0.4, 0.3, -0.2])
    controller.focus(point)
    np.testing.assert_allclose(controller.eye, eye, atol=1e-9)
    for _ in range(2):
        np.testing.assert_allclose(
            project_point(controller.camera(*SIZE), point), [160, 90], atol=1e-6
        )
        controller.orbit(40, 25)


def test_framing_centres_the_scene_and_reset_restores_the_camera() -> None:
    controller = controls()
    first = controller.camera(*SIZE)
    controller.fly(frozenset("wd"), 3, is_fast=True)
    controller.orbit(100, 10)
    turn = controller.camera(*SIZE).view[:3, :3]
    controller.frame()
    camera = controller.camera(*SIZE)
    np.testing.assert_allclose(camera.view[:3, :3], turn)
    np.testing.assert_allclose(project_point(camera, CENTER), [160, 90], atol=1e-9)
    distance = np.linalg.norm(camera.eye - CENTER)
    assert 90 / camera.fy == pytest.approx(np.tan(np.arcsin(1 / distance)))
    controller.reset()
    np.testing.assert_allclose(controller.camera(*SIZE).view, first.view, atol=1e-12)


def test_a_panorama_is_turned_in_its_place() -> None:
    home_camera = Camera.panorama(CENTER.tolist(), width=320)
    controls = Controls(home_camera, UP, CENTER, 1.0)
    controls.orbit(25, 10)
    camera = controls.camera(640, 200)
    np.testing.assert_allclose(camera.eye, home_camera.eye, atol=1e-3)
    assert (camera.kind, camera.width, camera.height) == ("panorama", 640, 200)
    assert not np.allclose(camera.view[:3, :3], home_camera.view[:3, :3], atol=1e-3)


LENSES = {
    "distorted": {"distortion": Distortion.of({"k1": -0.2, "k2": 0.02, "p1": 0.01, "p2": -0.02})},
    "fisheye": {"kind": "fisheye", "fx": 70.0, "fy": 72.0},
    "distorted fisheye": {
        "kind": "fisheye",
        "fx": 70.0,
        "fy": 72.0,
        "distortion": Distortion.of({"k1": -0.03, "k2": 0.004}),
    },
}


@pytest.mark.parametrize("name", LENSES)
def test_a_pixel_seen_through_a_lens_is_unprojected(name: str) -> None:
    camera = replace(orbit(azimuth=20, elevation=10), **LENSES[name])
    rng = np.random.default_rng(2)
    for x, y, depth in rng.uniform((5, 5, 1), (315, 175, 9), (30, 3)).tolist():
        point = unproject(camera, x, y, depth)
        local = camera.view[:3, :3] @ point + camera.view[:3, 3]
        assert lens_pixel(camera, local.tolist()) == pytest.approx((x, y), abs=1e-6)
        actual = np.linalg.norm(local) if camera.kind == "fisheye" else local[2]
        assert actual == pytest.approx(depth)


@pytest.mark.parametrize("name", LENSES)
def test_controls_move_a_camera_with_a_lens(name: str) -> None:
    controller = controls(replace(orbit(azimuth=20, elevation=10), **LENSES[name]))
    before = controller.eye
    controller.pan(10, 5, *SIZE)
    controller.wheel(100)
    assert np.linalg.norm(controller.eye - before) > 0.1
    controller.frame()
    camera = controller.camera(*SIZE)
    assert np.linalg.norm(camera.eye - CENTER) >= 1
    assert (camera.kind, camera.distortion) == (
        LENSES[name].get("kind", "pinhole"),
        LENSES[name].get("distortion"),
    )
