"""Lenses in camera files: each format puts points where its own formulas do, or is refused by name."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files import open_cameras
from gsgen.runtime.camera_files.colmap_models import CAMERA_MODELS, MODEL_NAMES
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.oracle.projection import ellipses
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from references.lenses import (
    Pixel,
    Point,
    bundler_pixel,
    colmap_pixel,
    metashape_pixel,
    nerfstudio_pixel,
    openmvg_pixel,
    opensfm_pixel,
)

WIDTH, HEIGHT = 640, 480
COEFFICIENTS = {
    "k": -0.05,
    "k1": -0.06,
    "k2": 0.03,
    "k3": -0.004,
    "k4": 0.0012,
    "k5": 0.02,
    "k6": 0.003,
    "p1": 0.004,
    "p2": -0.007,
    "sx1": 0.006,
    "sy1": -0.003,
}
LENGTHS = {"f": 300.0, "fx": 300.0, "fy": 310.0, "cx": 330.0, "cy": 225.0}
IDENTITY = np.eye(4).tolist()
Project = Callable[[Point], Pixel]


def colmap_text(model: str, folder: Path) -> tuple[Path, Project]:
    values = [(LENGTHS | COEFFICIENTS)[name] for name in CAMERA_MODELS[model].split()]
    numbers = " ".join(map(repr, values))
    (folder / "cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {numbers}\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    return folder, lambda point: colmap_pixel(model, values, point)


def colmap_binary(model: str, folder: Path) -> tuple[Path, Project]:
    values = [(LENGTHS | COEFFICIENTS)[name] for name in CAMERA_MODELS[model].split()]
    lens = struct.pack("<QiiQQ", 1, 1, MODEL_NAMES.index(model), WIDTH, HEIGHT)
    (folder / "cameras.bin").write_bytes(lens + struct.pack(f"<{len(values)}d", *values))
    image = struct.pack("<Qi7di", 1, 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(image)
    return folder, lambda point: colmap_pixel(model, values, point)


def transforms(names: str, folder: Path, **changes: object) -> tuple[Path, Project]:
    """A frame with some coefficients; its OpenGL camera is the world's camera turned about x."""
    numbers = {name: COEFFICIENTS[name] for name in names.split()}
    numbers |= {"fl_x": 300.0, "fl_y": 310.0, "cx": 330.0, "cy": 225.0}
    frame = {"file_path": "a", "transform_matrix": np.diag([1.0, -1, -1, 1]).tolist()}
    document = {"w": WIDTH, "h": HEIGHT, "frames": [frame]} | numbers | changes
    (folder / "transforms.json").write_text(json.dumps(document))
    is_fisheye = "is_fisheye" in changes or "FISHEYE" in str(changes.get("camera_model"))
    if "k5" in numbers:
        order = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        values = [numbers[name] for name in order]
        return folder, lambda point: colmap_pixel("FULL_OPENCV", values, point)
    return folder, lambda point: nerfstudio_pixel(numbers, point, is_fisheye=is_fisheye)


def camera_path(folder: Path) -> tuple[Path, Project]:
    """A fisheye of nerfstudio's viewer has the focal length of the perspective camera."""
    pose = np.diag([1.0, -1, -1, 1]).ravel().tolist()
    document = {"camera_type": "fisheye", "render_width": WIDTH, "render_height": HEIGHT}
    document |= {"camera_path": [{"camera_to_world": pose, "fov": 60.0}]}
    (folder / "path.json").write_text(json.dumps(document))
    focal = HEIGHT / 2 / np.tan(np.radians(30))
    values = [focal, WIDTH / 2, HEIGHT / 2]
    return folder / "path.json", lambda point: colmap_pixel("SIMPLE_FISHEYE", values, point)


def opensfm(kind: str, names: str, folder: Path) -> tuple[Path, Project]:
    lens: dict[str, object] = {name: COEFFICIENTS[name] for name in names.split()}
    lens |= {"projection_type": kind, "width": WIDTH, "height": HEIGHT}
    is_simple = kind in ("perspective", "fisheye")
    lens |= (
        {"focal": 0.5}
        if is_simple
        else {"focal_x": 0.5, "focal_y": 0.51, "c_x": 0.01, "c_y": -0.02}
    )
    shot = {"rotation": [0, 0, 0], "translation": [0, 0, 0], "camera": "lens"}
    path = folder / "reconstruction.json"
    path.write_text(json.dumps([{"cameras": {"lens": lens}, "shots": {"a": shot}, "points": {}}]))
    return path, lambda point: opensfm_pixel(lens, point)


def openmvg(field: str, names: str, folder: Path) -> tuple[Path, Project]:
    lens: dict[str, object] = {"width": WIDTH, "height": HEIGHT, "focal_length": 300.0}
    lens |= {"principal_point": [330.0, 225.0]}
    lens[field] = [COEFFICIENTS[name] for name in names.split()]
    view = {"filename": "a", "id_view": 0, "id_pose": 0, "id_intrinsic": 0}
    pose = {"rotation": np.eye(3).tolist(), "center": [0, 0, 0]}
    document = {
        "views": [{"key": 0, "value": {"ptr_wrapper": {"id": 1, "data": view}}}],
        "intrinsics": [{"key": 0, "value": {"ptr_wrapper": {"id": 2, "data": lens}}}],
        "extrinsics": [{"key": 0, "value": pose}],
    }
    (folder / "sfm_data.json").write_text(json.dumps(document))
    return folder / "sfm_data.json", lambda point: openmvg_pixel(lens, point)


def metashape(kind: str, folder: Path) -> tuple[Path, Project]:
    values = {name: COEFFICIENTS[name] for name in ("k1", "k2", "k3", "k4", "p1", "p2")}
    values |= {"f": 300.0, "cx": 10.0, "cy": -15.0, "b1": 4.0}
    calibration = "".join(f"<{name}>{value!r}</{name}>" for name, value in values.items())
    size = f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
    sensor = f'<sensor id="0" type="{kind}">{size}<calibration class="adjusted">{calibration}'
    pose = " ".join(map(str, np.eye(4).ravel()))
    text = f"<document><chunk><sensors>{sensor}</calibration></sensor></sensors><cameras>"
    text += f'<camera id="0" sensor_id="0" label="a"><transform>{pose}</transform></camera>'
    (folder / "cameras.xml").write_text(f"{text}</cameras></chunk></document>")
    size_pair = WIDTH, HEIGHT
    return folder / "cameras.xml", lambda point: metashape_pixel(kind, values, size_pair, point)


def bundler(folder: Path) -> tuple[Path, Project]:
    """Its camera is OpenGL's: the world's camera turned about x."""
    from PIL import Image

    Image.new("L", (WIDTH, HEIGHT)).save(folder / "a.png")
    (folder / "list.txt").write_text("a.png\n")
    lines = ["# Bundle file v0.3", "1 0", "300 -0.06 0.03", "1 0 0", "0 -1 0", "0 0 -1", "0 0 0"]
    (folder / "bundle.out").write_text("\n".join(lines))
    return folder / "bundle.out", lambda point: bundler_pixel(
        300, -0.06, 0.03, (WIDTH, HEIGHT), point
    )


def own(folder: Path) -> tuple[Path, Project]:
    """The file that ``Camera.to_json`` writes of a camera that COLMAP's reader made."""
    _, project = colmap_text("FULL_OPENCV", folder)
    camera = open_cameras(folder).cameras[0].camera
    (folder / "own.json").write_text(camera.to_json())
    return folder / "own.json", project


BROWN = "k1 k2 k3 p1 p2"
VARIANTS: dict[str, Callable[[Path], tuple[Path, Project]]] = {
    **{
        f"colmap {model}": lambda folder, model=model: colmap_text(model, folder)
        for model in (
            *("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "SIMPLE_RADIAL_FISHEYE"),
            *(
                "RADIAL_FISHEYE",
                "OPENCV_FISHEYE",
                "THIN_PRISM_FISHEYE",
                "SIMPLE_FISHEYE",
                "FISHEYE",
            ),
        )
    },
    "colmap binary OPENCV": lambda folder: colmap_binary("OPENCV", folder),
    "colmap binary THIN_PRISM_FISHEYE": lambda folder: colmap_binary("THIN_PRISM_FISHEYE", folder),
    "colmap binary FISHEYE": lambda folder: colmap_binary("FISHEYE", folder),
    "nerfstudio OPENCV": lambda folder: transforms(
        "k1 k2 p1 p2", folder, camera_model="OPENCV", k3=None
    ),
    "nerfstudio without a model": lambda folder: transforms("k1 k2 k3 k4 p1 p2", folder),
    "nerfstudio with a divisor": lambda folder: transforms(
        "k1 k2 k3 k4 k5 k6 p1 p2", folder, camera_model="OPENCV"
    ),
    "nerfstudio OPENCV_FISHEYE": lambda folder: transforms(
        "k1 k2 k3 k4", folder, camera_model="OPENCV_FISHEYE"
    ),
    "instant-ngp is_fisheye": lambda folder: transforms("k1 k2 k3 k4", folder, is_fisheye=True),
    "nerfstudio camera path": camera_path,
    "opensfm perspective": lambda folder: opensfm("perspective", "k1 k2", folder),
    "opensfm simple_radial": lambda folder: opensfm("simple_radial", "k1", folder),
    "opensfm radial": lambda folder: opensfm("radial", "k1 k2", folder),
    "opensfm brown": lambda folder: opensfm("brown", BROWN, folder),
    "opensfm fisheye": lambda folder: opensfm("fisheye", "k1 k2", folder),
    "opensfm fisheye_opencv": lambda folder: opensfm("fisheye_opencv", "k1 k2 k3 k4", folder),
    "openmvg radial k1": lambda folder: openmvg("disto_k1", "k1", folder),
    "openmvg radial k3": lambda folder: openmvg("disto_k3", "k1 k2 k3", folder),
    "openmvg brown t2": lambda folder: openmvg("disto_t2", BROWN, folder),
    "openmvg fisheye": lambda folder: openmvg("fisheye", "k1 k2 k3 k4", folder),
    "metashape frame": lambda folder: metashape("frame", folder),
    "metashape fisheye": lambda folder: metashape("fisheye", folder),
    "bundler": bundler,
    "gsgen": own,
}


NO_COEFFICIENTS = {
    *("colmap SIMPLE_FISHEYE", "colmap FISHEYE", "colmap binary FISHEYE"),
    *("nerfstudio camera path", "bundler", "gsgen"),
}


def pixels_of(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Where the reference renderer projects points of the world."""
    rows = np.zeros((len(points), 10))
    rows[:, :3], rows[:, [4, 7, 9]] = points, 1e-6
    data = SplatData(rows.astype(np.float32), np.zeros((len(points), 3), np.float32), "rgb")
    return ellipses(rows, SplatSet(data), camera).mean


@pytest.mark.parametrize("name", VARIANTS)
def test_lens_of_a_file_projects_as_its_program_does(name: str, tmp_path: Path) -> None:
    path, project = VARIANTS[name](tmp_path)
    file = open_cameras(path)
    assert file.notes == ()
    camera = file.cameras[0].camera
    np.testing.assert_allclose(camera.view, np.eye(4), atol=1e-12)
    rng = np.random.default_rng(1)
    points = rng.uniform((-0.9, -0.7, 1), (0.9, 0.7, 1), (60, 3)) * rng.uniform(0.5, 9, (60, 1))
    if camera.kind == "fisheye" and not name.startswith(("openmvg", "metashape")):
        points[30:, 2] *= -0.2  # those programs know no rays beyond a quarter turn
    expected = np.array([project(point) for point in points.tolist()])
    in_image = ((expected > 0) & (expected < [WIDTH, HEIGHT])).all(axis=1)
    assert in_image.sum() > 15
    np.testing.assert_allclose(pixels_of(camera, points)[in_image], expected[in_image], atol=1e-9)


@pytest.mark.parametrize("name", [name for name in VARIANTS if name not in NO_COEFFICIENTS])
def test_coefficient_that_is_too_large_is_refused_with_its_place(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(COEFFICIENTS, "k1", 1e200)
    monkeypatch.setitem(COEFFICIENTS, "k", 1e200)
    path, _ = VARIANTS[name](tmp_path)
    with pytest.raises(
        SceneInvalid, match=r"distortion\.radial: is .*expected 4 numbers"
    ) as caught:
        open_cameras(path)
    assert str(tmp_path) in str(caught.value)


def refused_text(model: str, folder: Path) -> Path:
    numbers = " ".join("300" for _ in CAMERA_MODELS.get(model, "w h").split())
    (folder / "cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {numbers}\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    return folder


def refused_binary(model: str, folder: Path) -> Path:
    lens = struct.pack("<QiiQQ", 1, 1, MODEL_NAMES.index(model), WIDTH, HEIGHT)
    (folder / "cameras.bin").write_bytes(lens + struct.pack("<16d", *([300.0] * 16)))
    image = struct.pack("<Qi7di", 1, 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(image)
    return folder


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    **{
        f"colmap {model}": (
            lambda folder, model=model: refused_text(model, folder),
            f"is {model}, ex",
        )
        for model in ("FOV", "DIVISION", "RAD_TAN_THIN_PRISM_FISHEYE", "EQUIRECTANGULAR", "NEWER")
    },
    **{
        f"colmap binary {model}": (
            lambda folder, model=model: refused_binary(model, folder),
            f"model is {model}, expected one of SIMPLE_PINHOLE",
        )
        for model in ("FOV", "RAD_TAN_THIN_PRISM_FISHEYE", "EUCM", "EQUIRECTANGULAR")
    },
    "nerfstudio FISHEYE624": (
        lambda folder: transforms("k1", folder, camera_model="FISHEYE624")[0],
        "camera model FISHEYE624, expected one of PERSPECTIVE",
    ),
    "nerfstudio stereo": (
        lambda folder: transforms("k1", folder, camera_model="OMNIDIRECTIONALSTEREO_L")[0],
        "camera model OMNIDIRECTIONALSTEREO_L, expected one of",
    ),
    "instant-ngp f-theta": (
        lambda folder: transforms("k1", folder, ftheta_p0=0.1)[0],
        "camera model f-theta, expected one of",
    ),
    "nerfstudio fisheye by angle": (
        lambda folder: angle_of_fisheye(folder),
        "fisheye without fl_x and fl_y",
    ),
    "nerfstudio fisheye with a divisor": (
        lambda folder: fisheye_k5(folder),
        "fisheye with k5 or k6",
    ),
    "opensfm dual": (lambda folder: opensfm("dual", "k1 k2", folder)[0], "of type dual, expected"),
    "opensfm fisheye62": (
        lambda folder: opensfm("fisheye62", "k1", folder)[0],
        "of type fisheye62",
    ),
    "metashape cylindrical": (
        lambda folder: metashape("cylindrical", folder)[0],
        "sensor of type cylindrical, expected frame, fisheye",
    ),
    "metashape equisolid": (
        lambda folder: metashape("equisolid_fisheye", folder)[0],
        "sensor of type equisolid_fisheye",
    ),
}


def angle_of_fisheye(folder: Path) -> Path:
    frame = {"transform_matrix": IDENTITY}
    document: dict[str, Any] = {"w": 8, "h": 6, "camera_angle_x": 1.0, "is_fisheye": True}
    (folder / "transforms.json").write_text(json.dumps(document | {"frames": [frame]}))
    return folder


def fisheye_k5(folder: Path) -> Path:
    frame = {"transform_matrix": IDENTITY}
    document: dict[str, Any] = {"w": 8, "h": 6, "fl_x": 4.0, "k5": 0.1, "is_fisheye": True}
    (folder / "transforms.json").write_text(json.dumps(document | {"frames": [frame]}))
    return folder


@pytest.mark.parametrize("name", REFUSED)
def test_lens_that_is_not_drawn_is_refused_by_name(name: str, tmp_path: Path) -> None:
    write, words = REFUSED[name]
    with pytest.raises(ConfigInvalid, match=words) as caught:
        open_cameras(write(tmp_path))
    assert str(tmp_path) in str(caught.value)
