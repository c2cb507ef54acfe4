"""Sizes of cameras: each frame has its own, --size fills in, and no picture is stretched."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files import open_cameras
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.scene.camera import Camera

POSE = np.eye(4).tolist()


def synthetic(folder: Path, names: list[str], **fields: object) -> Path:
    """A file as those of NeRF's synthetic scenes, without sizes."""
    frames = [{"file_path": f"./test/{name}", "transform_matrix": POSE} for name in names]
    path = folder / "transforms_test.json"
    path.write_text(json.dumps({"camera_angle_x": 0.69, "frames": frames} | fields))
    return path


def test_a_size_stands_in_for_missing_pictures(tmp_path: Path) -> None:
    path = synthetic(tmp_path, ["r_0", "r_1", "r_2"])
    view = viewpoint(str(path), width=96, height=64)
    assert [(camera.width, camera.height) for camera in view.cameras] == [(96, 64)] * 3
    assert view.cameras[0].fx == pytest.approx(48 / math.tan(0.345))
    assert view.notes == ()
    assert open_cameras(tmp_path, (96, 64)).cameras[2].name == "./test/r_2"
    for half_size in ({"width": 96}, {"height": 96}):
        with pytest.raises(ConfigInvalid, match="--size WIDTHxHEIGHT"):
            viewpoint(str(path), **half_size)


def test_each_frame_has_the_size_of_its_own_picture(tmp_path: Path) -> None:
    sizes = [(40, 30), (30, 40), (64, 64), (33, 21)]
    (tmp_path / "test").mkdir()
    for number, size in enumerate(sizes):
        Image.new("RGB", size).save(tmp_path / "test" / f"r_{number}.png")
    path = synthetic(tmp_path, [f"r_{number}" for number in range(4)])
    cameras = [entry.camera for entry in open_cameras(path).cameras]
    assert [(camera.width, camera.height) for camera in cameras] == sizes
    assert [camera.fx for camera in cameras] == pytest.approx(
        [width / 2 / math.tan(0.345) for width, _ in sizes]
    )
    assert [(camera.cx, camera.cy) for camera in cameras] == [(w / 2, h / 2) for w, h in sizes]


SHAPES = [(96, 96), (96, 48), (48, 96), (200, 30), (30, 200), (31, 17), (640, 480), (7, 5)]


@pytest.mark.parametrize("size", SHAPES)
@pytest.mark.parametrize("kind", ["pinhole", "orthographic", "panorama"])
def test_an_image_of_another_shape_is_not_stretched(kind: str, size: tuple[int, int]) -> None:
    pinhole = Camera(np.eye(4), fx=50, fy=60, cx=30, cy=20, width=64, height=48)
    camera = pinhole if kind == "pinhole" else replace(pinhole, kind="orthographic")
    if kind == "panorama":
        camera = Camera.panorama([0, 0, 0], width=64)
    resized = camera.resized(*size)
    assert (resized.width, resized.height) == size
    assert resized.kind == camera.kind
    pixel = 1 / min(size)  # a shape that is equal but for rounding keeps the field of view
    assert resized.fx / resized.fy == pytest.approx(camera.fx / camera.fy, rel=pixel)
    if not camera.has_shape(*size):
        assert resized.fx / resized.fy == pytest.approx(camera.fx / camera.fy)
        middle = resized.cx - size[0] / 2, resized.cy - size[1] / 2
        scale = resized.fx / camera.fx
        expected = (camera.cx - camera.width / 2) * scale, (camera.cy - camera.height / 2) * scale
        assert middle == pytest.approx(expected)


@pytest.mark.parametrize("size", SHAPES)
def test_another_shape_is_told(size: tuple[int, int], tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(Camera(np.eye(4), fx=50, fy=60, cx=30, cy=20, width=64, height=48).to_json())
    view = viewpoint(str(path), *size)
    assert bool(view.notes) == (size not in {(640, 480), (7, 5)})
    if view.notes:
        words = "shows more at" if size[0] / size[1] > 64 / 48 else "crops"
        assert f"{size[0]}×{size[1]} {words} the left and right" in view.notes[0]


def test_one_given_side_keeps_the_shape(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(Camera(np.eye(4), fx=50, fy=60, cx=30, cy=20, width=64, height=48).to_json())
    assert viewpoint(str(path), width=32).sizes == {(32, 24)}
    assert viewpoint(str(path), height=12).sizes == {(16, 12)}
    assert viewpoint(str(path), height=12).notes == ()
