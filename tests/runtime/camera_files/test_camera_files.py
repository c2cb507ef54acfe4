"""Files of cameras: each format gives back the cameras that were written by its own formulas."""

import json
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.runtime.camera_files import CameraFile, open_cameras, split_pick
from gsgen.runtime.camera_files.colmap_models import CAMERA_MODELS
from gsgen.runtime.camera_files.fields import matrix
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.source import StillFrameSource

OPENGL = np.diag([1.0, -1, -1, 1])


def some_cameras(n: int = 5, seed: int = 0, *, centred: bool = False) -> list[Camera]:
    """Cameras all over the place, with any principal point."""
    rng = np.random.default_rng(seed)
    results = []
    for _ in range(n):
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        axes *= np.sign(np.linalg.det(axes))
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = axes, rng.normal(size=3) * 10
        width, height = rng.integers(20, 4000, 2).tolist()
        fx, fy = rng.uniform(50, 3000, 2).tolist()
        cx, cy = (rng.uniform(0.3, 0.7, 2) * [width, height]).tolist()
        if centred:
            cx, cy = width / 2, height / 2
        results.append(Camera(view, fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height))
    return results


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """The quaternion (w, x, y, z) as the eigenvector of Bar-Itzhack 2000."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    k = [
        [a - e - i, d + b, g + c, h - f],
        [d + b, e - a - i, h + f, c - g],
        [g + c, h + f, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ]
    x, y, z, w = np.linalg.eigh(np.array(k))[1][:, -1]
    return np.array([w, x, y, z])


def write_own(cameras: list[Camera], folder: Path) -> Path:
    path = folder / "own"
    path.write_text(f"[{','.join(camera.to_json() for camera in cameras)}]")
    return path


def write_transforms(cameras: list[Camera], folder: Path) -> Path:
    frames = [
        {
            "file_path": f"images/frame_{number:03}.jpg",
            "transform_matrix": (np.linalg.inv(camera.view) @ OPENGL).tolist(),
            "fl_x": camera.fx,
            "fl_y": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "w": float(camera.width),
            "h": camera.height,
        }
        for number, camera in enumerate(cameras)
    ]
    path = folder / "anything.txt"
    path.write_text("\ufeff" + json.dumps({"k1": 0.0, "aabb_scale": 4, "frames": frames}))
    return path


def write_training(cameras: list[Camera], folder: Path) -> Path:
    """As Kerbl et al.'s camera_to_JSON does."""
    results = []
    for number, camera in enumerate(cameras):
        to_world = np.linalg.inv(camera.view)
        results.append(
            {
                "id": number,
                "img_name": f"{number:05}",
                "width": camera.width,
                "height": camera.height,
                "position": to_world[:3, 3].tolist(),
                "rotation": to_world[:3, :3].tolist(),
                "fy": camera.fy,
                "fx": camera.fx,
            }
        )
    path = folder / "cameras.json"
    path.write_text(json.dumps(results))
    return path


def write_colmap_binary(cameras: list[Camera], folder: Path) -> Path:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    lenses, images = struct.pack("<Q", len(cameras)), struct.pack("<Q", len(cameras))
    for number, camera in enumerate(cameras):
        intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
        lenses += struct.pack("<iiQQ4d", 7 + number, 1, camera.width, camera.height, *intrinsics)
        turn = 3.0 * quaternion(camera.view[:3, :3])  # of any length
        images += struct.pack("<i7di", number, *turn, *camera.view[:3, 3], 7 + number)
        images += f"sub/{number}.png".encode() + b"\0" + struct.pack("<Q", number)
        images += number * struct.pack("<ddq", 1.5, 2.5, -1)
    (model / "cameras.bin").write_bytes(lenses)
    (model / "images.bin").write_bytes(images)
    return folder


def write_colmap_text(cameras: list[Camera], folder: Path) -> Path:
    lenses, images = ["# Camera list", ""], ["# Image list"]
    for number, camera in enumerate(cameras):
        words = (
            number,
            "PINHOLE",
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
        )
        lenses.append(" ".join(map(str, words)))
        pose = (*quaternion(camera.view[:3, :3]), *camera.view[:3, 3])
        images.append(" ".join(map(str, (9, *map(float, pose), number, f"a b {number}.png"))))
        images.append("" if number % 2 else "1.0 2.0 -1 3.0 4.0 17")
    (folder / "cameras.txt").write_text("\n".join(lenses))
    (folder / "images.txt").write_text("\n".join(images) + "\n")
    return folder


def write_path(cameras: list[Camera], folder: Path) -> Path:
    """Nerfstudio's viewer: one size, square pixels, and a vertical angle for each frame."""
    frames = [
        {
            "camera_to_world": (np.linalg.inv(camera.view) @ OPENGL).ravel().tolist(),
            "fov": float(np.degrees(2 * np.arctan(camera.height / 2 / camera.fy))),
            "aspect": camera.width / camera.height,
        }
        for camera in cameras
    ]
    size = {"render_width": float(cameras[0].width), "render_height": cameras[0].height}
    path = folder / "path.json"
    path.write_text(json.dumps(size | {"seconds": 4, "fps": 24, "camera_path": frames}))
    return path


WRITERS: dict[str, Callable[[list[Camera], Path], Path]] = {
    "own": write_own,
    "transforms": write_transforms,
    "training": write_training,
    "path": write_path,
    "colmap_binary": write_colmap_binary,
    "colmap_text": write_colmap_text,
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", WRITERS)
def test_written_cameras_are_read_back(name: str, seed: int, tmp_path: Path) -> None:
    cameras = some_cameras(seed=seed, centred=name in ("training", "path"))
    if name == "path":
        size = {"width": 640, "height": 480, "cx": 320, "cy": 240}
        cameras = [replace(camera, fx=camera.fy, **size) for camera in cameras]
    file = open_cameras(WRITERS[name](cameras, tmp_path))
    assert len(file.cameras) == len(cameras)
    notes = {"transforms": "aabb_scale", "path": "aspect"}
    assert file.notes == ((f"{file.path}: not used: {notes[name]}",) if name in notes else ())
    for read, expected in zip(file.cameras, cameras, strict=True):
        np.testing.assert_allclose(read.camera.view, expected.view, atol=1e-9)
        for field in ("fx", "fy", "cx", "cy"):
            assert getattr(read.camera, field) == pytest.approx(getattr(expected, field))
        assert (read.camera.width, read.camera.height) == (expected.width, expected.height)
        assert read.camera.kind == "pinhole"


def transforms(folder: Path, frame: dict[str, object] | None = None, **shared: object) -> Path:
    entry = {"file_path": "./train/r_0", "transform_matrix": np.eye(4).tolist()}
    path = folder / "transforms.json"
    path.write_text(json.dumps(shared | {"frames": [entry | (frame or {})]}))
    return path


def only_camera(path: Path) -> Camera:
    (camera,) = open_cameras(path).cameras
    return camera.camera


def test_an_opengl_camera_looks_along_minus_z(tmp_path: Path) -> None:
    camera = only_camera(transforms(tmp_path, camera_angle_x=np.pi / 2, w=80, h=60))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((40, 40, 40, 30))
    above = camera.view @ [0, 1, -5, 1]
    np.testing.assert_allclose(above, [0, -1, 5, 1], atol=1e-12)  # up in the world: up, ahead
    both = only_camera(transforms(tmp_path, camera_angle_x=1.0, camera_angle_y=0.5, w=80, h=60))
    assert both.fy == pytest.approx(30 / np.tan(0.25))
    three_rows = {"transform_matrix": np.eye(4)[:3].tolist()}
    assert only_camera(transforms(tmp_path, three_rows, fl_y=10, w=8, h=6)).fx == 10


def test_sizes_come_from_the_picture_where_the_file_has_none(tmp_path: Path) -> None:
    path = transforms(tmp_path, camera_angle_x=1.0)
    with pytest.raises(ConfigInvalid, match=r"no image size.*'./train/r_0'.*\n.*--size"):
        open_cameras(path)
    (tmp_path / "train").mkdir()
    Image.new("RGB", (33, 21)).save(tmp_path / "train" / "r_0.png")
    assert (only_camera(path).width, only_camera(path).height) == (33, 21)


def test_an_equirectangular_camera_is_a_panorama(tmp_path: Path) -> None:
    """Nerfstudio's has fl_x = height and fl_y = height for a full one."""
    path = transforms(tmp_path, camera_model="EQUIRECTANGULAR", fl_x=32, fl_y=32, w=64, h=32)
    camera = only_camera(path)
    assert camera.kind == "panorama"
    assert camera.period == pytest.approx(64)
    assert camera.fy * np.pi == pytest.approx(32)


def test_a_path_may_be_of_panoramas(tmp_path: Path) -> None:
    path = write_path(some_cameras(2, centred=True), tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"camera_type": "equirectangular"}))
    for camera in open_cameras(path).cameras:
        assert camera.camera.kind == "panorama"
        assert camera.camera.period == pytest.approx(camera.camera.width)


def test_an_equirectangular_camera_sees_where_nerfstudio_s_rays_go(tmp_path: Path) -> None:
    """Nerfstudio's ray of a pixel: θ = −π (u − cx) / fl_x, polar angle π / 2 + π (v − cy) / fl_y."""
    rng = np.random.default_rng(3)
    to_world = np.linalg.inv(some_cameras(1, 9)[0].view)
    frame: dict[str, object] = {"transform_matrix": to_world.tolist()}
    path = transforms(tmp_path, frame, camera_model="EQUIRECTANGULAR", fl_x=32, fl_y=32, w=64, h=32)
    camera = only_camera(path)
    for u, v in rng.uniform((0, 0), (64, 32), (50, 2)):
        theta, polar = -np.pi * (u - 32) / 32, np.pi / 2 + np.pi * (v - 16) / 32
        ray = np.array(
            [-np.sin(theta) * np.sin(polar), np.cos(polar), -np.cos(theta) * np.sin(polar)]
        )
        point = to_world[:3, :3] @ ray * rng.uniform(0.5, 9) + to_world[:3, 3]
        x, y, z, _ = camera.view @ [*point, 1]
        seen_u = camera.fx * np.arctan2(x, z) + camera.cx
        seen_v = camera.fy * np.arcsin(y / np.linalg.norm([x, y, z])) + camera.cy
        assert (seen_u, seen_v) == pytest.approx((u, v), abs=1e-6)


NOT_DRAWN = {"FOV", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM"}


@pytest.mark.parametrize("model", CAMERA_MODELS)
def test_colmap_lens_models_are_read_or_refused(model: str, tmp_path: Path) -> None:
    values = {"f": 40.0, "fx": 40.0, "fy": 50.0, "cx": 30.0, "cy": 20.0}
    names = CAMERA_MODELS[model].split()
    for distortion in (0.0, 0.01):
        numbers = " ".join(str(values.get(name, distortion)) for name in names)
        (tmp_path / "cameras.txt").write_text(f"1 {model} 64 48 {numbers}\n")
        (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
        if model in NOT_DRAWN:
            with pytest.raises(ConfigInvalid, match=f"model is {model}, expected one of SIMPLE"):
                open_cameras(tmp_path)
            continue
        file = open_cameras(tmp_path / "images.txt")  # any file of the model will do
        camera = file.cameras[0].camera
        assert (camera.fx, camera.cx, camera.cy) == (40, 30, 20)
        assert camera.fy == (50 if "fy" in names else 40)
        assert camera.kind == ("fisheye" if "FISHEYE" in model else "pinhole")
        has_coefficients = len(names) > 3 + ("fy" in names)
        assert (camera.distortion is not None) == (distortion > 0 and has_coefficients)
        assert file.notes == ()
    (tmp_path / "cameras.txt").write_text(f"1 {model} 64 48 1.0\n")
    with pytest.raises(ConfigInvalid, match=r"expected one of SIMPLE|has 1 parameters, expected"):
        open_cameras(tmp_path)


def camera_file_named(*names: str) -> CameraFile:
    from gsgen.runtime.camera_files import NamedCamera

    camera = some_cameras(1)[0]
    return CameraFile(
        path="here", format="a test", cameras=tuple(NamedCamera(name, camera) for name in names)
    )


def test_picking_by_name_number_and_slice() -> None:
    file = camera_file_named("a/one.png", "a/two.png", "b/one.png", "3")
    for index, expected in {
        "a/one.png": [0],
        "two.png": [1],
        "two": [1],
        "0": [0],
        "-1": [3],
        "3": [3],
        "1:": [1, 2, 3],
        "::2": [0, 2],
        "-2:": [2, 3],
    }.items():
        assert file.pick(index) == tuple(file.cameras[offset] for offset in expected), index
    assert file.pick(None) == file.cameras
    for index, words in {
        "one": r"2 cameras are called 'one': a/one.png, b/one.png",
        "4": "has no camera 4, expected 0 to 3",
        "-5": "has no camera -5, expected 0 to 3",
        "9:": "selects none of the 4",
        "::0": "selects none of the 4",
        "tow.png": r"unknown camera 'tow.png'\n  Did you mean 'two.png'\? It has a/one.png, a/two",
        "": "unknown camera ''",
    }.items():
        with pytest.raises(ConfigInvalid, match=words):
            file.pick(index)
    with pytest.raises(ConfigInvalid, match="and 12 more; a number"):
        camera_file_named(*(f"image_{n}" for n in range(20))).pick("none")


def test_camera_option_selects_from_files(tmp_path: Path) -> None:
    cameras = some_cameras(4, centred=True)
    path = write_training(cameras, tmp_path)
    picked_view = viewpoint(f"{path}#00002")
    assert len(picked_view.cameras) == 1
    np.testing.assert_allclose(picked_view.cameras[0].view, cameras[2].view, atol=1e-9)
    assert len(viewpoint(f"{tmp_path}#1:3").cameras) == 2  # a folder finds its cameras.json
    odd = tmp_path / "a#1"
    odd.write_text(cameras[0].to_json())
    assert split_pick(str(odd)) == (odd, None)
    assert split_pick(f"{odd}#0") == (odd, "0")


WRONG = {
    "[]": "has no cameras",
    "{": "is not valid JSON",
    "[" * 100_000: "is not valid JSON",
    "ply\n": "is a PLY file without vertices, expected a camera file",
    '{"a": 1}': "is JSON without cameras, but with a",
    "[3]": "is JSON without cameras, but with 3",
    '{"frames": []}': "has no frames",
    '{"frames": [3]}': "frame 0: the frame is a int",
    '{"w": 2, "h": 2, "frames": [{}]}': "frame 0: lacks transform_matrix: expected 4×4 finite",
    '{"w": 1e999, "h": 2, "frames": [{}]}': "w is inf, expected a finite number",
    '{"w": 2.5, "h": 2, "frames": [{}]}': "w is 2.5, expected whole pixels",
    '{"w": 2, "h": 2, "camera_angle_x": 0, "frames": [{"transform_matrix": '
    "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}": "camera_angle_x is 0.0, expected radians",
    '{"w": 2, "h": 2, "frames": [{"transform_matrix": '
    "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}": "has neither fl_x nor camera_angle_x",
    '{"w": 2, "h": 2, "fl_x": 3, "frames": [{"transform_matrix": '
    "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]}]}": "not a rigid transform",
    '[{"rotation": [[1,0],[0,1]], "position": [0,0,0]}]': "rotation is .* expected 3×3 finite",
    '[{"rotation": [[1,0,0],[0,1,0],[0,0,1]], "position": "x"}]': "position is 'x', expected 3 f",
    '{"camera_path": [], "camera_type": "vr180"}': "camera_type is 'vr180', expected one of persp",
    '{"camera_path": []}': "has no frames",
    '{"camera_path": [{}]}': "lacks render_width",
    '{"camera_path": [{}], "render_width": 4, "render_height": 4}': "frame 0: lacks camera_to_w",
    '{"camera_path": [{"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1], "fov": 180}], '
    '"render_width": 4, "render_height": 4}': "fov is 180.0, expected degrees",
    '[{"view": 1}, {"fx": 2}]': "camera 0, camera: lacks fx",
    '[{"rotation": 1, "position": 2}, 5]': "camera 1: the JSON value is a int, expected",
}


@pytest.mark.parametrize("content", WRONG, ids=range(len(WRONG)))
def test_invalid_camera_json_is_explained(content: str, tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    path.write_text(content)
    with pytest.raises((ConfigInvalid, SceneInvalid), match=WRONG[content]) as caught:
        open_cameras(path)
    assert str(caught.value).startswith(str(path))


def test_paths_without_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match=r"is a folder without cameras\n.*sparse/0"):
        open_cameras(tmp_path)
    with pytest.raises(ConfigInvalid, match="does not exist"):
        open_cameras(tmp_path / "none")
    (tmp_path / "empty.json").touch()
    with pytest.raises(ConfigInvalid, match="is an empty file"):
        open_cameras(tmp_path / "empty.json")


def error_text(path: Path) -> str | None:
    """What our error says, or None where there are cameras."""
    try:
        open_cameras(path)
    except GsgenError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", ["colmap_binary", "colmap_text", "transforms", "training", "path"])
def test_damaged_files_are_refused_or_read_without_crash(name: str, tmp_path: Path) -> None:
    """Cut, flipped and stuffed files: an error of ours, or cameras."""
    rng = np.random.default_rng(5)
    path = WRITERS[name](some_cameras(3, centred=True), tmp_path)
    files = [path] if path.is_file() else [entry for entry in path.rglob("*.*") if entry.is_file()]
    refused = 0
    for file in files:
        whole = file.read_bytes()
        for trial in range(120):
            result = bytearray(whole)
            if trial % 3 == 0:
                result = result[: rng.integers(len(result))]
            elif trial % 3 == 1:
                for offset in rng.integers(len(result), size=3):
                    result[offset] = rng.integers(256)
            else:
                offset = rng.integers(len(result))
                result[offset:offset] = rng.choice(
                    [b"\xff" * 8, b"-1", b"1e999", b"nan", b"\0", b"[["]
                )
            file.write_bytes(result)
            expected_message = error_text(path)
            assert expected_message is None or str(tmp_path) in expected_message
            refused += expected_message is not None
        file.write_bytes(whole)
    assert refused >= 40
    assert len(open_cameras(path).cameras) == 3


def test_a_count_beyond_the_file_is_not_believed(tmp_path: Path) -> None:
    folder = write_colmap_binary(some_cameras(1), tmp_path)
    file = folder / "sparse/0/images.bin"
    file.write_bytes(b"\xff" * 7 + b"\x7f" + file.read_bytes()[8:])
    with pytest.raises(ConfigInvalid, match=r"declares \d+ records, more than its \d+ bytes"):
        open_cameras(folder)


def test_films_have_frames_of_one_size(renderer: Renderer, tmp_path: Path) -> None:
    path = write_own(some_cameras(3), tmp_path)
    sizes = viewpoint(str(path)).sizes
    assert len(sizes) == 3
    assert viewpoint(str(path), width=40, height=30).sizes == {(40, 30)}
    assert len(viewpoint(str(path), width=40, panorama=True).sizes) == 0
    assert viewpoint(None).sizes == set()
    film = FrameSequence(
        [StillFrameSource(points(tmp_path))], viewpoint(str(path)), renderer=renderer
    )
    for name in ("a.npy", "a.gif"):
        with pytest.raises(
            ConfigInvalid, match=r"frames of one size, .*×.*\n.*--width and --height"
        ):
            film.write(tmp_path / name)
        assert not (tmp_path / name).exists()


def points(folder: Path) -> Path:
    path = folder / "points.npz"
    np.savez(path, points=np.zeros((4, 3), np.float32), colors=np.zeros((4, 3), np.uint8))
    return path


@pytest.mark.parametrize(
    "value", [[1, 2], [1, 2, 3, 4], [[1, 2, 3]], 1, [1, 2, math.nan], [1, 2, 1e999], ["a", 1, 2]]
)
def test_arrays_of_another_shape_or_without_numbers_are_refused(value: object) -> None:
    with pytest.raises(ConfigInvalid, match="3 finite numbers"):
        matrix({"position": value}, "position", (3,), "camera 5")
    np.testing.assert_array_equal(matrix({"position": [1, 2, 3]}, "position", (3,), ""), [1, 2, 3])
