"""`gsgen render` with files of cameras, and all around."""

import json
from pathlib import Path
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
from PIL import Image

from support.commands import Ran, gsgen_here


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud, and cameras of an Instant-NGP file with a bent lens."""
    result = tmp_path_factory.mktemp("cameras")
    rng = np.random.default_rng(0)
    colors = np.full((300, 3), 200, np.uint8)
    np.savez(result / "cloud.npz", points=rng.normal(size=(300, 3)), colors=colors)
    frames = [
        {"file_path": f"images/{name}.jpg", "transform_matrix": to_world(z)}
        for name, z in (("near", 4.0), ("far", 9.0))
    ]
    shared = {"camera_angle_x": 1.0, "w": 40, "h": 30, "k1": 0.05}
    (result / "transforms.json").write_text(json.dumps(shared | {"frames": frames}))
    return result


def to_world(z: float) -> list[list[float]]:
    matrix = np.eye(4)
    matrix[2, 3] = z
    return matrix.tolist()


def drawn(folder: Path, *words: str) -> Ran:
    return gsgen_here("render", "cloud.npz", "-o", "out.png", *words, cwd=folder)


def picture(folder: Path) -> np.ndarray:
    with Image.open(folder / "out.png") as image:
        return np.asarray(image.convert("RGB"))


def test_a_camera_is_picked_by_the_name_of_its_picture(folder: Path) -> None:
    finished = drawn(folder, "--camera", "transforms.json#near")
    assert finished.code == 0, finished.err
    assert finished.err == ""  # the lens distortion is drawn
    image = picture(folder)
    assert image.shape == (30, 40, 3)
    assert image.max() > 100
    wrong = drawn(folder, "--camera", "transforms.json#nera")
    assert wrong.code == 2
    assert "Did you mean 'near'? It has images/near.jpg, images/far.jpg" in wrong.err
    assert "Traceback" not in wrong.err
    for typed, meant in (("nera.jpg", "near.jpg"), ("images/nera.jpg", "images/near.jpg")):
        wrong = drawn(folder, "--camera", f"transforms.json#{typed}")
        assert f"Did you mean '{meant}'?" in wrong.err


def test_a_panorama_is_twice_as_wide_as_high(folder: Path) -> None:
    finished = drawn(folder, "--panorama", "--width", "64")
    assert finished.code == 0, finished.err
    image = picture(folder)
    assert image.shape == (32, 64, 3)
    assert (image.max(axis=(0, 2)) > 30).all()  # from the middle of the cloud: something all around


def test_two_eyes_stand_side_by_side(folder: Path) -> None:
    words = ("--stereo", "--eye-distance", "0.5", "--size", "24x20")
    finished = drawn(folder, *words)
    assert finished.code == 0, finished.err
    assert "no scene tells the length of its unit, which is taken to be a metre" in finished.err
    image = picture(folder)
    assert image.shape == (20, 48, 3)
    assert image[:, :24].max() > 100
    assert not np.array_equal(image[:, :24], image[:, 24:])
    alone = drawn(folder, *words[1:])
    assert alone.code == 2
    assert "--eye-distance: is that of two eyes: add --stereo" in alone.err
    assert "Did you mean --stereo?" in drawn(folder, "--sbs").err
    for kind, reason in (("panorama", "looks to all sides"), ("orthographic", "no perspective")):
        refused = drawn(folder, *words, f"--{kind}")
        assert refused.code == 2
        assert f"camera.kind: is {kind}, which" in refused.err
        assert f"{reason}, expected a pinhole or a fisheye for two eyes" in refused.err


def test_a_panorama_in_a_jpeg_says_so_to_viewers(folder: Path) -> None:
    words = ("--panorama", "--width", "64", "-o", "around.jpg")
    assert gsgen_here("render", "cloud.npz", *words, cwd=folder).code == 0
    with Image.open(folder / "around.jpg") as image:
        document = fromstring(image.info["xmp"])[0][0].attrib
    term = "{http://ns.google.com/photos/1.0/panorama/}"
    assert document[f"{term}ProjectionType"] == "equirectangular"
    assert document[f"{term}FullPanoWidthPixels"] == "64"
    assert document[f"{term}FullPanoHeightPixels"] == "32"
