"""Reads transforms.json of nerfstudio, Instant-NGP and NeRF's synthetic scenes.

``transform_matrix`` is camera → world of an OpenGL camera: +x right, +y up, +z backward. The
intrinsics, of all frames or of one, are pixels (``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``) or
an angle of view (``camera_angle_x``, ``camera_angle_y``). Documented by nerfstudio ("Data
conventions") and by Instant-NGP ("Tips for training NeRF models").
"""

__all__ = ["is_transforms", "read_transforms"]

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import camera_at, matrix, number, pixel_count, text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opengl

_SUPPORTED_MODELS: Final = (
    "PERSPECTIVE",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
)
_PANORAMA: Final = "EQUIRECTANGULAR"
_DISTORTION_FIELDS: Final = ("k1", "k2", "k3", "k4", "p1", "p2")
_SUFFIXES: Final = ("", ".png", ".jpg")  # synthetic scenes omit the suffix


def is_transforms(document: object) -> bool:
    """Return whether a JSON document is a transforms.json of nerfstudio, Instant-NGP or NeRF."""
    return isinstance(document, dict) and isinstance(document.get("frames"), list)


def read_transforms(document: Mapping[str, Any], path: str) -> CameraFile:
    """Read the camera of each frame of a transforms.json (nerfstudio, Instant-NGP, NeRF)."""
    frames = document["frames"]
    if not frames:
        raise ConfigInvalid("has no frames, expected at least one", where=path)
    cameras: list[NamedCamera] = []
    distorted_count = 0
    size: tuple[int, int] | None = None
    for index, frame in enumerate(frames):
        where = f"{path}, frame {index}"
        if not isinstance(frame, dict):
            raise ConfigInvalid(
                f"the frame is a {type(frame).__name__}, expected an object", where=where
            )
        merged = {**document, **frame}
        if not {"w", "h"} <= merged.keys():
            size = size or _picture_size(merged, path, where)
            merged |= {"w": size[0], "h": size[1]}
        cameras.append(_camera(merged, index, where))
        distorted_count += any(merged.get(name) not in (None, 0) for name in _DISTORTION_FIELDS)
    notes = []
    if distorted_count:
        notes.append(
            f"{path}: the lens distortion of {distorted_count} of {len(frames)} frames is left out; "
            "their pictures need to be undistorted to match."
        )
    return CameraFile(path, "transforms.json", tuple(cameras), tuple(notes))


def _camera(document: Mapping[str, Any], index: int, where: str) -> NamedCamera:
    width, height = pixel_count(document, "w", where), pixel_count(document, "h", where)
    to_world = matrix(document, "transform_matrix", _matrix_shape(document), where)
    model = text(document, "camera_model", "PERSPECTIVE").upper()
    if document.get("is_fisheye") or model not in (*_SUPPORTED_MODELS, _PANORAMA):
        raise ConfigInvalid(
            f"has the camera model {model if not document.get('is_fisheye') else 'fisheye'}, "
            "which no pinhole camera approximates",
            where=where,
            hint=f"Supported: {', '.join(_SUPPORTED_MODELS)}, {_PANORAMA}. Undistort the pictures first.",
        )
    fx, fy = _focal(document, "x", where), _focal(document, "y", where)
    scale = math.pi if model == _PANORAMA else 1.0  # a panorama has fl / π pixels per radian
    camera = camera_at(
        where,
        view=view_from_opengl(to_world),
        fx=fx / scale,
        fy=fy / scale,
        cx=number(document, "cx", where) if "cx" in document else width / 2,
        cy=number(document, "cy", where) if "cy" in document else height / 2,
        width=width,
        height=height,
        kind="panorama" if model == _PANORAMA else "pinhole",
    )
    return NamedCamera(text(document, "file_path", str(index)), camera)


def _matrix_shape(document: Mapping[str, Any]) -> tuple[int, int]:
    """Return the shape of a ``transform_matrix``, whose last row some writers omit."""
    transform = document.get("transform_matrix")
    return (3, 4) if isinstance(transform, list) and len(transform) == 3 else (4, 4)


def _focal(document: Mapping[str, Any], axis: str, where: str) -> float:
    """Return a focal length in pixels: stored, from the angle of view, or of the other axis."""
    for name in (axis, "x" if axis == "y" else "y"):
        if f"fl_{name}" in document:
            return number(document, f"fl_{name}", where)
        angle = f"camera_angle_{name}"
        if angle in document:
            pixel_size = pixel_count(document, "w" if name == "x" else "h", where)
            radians = number(document, angle, where)
            if not 0 < radians < math.pi:
                raise ConfigInvalid(
                    f"{angle} is {radians}, expected radians between 0 and π", where=where
                )
            return pixel_size / 2 / math.tan(radians / 2)
    raise ConfigInvalid(
        f"has neither fl_{axis} nor camera_angle_{axis}, expected one of them as the focal length",
        where=where,
    )


def _picture_size(document: Mapping[str, Any], path: str, where: str) -> tuple[int, int]:
    """Return the size of a frame's image file, for files without w and h."""
    from PIL import Image

    name = text(document, "file_path", "")
    for suffix in _SUFFIXES:
        file = Path(path).parent / (name + suffix)
        try:
            if file.is_file():  # a pipe would never end
                with Image.open(file) as picture:
                    return picture.size
        except (OSError, ValueError, Image.DecompressionBombError):
            continue  # unreadable: try the next name
    raise ConfigInvalid(
        f"the file lacks w and h, and there is no picture {name!r} to take them from",
        where=where,
        hint='Add "w" and "h" to the file: the size of its pictures, in pixels.',
    )
