"""Reads transforms.json of nerfstudio, Instant-NGP and NeRF's synthetic scenes.

``transform_matrix`` is camera → world of an OpenGL camera: +x right, +y up, +z backward. The
intrinsics, of all frames or of one, are pixels (``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``) or
an angle of view (``camera_angle_x``, ``camera_angle_y``). ``time`` is the time of a frame's scene
(D-NeRF, nerfstudio). Documented by nerfstudio ("Data
conventions") and by Instant-NGP ("Tips for training NeRF models").
"""

__all__ = ["is_transforms", "read_transforms"]

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import (
    Fields,
    camera_at,
    matrix,
    number,
    pixel_count,
    text,
    unused_fields,
)
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.picture_size import picture_size
from gsgen.runtime.camera_files.poses import view_from_opengl

_SUPPORTED_MODELS: Final = (
    "PERSPECTIVE",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
)
_PANORAMA_MODEL: Final = "EQUIRECTANGULAR"
_DISTORTION_FIELDS: Final = ("k1", "k2", "k3", "k4", "p1", "p2")


def is_transforms(document: object) -> bool:
    """Return whether a JSON document is a transforms.json of nerfstudio, Instant-NGP or NeRF."""
    return isinstance(document, dict) and isinstance(document.get("frames"), list)


def read_transforms(
    document: Mapping[str, Any], path: str, size: tuple[int, int] | None = None
) -> CameraFile:
    """Read the camera of each frame of a transforms.json (nerfstudio, Instant-NGP, NeRF).

    Args:
        document: The JSON document.
        path: Path of the file.
        size: Width and height of frames that have neither a size nor a picture.
    """
    shared_fields = Fields(document)
    frames = shared_fields["frames"]
    if not frames:
        raise ConfigInvalid("has no frames, expected at least one", where=path)
    objects = [shared_fields]
    cameras: list[NamedCamera] = []
    distorted_count = 0
    for index, frame in enumerate(frames):
        where = f"{path}, frame {index}"
        if not isinstance(frame, dict):
            raise ConfigInvalid(
                f"the frame is a {type(frame).__name__}, expected an object", where=where
            )
        fields = Fields(frame, shared_fields)
        objects.append(fields)
        cameras.append(_camera(fields, index, where, _frame_size(fields, path, where, size)))
        coefficients = [fields.get(name) for name in _DISTORTION_FIELDS]
        distorted_count += any(value not in (None, 0) for value in coefficients)
    notes = unused_fields(path, objects)
    if distorted_count:
        notes += (
            f"{path}: the lens distortion of {distorted_count} of {len(frames)} frames is left out; "
            "their pictures need to be undistorted to match.",
        )
    return CameraFile(path=path, format="transforms.json", cameras=tuple(cameras), notes=notes)


def _frame_size(
    fields: Fields, path: str, where: str, default: tuple[int, int] | None
) -> tuple[int, int]:
    """Return a frame's width and height: declared, or else those of its picture."""
    if "w" in fields and "h" in fields:
        return pixel_count(fields, "w", where), pixel_count(fields, "h", where)
    return picture_size(Path(path).parent, text(fields, "file_path", ""), default, where)


def _camera(fields: Fields, index: int, where: str, size: tuple[int, int]) -> NamedCamera:
    width, height = size
    to_world = matrix(fields, "transform_matrix", _matrix_shape(fields), where)
    model = text(fields, "camera_model", "PERSPECTIVE").upper()
    if fields.get("is_fisheye") or model not in (*_SUPPORTED_MODELS, _PANORAMA_MODEL):
        raise ConfigInvalid(
            f"has the camera model {model if not fields.get('is_fisheye') else 'fisheye'}, "
            "which no pinhole camera approximates",
            where=where,
            hint=f"Supported: {', '.join(_SUPPORTED_MODELS)}, {_PANORAMA_MODEL}. Undistort the pictures first.",
        )
    fx, fy = _focal_length(fields, "x", where, size), _focal_length(fields, "y", where, size)
    scale = math.pi if model == _PANORAMA_MODEL else 1.0  # a panorama has fl / π pixels per radian
    camera = camera_at(
        where,
        view=view_from_opengl(to_world),
        fx=fx / scale,
        fy=fy / scale,
        cx=number(fields, "cx", where) if "cx" in fields else width / 2,
        cy=number(fields, "cy", where) if "cy" in fields else height / 2,
        width=width,
        height=height,
        kind="panorama" if model == _PANORAMA_MODEL else "pinhole",
    )
    time = number(fields, "time", where) if fields.get("time") is not None else None
    return NamedCamera(text(fields, "file_path", str(index)), camera, time)


def _matrix_shape(document: Mapping[str, Any]) -> tuple[int, int]:
    """Return the shape of a ``transform_matrix``, whose last row some writers omit."""
    transform = document.get("transform_matrix")
    return (3, 4) if isinstance(transform, list) and len(transform) == 3 else (4, 4)


def _focal_length(
    document: Mapping[str, Any], axis: str, where: str, size: tuple[int, int]
) -> float:
    """Return a focal length in pixels: stored, from the angle of view, or of the other axis."""
    # An angle beside a stored length says the same once more; reading it records that it is used.
    angles = {name: document.get(f"camera_angle_{name}") for name in "xy"}
    for name in (axis, "x" if axis == "y" else "y"):
        if f"fl_{name}" in document:
            return number(document, f"fl_{name}", where)
        angle = f"camera_angle_{name}"
        if angles[name] is not None:
            radians = number(document, angle, where)
            if not 0 < radians < math.pi:
                raise ConfigInvalid(
                    f"{angle} is {radians}, expected radians between 0 and π", where=where
                )
            return size["xy".index(name)] / 2 / math.tan(radians / 2)
    raise ConfigInvalid(
        f"has neither fl_{axis} nor camera_angle_{axis}, expected one of them as the focal length",
        where=where,
    )
