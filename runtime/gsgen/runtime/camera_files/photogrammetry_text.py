"""Reads the cameras of two photogrammetry programs: Bundler's ``.out`` and Metashape's XML.

1. Bundler: rotation and translation map world → camera, whose axes are those of OpenGL; the
   principal point is the middle of the image. Names are in ``list.txt`` beside the file.
2. Metashape ("Export cameras", Agisoft XML): ``transform`` is camera → chunk in the axes of
   ``Camera``; ``cx`` and ``cy`` are offsets from the middle of the image, in pixels. A fisheye is
   equidistant; ``b1`` is added to the horizontal focal length, and a skew ``b2`` is not used.
"""

__all__ = ["is_bundler", "is_metashape", "read_bundler", "read_metashape"]

import math
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import (
    Fields,
    camera_at,
    coefficients,
    distortion_at,
    matrix,
    number,
    pixel_count,
    unused_fields,
)
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.picture_size import picture_size
from gsgen.runtime.camera_files.poses import view_from_opencv

_BUNDLER_FIRST_LINE: Final = b"# Bundle file"
_CAMERA_NUMBERS: Final = 15  # focal length, two coefficients of distortion, rotation, translation
_LARGEST_NUMBER: Final = 1e300
_OPENCV_FROM_OPENGL: Final = np.diag([1.0, -1.0, -1.0])
_SENSOR_KINDS: Final = {
    "frame": "pinhole",
    "": "pinhole",
    "fisheye": "fisheye",
    "equidistant_fisheye": "fisheye",
}
# Metashape's P1 and P2 are OpenCV's p2 and p1 ("Camera models" of its manual).
_METASHAPE_COEFFICIENTS: Final = {
    "k1": "k1",
    "k2": "k2",
    "k3": "k3",
    "k4": "k4",
    "p1": "p2",
    "p2": "p1",
}


def is_bundler(content: bytes) -> bool:
    """Return whether a file begins as Bundler's list of cameras."""
    return content.startswith(_BUNDLER_FIRST_LINE)


def read_bundler(content: bytes, path: Path, size: tuple[int, int] | None = None) -> CameraFile:
    """Read the located cameras of Bundler's ``bundle.out``.

    Args:
        content: The file's bytes.
        path: Path of the file; its pictures are relative to the folder.
        size: Width and height of cameras without a picture.
    """
    lines = [line for line in content.decode("utf-8", "replace").splitlines() if line[:1] != "#"]
    words = " ".join(lines).split()
    try:
        count = int(words[0])
        if count < 0 or len(words) < 2 + count * _CAMERA_NUMBERS:
            raise ValueError(f"has {len(words) - 2} numbers after its counts")
        rows = np.array(words[2 : 2 + count * _CAMERA_NUMBERS], np.float64)
        if not (np.abs(rows) <= _LARGEST_NUMBER).all():
            raise ValueError("has a number that is not finite")
    except (ValueError, IndexError) as error:
        raise ConfigInvalid(
            f"cannot be read: {error}; expected {_CAMERA_NUMBERS} numbers per camera",
            where=str(path),
        ) from error
    rows = rows.reshape(count, _CAMERA_NUMBERS)
    names = _bundler_names(path.parent, count)
    located_indices = [index for index in range(count) if rows[index, 0] != 0]
    if not located_indices:
        raise ConfigInvalid(f"has no located camera among {count}", where=str(path))
    cameras = []
    for index in located_indices:
        where, focal = f"{path}, camera {index}", float(rows[index, 0])
        width, height = picture_size(path.parent, names[index], size, where)
        view = np.eye(4)
        view[:3, :3] = _OPENCV_FROM_OPENGL @ rows[index, 3:12].reshape(3, 3)
        view[:3, 3] = _OPENCV_FROM_OPENGL @ rows[index, 12:]
        middle = {"cx": width / 2, "cy": height / 2, "width": width, "height": height}
        lens = distortion_at(where, {"k1": float(rows[index, 1]), "k2": float(rows[index, 2])})
        camera = camera_at(where, view=view, fx=focal, fy=focal, distortion=lens, **middle)
        cameras.append(NamedCamera(names[index], camera))
    notes: tuple[str, ...] = ()
    if len(located_indices) < count:
        notes += (f"{path}: {count - len(located_indices)} of {count} cameras were not located",)
    return CameraFile(
        path=str(path), format="a bundle file of Bundler", cameras=tuple(cameras), notes=notes
    )


def _bundler_names(folder: Path, count: int) -> list[str]:
    """Return the names of pictures in ``list.txt``, or numbers without such a list."""
    file = folder / "list.txt"
    lines = file.read_text("utf-8", "replace").splitlines() if file.is_file() else []
    names = [line.split()[0] for line in lines if line.strip()]
    return names if len(names) == count else [str(index) for index in range(count)]


def is_metashape(content: bytes) -> bool:
    """Return whether a file is XML with the cameras of Metashape."""
    return content.lstrip()[:1] == b"<" and b"<document" in content and b"<sensors" in content


def read_metashape(content: bytes, path: str) -> CameraFile:
    """Read the located cameras of Metashape's XML, in the coordinates of the chunk."""
    try:
        chunk = ElementTree.fromstring(content).find("chunk")
    except ElementTree.ParseError as error:
        raise ConfigInvalid(f"is not valid XML: {error}", where=path) from error
    if chunk is None:
        raise ConfigInvalid("has no chunk, expected one with sensors and cameras", where=path)
    sensors = {
        sensor.get("id"): (sensor, _calibration(sensor)) for sensor in chunk.iterfind(".//sensor")
    }
    components = {part.get("id"): part for part in chunk.iterfind("components/component")}
    entries = list(chunk.iterfind("cameras//camera"))
    cameras = []
    for entry in entries:
        name = entry.get("label") or str(entry.get("id"))
        where = f"{path}, camera {name!r}"
        transform = entry.findtext("transform")
        if transform is None:
            continue
        if entry.get("sensor_id") not in sensors:
            raise ConfigInvalid(f"refers to sensor {entry.get('sensor_id')!r}", where=where)
        sensor, calibration = sensors[entry.get("sensor_id")]
        to_chunk = matrix({"transform": transform.split()}, "transform", (16,), where).reshape(4, 4)
        view = view_from_opencv(to_chunk[:3, :3], to_chunk[:3, 3])
        cameras.append(NamedCamera(name, _metashape_camera(sensor, calibration, view, where)))
    if not cameras:
        raise ConfigInvalid(f"has no located camera among {len(entries)}", where=path)
    notes = unused_fields(path, [calibration for _, calibration in sensors.values()])
    if len(cameras) < len(entries):
        notes += (
            f"{path}: {len(entries) - len(cameras)} of {len(entries)} cameras have no transform",
        )
    placed = [chunk, *components.values()]
    if any(part.find("transform") is not None for part in placed):
        notes += (f"{path}: not used: the transform of the chunk; cameras are in its coordinates",)
    return CameraFile(path=path, format="cameras of Metashape", cameras=tuple(cameras), notes=notes)


def _calibration(sensor: ElementTree.Element) -> Fields:
    """Return the numbers of a sensor's calibration; an adjusted one comes before an initial one."""
    calibrations = {entry.get("class"): entry for entry in sensor.iterfind("calibration")}
    chosen_calibration = calibrations.get("adjusted", next(iter(calibrations.values()), None))
    values: dict[str, Any] = {}
    for entry in chosen_calibration if chosen_calibration is not None else ():
        try:
            values[entry.tag] = float(entry.text or "")
        except ValueError:
            continue  # for example `resolution`, whose numbers are attributes
    return Fields(values)


def _metashape_camera(
    sensor: ElementTree.Element, calibration: Fields, view: np.ndarray, where: str
) -> Any:
    resolution = sensor.find("resolution")
    size = Fields(dict(resolution.items()) if resolution is not None else {})
    numbers = {name: _number_or_text(size[name]) for name in size}
    width, height = (pixel_count(numbers, name, where) for name in ("width", "height"))
    kind = sensor.get("type", "")
    values: dict[str, Any] = {"view": view, "width": width, "height": height}
    if kind == "spherical":
        values |= {"fx": width / (2 * math.pi), "fy": height / math.pi, "kind": "panorama"}
    elif kind in _SENSOR_KINDS:
        fx, fy = (
            number(calibration, f"f{axis}" if f"f{axis}" in calibration else "f", where)
            for axis in "xy"
        )
        found_coefficients = coefficients(calibration, _METASHAPE_COEFFICIENTS, where)
        values |= {"fx": fx + coefficients(calibration, ["b1"], where).get("b1", 0.0), "fy": fy}
        values["distortion"] = distortion_at(
            where,
            {_METASHAPE_COEFFICIENTS[name]: value for name, value in found_coefficients.items()},
        )
        values["kind"] = _SENSOR_KINDS[kind]
    else:
        raise ConfigInvalid(
            f"has a sensor of type {kind}, expected frame, fisheye, equidistant_fisheye or spherical",
            where=where,
            hint="Undistort the photos in Metashape, and export the cameras of the result.",
        )
    offsets = (number(calibration, n, where) if n in calibration else 0.0 for n in ("cx", "cy"))
    x_offset, y_offset = offsets
    return camera_at(where, cx=width / 2 + x_offset, cy=height / 2 + y_offset, **values)


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
