"""Cameras: what they mean, as JSON, from a point, in orbit, and in words."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats import PackedRows, PointCloud
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.splat_scenes import cloud


def pixel(camera: Camera, point: object) -> np.ndarray:
    x, y, z = camera.view[:3, :3] @ np.asarray(point, float) + camera.view[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z])


def test_look_at_target_is_centred_with_up_on_top() -> None:
    camera = Camera.look_at((1, 2, 3), (4, 0, -1), up=(0, 0, 1), width=80, height=60)
    np.testing.assert_allclose(camera.eye, [1, 2, 3])
    u, v, z = pixel(camera, (4, 0, -1))
    np.testing.assert_allclose([u, v], [40, 30], atol=1e-9)
    assert z == pytest.approx(np.sqrt(29))
    assert pixel(camera, (4, 0, -0.9))[1] < 30  # nearer to the upper edge


def test_the_field_of_view_is_vertical() -> None:
    camera = Camera.look_at((0, 0, -1), (0, 0, 0), fov_y=90, width=100, height=60)
    assert pixel(camera, (0, 1, 0))[1] == pytest.approx(60)


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 0, 1), (1, 0, 0)])
def test_an_orbit_keeps_its_distance_and_rises(up: tuple[int, int, int]) -> None:
    center = np.array([1, 2, 3])
    for azimuth, elevation in ((0, 0), (90, 30), (200, -60), (10, 90), (0, -90)):
        camera = Camera.orbit(center, 5, azimuth=azimuth, elevation=elevation, up=up)
        away = camera.eye - center
        assert np.linalg.norm(away) == pytest.approx(5)
        assert away @ up == pytest.approx(5 * np.sin(np.radians(elevation)))
        np.testing.assert_allclose(pixel(camera, center)[:2], [640, 360], atol=1e-6)
    first, two = (Camera.orbit(center, 5, azimuth=a, up=up).eye - center for a in (0, 90))
    assert first @ two == pytest.approx(0, abs=1e-9)
    assert np.cross(first, two) @ up != 0


def test_json_gives_the_same_camera_back() -> None:
    camera = Camera.look_at((1, 2, 3), (0, 0, 0), width=33, height=21, near=0.5)
    again = Camera.from_json(camera.to_json())
    assert np.array_equal(again.view, camera.view)
    for name in ("fx", "fy", "cx", "cy", "width", "height", "near"):
        assert getattr(again, name) == getattr(camera, name)


def test_a_flat_camera_shows_the_same_at_its_distance() -> None:
    camera = Camera.look_at((0, 0, -4), (0, 0, 0), width=80, height=60)
    flat = camera.flattened(4)
    for kind, array in (("pinhole", camera), ("orthographic", flat)):
        x, y, z, w = array.projection @ [1, 0.5, 4, 1]
        expected = [camera.fx / 4 + 40, camera.fy * 0.5 / 4 + 30]
        actual = [(x / w + 1) / 2 * 80, (1 - y / w) / 2 * 60]
        np.testing.assert_allclose(actual, expected, err_msg=kind)
        assert 0 < z / w < 1
    assert Camera.from_json(flat.to_json()).kind == "orthographic"
    assert flat.flattened(9).fx == flat.fx
    with pytest.raises(SceneInvalid, match=r"camera\.kind: is 'fish'"):
        Camera.from_dict(VALID_CAMERA | {"kind": "fish"})


VALID_CAMERA = {
    "view": np.eye(4).tolist(),
    "fx": 10,
    "fy": 10,
    "cx": 5,
    "cy": 5,
    "width": 10,
    "height": 10,
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fx": 0}, "camera.fx: is 0, expected a positive number"),
        ({"cy": "five"}, "camera.cy: is 'five', expected a finite number"),
        ({"width": 0}, "camera.width: is 0, expected an integer from 1 to 16384"),
        ({"height": 10.5}, "camera.height: is 10.5"),
        ({"near": -1}, "camera.near: is -1"),
        ({"view": [1, 2]}, "camera.view: is .*, expected 4 rows"),
        ({"view": [[1, 2], [3]]}, "camera.view: is not a matrix"),
        ({"view": (2 * np.eye(4)).tolist()}, "not a rigid transform"),
        ({"view": np.diag([1.0, 1, -1, 1]).tolist()}, "not a rigid transform"),
        ({"fov": 3}, "has unknown fov\n.*Fields: view, fx"),
    ],
)
def test_invalid_camera_is_explained(change: dict[str, object], words: str) -> None:
    with pytest.raises(SceneInvalid, match=words):
        Camera.from_dict(VALID_CAMERA | change)


def test_missing_fields_and_other_json_are_named() -> None:
    with pytest.raises(SceneInvalid, match="lacks fx, cy"):
        Camera.from_dict(
            {key: VALID_CAMERA[key] for key in VALID_CAMERA if key not in ("fx", "cy")}
        )
    with pytest.raises(SceneInvalid, match="is a list, expected an object"):
        Camera.from_json("[1]")
    with pytest.raises(SceneInvalid, match="is not valid JSON"):
        Camera.from_json("{")
    with pytest.raises(SceneInvalid, match="expected two different points"):
        Camera.look_at((1, 1, 1), (1, 1, 1))
    with pytest.raises(SceneInvalid, match=r"camera\.fov_y: is 180"):
        Camera.look_at((1, 1, 1), (0, 1, 1), fov_y=180)


class Still:
    """As much of a source as a viewpoint asks for."""

    up = (0.0, 0.0, 1.0)

    def extent(self) -> tuple[np.ndarray, float]:
        return np.array([1.0, 2, 3]), 2.0


def test_camera_options_create_cameras(tmp_path: Path) -> None:
    source = Still()
    fitting = viewpoint(None, width=60, height=60).camera(source, 0, 0)
    distance = np.linalg.norm(fitting.eye - [1, 2, 3])
    assert distance == pytest.approx(1.05 * 2 / np.sin(np.radians(25)))
    placed = viewpoint("orbit:0,90,7", up="+z").camera(source, 0, 0)
    np.testing.assert_allclose(placed.eye, [1, 2, 10], atol=1e-9)
    flat = viewpoint(None, width=60, height=60, orthographic=True).camera(source, 0, 0)
    assert (flat.kind, flat.fx) == ("orthographic", pytest.approx(fitting.fx / distance))
    look_at_view = viewpoint("look-at:0,0,0,0,0,9", fov=30).camera(source, 0, 0)
    np.testing.assert_allclose(look_at_view.view[2], [0, 0, 1, 0], atol=1e-12)
    file = tmp_path / "cameras.json"
    file.write_text(json.dumps([VALID_CAMERA, VALID_CAMERA | {"width": 20}]))
    several = viewpoint(str(file))
    assert [several.camera(source, n, 0).width for n in range(3)] == [10, 20, 10]
    assert viewpoint(str(file), width=40).camera(source, 0, 0).fx == 40


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("orbit:1", "has 1 numbers"),
        ("orbit:a,b", "could not convert"),
        ("look-at:1,2,3", "has 3 numbers, expected 6 finite"),
        ("look-at:1,2,3,4,5,nan", "expected 6 finite"),
        ("orbitt", "is neither a camera nor an existing file"),
    ],
)
def test_invalid_camera_options_are_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigInvalid, match=f"(?s){words}.*orbit\\[:AZIMUTH"):
        viewpoint(text)


def test_bare_points_are_as_large_as_their_neighbours_are_far() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    far_away = np.array([[1000.0, 0, 0]])
    position = np.concatenate([grid, far_away]).astype(np.float32)
    data = SplatData.from_points(PointCloud(position, np.full((65, 3), 0.5, np.float32)))
    assert data.space == "rgb"
    np.testing.assert_allclose(data.rows[:64, [4, 7, 9]], 0.25, rtol=1e-6)
    np.testing.assert_allclose(data.rows[64, [4, 7, 9]], 4, rtol=1e-6)
    assert not data.rows[:, [5, 6, 8]].any()
    alone = SplatData.from_points(PointCloud(position[:1], data.appearance[:1]))
    assert (alone.rows[:, 4] > 0).all()


def test_packed_rows_stay_as_they_are() -> None:
    stored = cloud(3, degree=1)
    assert SplatData.from_packed(PackedRows(stored.rows, stored.appearance)).degree == 1
    three = PackedRows(stored.rows, stored.appearance[:, :3].copy())
    assert SplatData.from_packed(three).degree is None
    assert SplatData.from_packed(three, "sh").degree == 0
