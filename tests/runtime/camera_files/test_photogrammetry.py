"""Camera files of photogrammetry: each format by its own formulas, and others by their names."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.runtime.camera_files import open_cameras
from gsgen.runtime.scene.camera import Camera

OPENGL = np.diag([1.0, -1, -1])


def some_cameras(seed: int, *, is_square: bool, is_centred: bool) -> list[Camera]:
    """Cameras with random poses, as the intrinsics of a format allow."""
    rng = np.random.default_rng(seed)
    cameras = []
    for rotation in Rotation.random(4, rng=rng).as_matrix():
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = rotation, rng.normal(size=3) * 5
        width, height = rng.integers(20, 200, 2).tolist()
        fx, fy = rng.uniform(50, 300, 2).tolist()
        cx, cy = (rng.uniform(0.3, 0.7, 2) * [width, height]).tolist()
        middle = {"cx": width / 2, "cy": height / 2} if is_centred else {"cx": cx, "cy": cy}
        fy = fx if is_square else fy
        cameras.append(Camera(view, fx=fx, fy=fy, width=width, height=height, **middle))
    return cameras


def write_opensfm(cameras: list[Camera], folder: Path) -> Path:
    lenses, shots = {}, {}
    for number, camera in enumerate(cameras):
        longer = max(camera.width, camera.height)
        lenses[f"lens {number}"] = {
            "projection_type": "brown",
            "width": camera.width,
            "height": camera.height,
            "focal_x": camera.fx / longer,
            "focal_y": camera.fy / longer,
            "c_x": (camera.cx - camera.width / 2) / longer,
            "c_y": (camera.cy - camera.height / 2) / longer,
        }
        shots[f"{number}.jpg"] = {
            "rotation": Rotation.from_matrix(camera.view[:3, :3]).as_rotvec().tolist(),
            "translation": camera.view[:3, 3].tolist(),
            "camera": f"lens {number}",
        }
    path = folder / "reconstruction.json"
    path.write_text(json.dumps([{"cameras": lenses, "shots": shots, "points": {}}]))
    return path


def write_openmvg(cameras: list[Camera], folder: Path) -> Path:
    views, intrinsics, extrinsics = [], [], []
    for number, camera in enumerate(cameras):
        data = {"filename": f"{number}.jpg", "id_view": number, "id_pose": number}
        data |= {"id_intrinsic": 7 + number, "width": camera.width, "height": camera.height}
        views.append({"key": number, "value": {"ptr_wrapper": {"id": 1, "data": data}}})
        lens = {
            "width": camera.width,
            "height": camera.height,
            "focal_length": camera.fx,
            "principal_point": [camera.cx, camera.cy],
        }
        wrapped = {"polymorphic_name": "pinhole", "ptr_wrapper": {"id": 2, "data": lens}}
        intrinsics.append({"key": 7 + number, "value": wrapped})
        pose = {"rotation": camera.view[:3, :3].tolist(), "center": camera.eye.tolist()}
        extrinsics.append({"key": number, "value": pose})
    path = folder / "sfm_data.json"
    document = {"views": views, "intrinsics": intrinsics, "extrinsics": extrinsics}
    path.write_text(json.dumps({"sfm_data_version": "0.3"} | document))
    return path


def write_bundler(cameras: list[Camera], folder: Path) -> Path:
    lines, names = ["# Bundle file v0.3", f"{len(cameras)} 0"], []
    for number, camera in enumerate(cameras):
        rotation, translation = OPENGL @ camera.view[:3, :3], OPENGL @ camera.view[:3, 3]
        lines += [f"{camera.fx} 0 0", *(" ".join(map(str, row)) for row in rotation.tolist())]
        lines.append(" ".join(map(str, translation.tolist())))
        names.append(f"{number}.png 0 {camera.fx}")
        Image.new("L", (camera.width, camera.height)).save(folder / f"{number}.png")
    (folder / "list.txt").write_text("\n".join(names))
    path = folder / "bundle.out"
    path.write_text("\n".join(lines))
    return path


def write_metashape(cameras: list[Camera], folder: Path) -> Path:
    document = Element("document", version="2.0.0")
    chunk = SubElement(document, "chunk", label="Chunk 1")
    sensors, entries = SubElement(chunk, "sensors"), SubElement(chunk, "cameras")
    for number, camera in enumerate(cameras):
        size = {"width": str(camera.width), "height": str(camera.height)}
        sensor = SubElement(sensors, "sensor", id=str(number), type="frame")
        SubElement(sensor, "resolution", size)
        calibration = SubElement(sensor, "calibration", {"class": "adjusted"})
        SubElement(calibration, "resolution", size)
        for tag, value in {
            "f": camera.fx,
            "cx": camera.cx - camera.width / 2,
            "cy": camera.cy - camera.height / 2,
        }.items():
            SubElement(calibration, tag).text = repr(value)
        entry = SubElement(entries, "camera", id="9", sensor_id=str(number), label=f"{number}.jpg")
        matrix = np.linalg.inv(camera.view).ravel().tolist()
        SubElement(entry, "transform").text = " ".join(map(repr, matrix))
    path = folder / "cameras.xml"
    path.write_bytes(tostring(document, xml_declaration=True))
    return path


Writer = Callable[[list[Camera], Path], Path]
# Each writer, and whether pixels of the format are square and principal points in the middle.
WRITERS: dict[str, tuple[Writer, bool, bool]] = {
    "opensfm": (write_opensfm, False, False),
    "openmvg": (write_openmvg, True, False),
    "bundler": (write_bundler, True, True),
    "metashape": (write_metashape, True, False),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", WRITERS)
def test_written_cameras_of_photogrammetry_are_read_back(
    name: str, seed: int, tmp_path: Path
) -> None:
    write, is_square, is_centred = WRITERS[name]
    cameras = some_cameras(seed, is_square=is_square, is_centred=is_centred)
    file = open_cameras(write(cameras, tmp_path))
    assert file.notes == ()
    assert [Path(entry.name).stem for entry in file.cameras] == list("0123")
    for entry, expected in zip(file.cameras, cameras, strict=True):
        np.testing.assert_allclose(entry.camera.view, expected.view, atol=1e-9)
        for field in ("fx", "fy", "cx", "cy", "width", "height"):
            assert getattr(entry.camera, field) == pytest.approx(getattr(expected, field))


def changed_json(path: Path, change: Callable[[Any], object]) -> Path:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def test_fields_and_cameras_that_are_not_used_are_named(tmp_path: Path) -> None:
    cameras = some_cameras(1, is_square=True, is_centred=True)
    sfm = write_opensfm(cameras, tmp_path)
    changed_json(sfm, lambda document: document[0]["cameras"]["lens 1"].update(gps=0.1))
    assert open_cameras(sfm).notes == (f"{sfm}: not used: gps",)
    changed_json(sfm, lambda document: document.append(document[0]))
    assert "the first of 2 reconstructions" in open_cameras(sfm).notes[1]
    mvg = write_openmvg(cameras, tmp_path)
    changed_json(mvg, lambda document: document["extrinsics"].pop())
    assert open_cameras(mvg).notes == (f"{mvg}: 1 of 4 views have no pose",)
    shape = write_metashape(cameras, tmp_path)
    text = shape.read_text().replace("</calibration>", "<b2>0.1</b2></calibration>", 1)
    shape.write_text(text.replace("</chunk>", "<transform><scale>2</scale></transform></chunk>"))
    notes = open_cameras(shape).notes
    assert notes[0] == f"{shape}: not used: b2"
    assert "transform of the chunk" in notes[1]
    bundle = write_bundler(cameras, tmp_path)
    lines = bundle.read_text().splitlines()
    lines[2] = "0 0 0"
    bundle.write_text("\n".join(lines))
    assert [note.partition(": ")[2] for note in open_cameras(bundle).notes] == [
        "1 of 4 cameras were not located"
    ]


def test_a_bundle_without_pictures_takes_the_given_size(tmp_path: Path) -> None:
    path = write_bundler(some_cameras(2, is_square=True, is_centred=True), tmp_path)
    for picture in tmp_path.glob("*.png"):
        picture.unlink()
    assert {entry.camera.width for entry in open_cameras(path, (64, 48)).cameras} == {64}
    with pytest.raises(ConfigInvalid, match=r"no picture '0\.png'"):
        open_cameras(path)


# How files of other programs begin, and words of the error.
OTHERS = {
    "alembic": (b"Ogawa\xff\x00\x01", "Alembic file.*\n.*transforms.json"),
    "alembic of hdf5": (b"\x89HDF\r\n\x1a\n", "Alembic file"),
    "realitycapture": (b"#name,x,y,alt,heading,pitch,roll\n", "RealityCapture.*\n.*COLMAP"),
    "realitycapture spaced": (b"# Name, X, Y, Z\n", "RealityCapture"),
    "realitycapture xmp": (b'<x:xmpmeta xmlns:xcr="http://www.capturingreality"/>', "XMP.*\n.*COL"),
    "visualsfm": (b"NVM_V3 \n\n4\n", "VisualSFM.*\n.*COLMAP"),
    "usd": (b"#usda 1.0\n", "USD stage.*\n.*transforms.json"),
    "usd crate": (b"PXR-USDC\0", "USD stage"),
    "fbx": (b"Kaydara FBX Binary  \0", "FBX file"),
    "metashape project": (b"PK\x03\x04rest", "ZIP archive.*\n.*Agisoft XML"),
    "other xml": (b"<?xml version='1.0'?><scene/>", "XML file.*\n.*Metashape"),
    "nothing known": (b"\x01\x02\x03\x04", "begins with"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_files_of_other_programs_are_named_with_the_way_out(name: str, tmp_path: Path) -> None:
    content, words = OTHERS[name]
    path = tmp_path / "cameras.any"
    path.write_bytes(content)
    with pytest.raises(ConfigInvalid, match=words) as caught:
        open_cameras(path)
    assert "Supported: cameras of gsgen" in str(caught.value)


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files_of_photogrammetry_are_refused_or_read(name: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    write, is_square, is_centred = WRITERS[name]
    path = write(some_cameras(3, is_square=is_square, is_centred=is_centred), tmp_path)
    whole = path.read_bytes()
    refused = 0
    for trial in range(150):
        content = bytearray(whole)
        if trial % 3 == 0:
            content = content[: rng.integers(len(content))]
        elif trial % 3 == 1:
            content[rng.integers(len(content))] = rng.integers(256)
        else:
            offset = rng.integers(len(content))
            content[offset:offset] = rng.choice([b"\xff" * 8, b"-1", b"1e999", b"nan", b"[[", b"<"])
        path.write_bytes(content)
        try:
            open_cameras(path)
        except GsgenError as error:
            refused += 1
            assert str(tmp_path) in str(error)  # noqa: PT017
    assert refused >= 40


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document[0].update(shots={}),
        lambda document: document[0].update(shots=[]),
        lambda document: document[0]["shots"]["0.jpg"].update(camera="other"),
        lambda document: document[0]["shots"]["0.jpg"].pop("rotation"),
        lambda document: document[0]["cameras"]["lens 0"].update(projection_type="dual"),
        lambda document: document[0]["cameras"]["lens 0"].pop("focal_x"),
        lambda document: document[0]["cameras"]["lens 0"].update(width="wide"),
        lambda document: document[0].update(cameras=3),
    ],
)
def test_invalid_reconstructions_are_explained(
    change: Callable[[Any], object], tmp_path: Path
) -> None:
    cameras = some_cameras(1, is_square=True, is_centred=True)
    path = changed_json(write_opensfm(cameras, tmp_path), change)
    with pytest.raises(ConfigInvalid, match=r"expected|shots"):
        open_cameras(path)
