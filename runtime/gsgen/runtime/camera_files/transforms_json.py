"""Reads transforms.json of nerfstudio, Instant-NGP and NeRF's synthetic scenes.

``transform_matrix`` is camera → world of an OpenGL camera: +x right, +y up, +z backward. The
intrinsics, of all frames or of one, are pixels (``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``) or
an angle of view (``camera_angle_x``, ``camera_angle_y``). Lens distortion is in OpenCV's terms, k1 to
k4, p1 and p2; without k5 and k6, k4 is of the eighth power of the radius, as in nerfstudio. ``time``
is the time of a frame's scene (D-NeRF, nerfstudio). Documented by nerfstudio ("Data conventions")
and by Instant-NGP ("Tips for training NeRF models").
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
    coefficients,
    distortion_at,
    matrix,
    number,
    pixel_count,
    text,
    unused_fields,
)
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.picture_size import picture_size
from gsgen.runtime.camera_files.poses import view_from_opengl
from gsgen.runtime.scene.camera import Kind
from gsgen.runtime.scene.distortion import Distortion

_PINHOLE_MODELS: Final = (
    "PERSPECTIVE",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
)
_PANORAMA_MODEL: Final = "EQUIRECTANGULAR"
_FISHEYE_MODELS: Final = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_DISTORTION_FIELDS: Final = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_F_THETA_FIELD: Final = "ftheta_p0"  # of Instant-NGP's f-theta lenses


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
    for index, frame in enumerate(frames):
        where = f"{path}, frame {index}"
        if not isinstance(frame, dict):
            raise ConfigInvalid(
                f"the frame is a {type(frame).__name__}, expected an object", where=where
            )
        fields = Fields(frame, shared_fields)
        objects.append(fields)
        cameras.append(_camera(fields, index, where, _frame_size(fields, path, where, size)))
    notes = unused_fields(path, objects)
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
    kind, model = _kind_and_model(fields, where)
    fx, fy = _focal_length(fields, "x", where, size), _focal_length(fields, "y", where, size)
    scale = math.pi if kind == "panorama" else 1.0  # a panorama has fl / π pixels per radian
    camera = camera_at(
        where,
        view=view_from_opengl(to_world),
        fx=fx / scale,
        fy=fy / scale,
        cx=number(fields, "cx", where) if "cx" in fields else width / 2,
        cy=number(fields, "cy", where) if "cy" in fields else height / 2,
        width=width,
        height=height,
        kind=kind,
        distortion=None if kind == "panorama" else _distortion(fields, model, kind, where),
    )
    time = number(fields, "time", where) if fields.get("time") is not None else None
    return NamedCamera(text(fields, "file_path", str(index)), camera, time)


def _kind_and_model(fields: Fields, where: str) -> tuple[Kind, str]:
    """Return the kind of a frame's camera, and the name of its camera model."""
    model = text(fields, "camera_model", "PERSPECTIVE").upper()
    kinds: dict[str, Kind] = {
        **dict.fromkeys(_PINHOLE_MODELS, "pinhole"),
        **dict.fromkeys(_FISHEYE_MODELS, "fisheye"),
        _PANORAMA_MODEL: "panorama",
    }
    if _F_THETA_FIELD in fields or model not in kinds:
        raise ConfigInvalid(
            f"has the camera model {'f-theta' if _F_THETA_FIELD in fields else model}, "
            f"expected one of {', '.join(kinds)}",
            where=where,
            hint="Undistort the pictures first, and give the cameras of the undistorted pictures.",
        )
    kind = "fisheye" if fields.get("is_fisheye") else kinds[model]
    if kind == "fisheye" and "fl_x" not in fields and "fl_y" not in fields:
        message = "has a fisheye without fl_x and fl_y, expected its focal length in pixels"
        raise ConfigInvalid(message, where=where)
    return kind, model


def _distortion(fields: Fields, model: str, kind: Kind, where: str) -> Distortion:
    """Return a frame's lens distortion; k5 and k6 exist in OpenCV's rational model alone."""
    values = coefficients(fields, _DISTORTION_FIELDS, where)
    has_divisor = any(values.get(name) for name in ("k5", "k6"))
    if kind == "fisheye" and has_divisor:
        raise ConfigInvalid("has a fisheye with k5 or k6, expected k1 to k4", where=where)
    return distortion_at(where, values, is_rational=model == "FULL_OPENCV" or has_divisor)


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
