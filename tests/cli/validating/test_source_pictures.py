"""`gsgen references --from`: pictures of the training code, and what the model makes of them."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.runtime.checks import level, source_pictures
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.commands import gsgen_here

SIZE = {"width": 96, "height": 64}


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


@pytest.fixture(autouse=True)
def _one_device(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    quads = Renderer(renderer.device, rasteriser="quads") if renderer.device.blends_floats else None
    both = {"tiles": renderer, "quads": quads}
    for module in (level, source_pictures):
        monkeypatch.setattr(module, "Renderer", lambda *_, rasteriser: both[rasteriser])


@pytest.fixture
def trained(tmp_path: Path, renderer: Renderer) -> Path:
    """A folder with a model, its training code's renders, and their cameras."""
    spec = find("still_sh1").draw()
    find("still_sh1").write(tmp_path)
    rows, colors = spec.weights["rows"], spec.weights["colors"]
    scene = Scene([SplatSet(SplatData(rows, colors, "sh", count=len(rows)))], "srgb")
    (tmp_path / "renders").mkdir()
    frames = []
    for number, azimuth in enumerate((0.0, 120.0, 240.0)):
        camera = Camera.orbit(
            [0, 0, 0], 3.0, azimuth=azimuth, elevation=10, up=(0, -1, 0), fov_y=50, **SIZE
        )
        drawn = renderer.render(scene, camera, background=(0, 0, 0, 1)).srgb8[..., :3]
        Image.fromarray(drawn).save(tmp_path / "renders" / f"view_{number}.png")
        matrix = np.linalg.inv(camera.view) @ np.diag([1, -1, -1, 1])  # OpenGL's axes
        lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
        size = {"w": camera.width, "h": camera.height}
        path = f"images/view_{number}.png"
        frames.append({"file_path": path, "transform_matrix": matrix.tolist()} | lens | size)
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    return tmp_path


def recorded(folder: Path, *options: object):
    words = ("--from", folder / "renders", "--cameras", folder / "transforms.json")
    source = folder / "still_sh1.onnx"
    return gsgen_here("references", source, "-o", folder / "copy.onnx", *words, *options)


def validate_pictures(path: Path) -> tuple[str, int]:
    report = validate(path, Settings(level=Level.RENDER))
    actual = sum(finding.rule == "GB021" for finding in report.findings)
    return report.outcome("GB021").status, actual


def test_pictures_of_the_training_code_are_declared_and_compared(trained: Path) -> None:
    completed = recorded(trained, "--json")
    assert completed.code == 0, completed.err
    document = json.loads(completed.out)
    images = loads(open_model(trained / "copy.onnx").manifest_text).reference_images
    assert [image.from_ for image in images] == ["source"] * 3
    assert [entry["from"] for entry in document["reference_images"]] == ["source"] * 3
    assert {image.psnr for image in images} == {35.0}
    assert min(document["decibels"]) > 50
    assert validate_pictures(trained / "copy.onnx") == ("pass", 0)


def test_fields_of_the_cameras_that_are_not_used_are_noted(trained: Path) -> None:
    path = trained / "transforms.json"
    document = json.loads(path.read_text())
    document["frames"][0]["time"] = 0.5
    path.write_text(json.dumps(document | {"aabb_scale": 4}))
    completed = recorded(trained)
    assert completed.code == 0, completed.err
    assert "not used: aabb_scale" in completed.err
    assert "not used: the times; all pictures have the inputs of" in completed.err


@pytest.mark.parametrize(
    ("lens", "words"),
    [({"k1": 0.1}, "pinhole with lens distortion"), ({"is_fisheye": True}, "kind fisheye")],
)
def test_cameras_with_a_lens_are_refused(
    trained: Path, lens: dict[str, object], words: str
) -> None:
    """A declared picture has a pinhole, so the pictures have to be undistorted."""
    path = trained / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | lens))
    completed = recorded(trained)
    assert completed.code == 2
    assert words in completed.err
    assert "give the cameras of the undistorted pictures" in completed.err
    assert not (trained / "copy.onnx").exists()


def test_swapped_channels_are_seen_only_against_the_source(trained: Path) -> None:
    spec = find("still_sh1").draw()
    colors = spec.weights["colors"].reshape(-1, 4, 3)[..., ::-1].reshape(-1, 12)
    spec.with_weights(colors=np.ascontiguousarray(colors)).write(trained / "still_sh1.onnx")
    completed = recorded(trained)
    assert completed.code == 0, completed.err
    assert "less than the declared 35" in completed.out
    status, count = validate_pictures(trained / "copy.onnx")
    assert (status, count > 0) == ("fail", True)
    own = gsgen_here(
        "references", trained / "still_sh1.onnx", "-o", trained / "own.onnx", "--width", "96"
    )
    assert "drawn by the model itself: a fault that it has now is part of the pictures" in own.err
    assert validate_pictures(trained / "own.onnx")[0] == "pass"  # the fault is frozen


def test_pictures_are_laid_over_black_and_scale_their_cameras(trained: Path) -> None:
    for path in (trained / "renders").iterdir():
        with Image.open(path) as image:
            large_picture = image.resize((192, 128)).convert("RGBA")
        large_picture.save(path)
    completed = recorded(trained)
    assert completed.code == 0, completed.err
    images = loads(open_model(trained / "copy.onnx").manifest_text).reference_images
    assert images[0].center == (96.0, 64.0)
    with Image.open(trained / images[0].path) as image:
        assert (image.mode, image.size) == ("RGB", (192, 128))


def test_pictures_without_a_camera_are_named_and_none_at_all_is_an_error(trained: Path) -> None:
    Image.new("RGB", (96, 64)).save(trained / "renders" / "other.png")
    completed = recorded(trained, "--count", "2")
    assert completed.code == 0
    assert "no camera is named like other.png" in completed.err
    assert len(loads(open_model(trained / "copy.onnx").manifest_text).reference_images) == 2
    for path in (trained / "renders").glob("view_*"):
        path.unlink()
    completed = recorded(trained, "--force")
    assert completed.code == 2
    assert "holds 1 pictures, and none is named like a camera (view_0" in completed.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--from", "renders"), "--from, --cameras: are only used together"),
        (("--from", "nowhere", "--cameras", "transforms.json"), "is not a folder, expected one of"),
        (
            ("--from", "renders", "--cameras", "transforms.json", "--probe", "time=9"),
            "--probe: unknown probe 'time=9'",
        ),
    ],
)
def test_wrong_options_are_named(trained: Path, options: tuple[str, ...], words: str) -> None:
    model = trained / "still_sh1.onnx"
    completed = gsgen_here("references", model, "-o", trained / "c.onnx", *options, cwd=trained)
    assert completed.code in (2, 4)
    assert words in completed.err
    assert not (trained / "c.onnx").exists()


def test_a_model_of_the_camera_is_refused(trained: Path) -> None:
    source = find("fade_column").write(trained)
    words = ("--from", trained / "renders", "--cameras", trained / "transforms.json")
    completed = gsgen_here("references", source, "-o", trained / "c.onnx", *words)
    assert completed.code == 2
    assert "depends on the camera (view)" in completed.err
