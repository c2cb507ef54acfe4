"""transforms.json of nerfstudio, Instant-NGP and the synthetic scenes of NeRF.

``transform_matrix`` is camera → world, of an OpenGL camera: +x right, +y up, +z backward. The
intrinsics are pixels (``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``) of all frames, of one frame,
or an angle of view (``camera_angle_x``, ``camera_angle_y``). Documented by nerfstudio ("Data
conventions") and by Instant-NGP ("Tips for training NeRF models").
"""

__all__ = ["is_transforms", "read_transforms"]

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import made_camera, matrix, number, side, text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opengl

_STRAIGHT: Final = (
    "PERSPECTIVE",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
)
_PANORAMA: Final = "EQUIRECTANGULAR"
_BENT: Final = ("k1", "k2", "k3", "k4", "p1", "p2")
_SUFFIXES: Final = ("", ".png", ".jpg")  # the synthetic scenes leave it out


def is_transforms(made: object) -> bool:
    """Say whether the content is such an object."""
    return isinstance(made, dict) and isinstance(made.get("frames"), list)


def read_transforms(made: Mapping[str, Any], path: str) -> CameraFile:
    """Read the frames.

    Raises:
        ConfigInvalid: Something is missing or of another shape, or a lens bends too much.
        SceneInvalid: The numbers make no camera.
    """
    frames = made["frames"]
    if not frames:
        raise ConfigInvalid("has no frames", where=path)
    found: list[NamedCamera] = []
    bent = 0
    size: tuple[int, int] | None = None
    for at, frame in enumerate(frames):
        where = f"{path}, frame {at}"
        if not isinstance(frame, dict):
            raise ConfigInvalid(
                f"is a {type(frame).__name__}, wanted an object", where=where
            )
        merged = {**made, **frame}
        if not {"w", "h"} <= merged.keys():
            size = size or _picture_size(merged, path, where)
            merged |= {"w": size[0], "h": size[1]}
        found.append(_camera(merged, at, where))
        bent += any(merged.get(name) not in (None, 0) for name in _BENT)
    notes = []
    if bent:
        notes.append(
            f"{path}: the lens distortion of {bent} of {len(frames)} frames is left out; "
            "their pictures need to be undistorted to match."
        )
    return CameraFile(path, "transforms.json", tuple(found), tuple(notes))


def _camera(made: Mapping[str, Any], at: int, where: str) -> NamedCamera:
    width, height = side(made, "w", where), side(made, "h", where)
    to_world = matrix(made, "transform_matrix", _shape(made), where)
    model = text(made, "camera_model", "PERSPECTIVE").upper()
    if made.get("is_fisheye") or model not in (*_STRAIGHT, _PANORAMA):
        raise ConfigInvalid(
            f"has the camera model {model if not made.get('is_fisheye') else 'fisheye'}, "
            "which no pinhole can stand for",
            where=where,
            hint=f"Known: {', '.join(_STRAIGHT)}, {_PANORAMA}. Undistort the pictures first.",
        )
    fx, fy = _focal(made, "x", width, where), _focal(made, "y", height, where)
    scale = math.pi if model == _PANORAMA else 1.0  # there a radian has fl / π pixels
    camera = made_camera(
        where,
        view=view_from_opengl(to_world),
        fx=fx / scale,
        fy=fy / scale,
        cx=number(made, "cx", where) if "cx" in made else width / 2,
        cy=number(made, "cy", where) if "cy" in made else height / 2,
        width=width,
        height=height,
        kind="panorama" if model == _PANORAMA else "pinhole",
    )
    return NamedCamera(text(made, "file_path", str(at)), camera)


def _shape(made: Mapping[str, Any]) -> tuple[int, int]:
    """Return the shape of the matrix: some writers leave the last row out."""
    held = made.get("transform_matrix")
    return (3, 4) if isinstance(held, list) and len(held) == 3 else (4, 4)


def _focal(made: Mapping[str, Any], axis: str, pixels: int, where: str) -> float:
    """Return a focal length: given, from the angle of view, or that of the other axis."""
    for name in (axis, "x" if axis == "y" else "y"):
        if f"fl_{name}" in made:
            return number(made, f"fl_{name}", where)
        angle = f"camera_angle_{name}"
        if angle in made:
            across = side(made, "w" if name == "x" else "h", where)
            radians = number(made, angle, where)
            if not 0 < radians < math.pi:
                raise ConfigInvalid(
                    f"{angle} is {radians}, wanted radians between 0 and π", where=where
                )
            return across / 2 / math.tan(radians / 2)
    raise ConfigInvalid(
        f"lacks fl_{axis} and camera_angle_{axis}: {pixels} pixels of what angle?",
        where=where,
    )


def _picture_size(made: Mapping[str, Any], path: str, where: str) -> tuple[int, int]:
    """Return the size of a frame's picture, which is what w and h would be."""
    from PIL import Image

    name = text(made, "file_path", "")
    for suffix in _SUFFIXES:
        file = Path(path).parent / (name + suffix)
        try:
            if file.is_file():  # a pipe would never end
                with Image.open(file) as picture:
                    return picture.size
        except (OSError, ValueError, Image.DecompressionBombError):
            continue  # none that has a size: the next name, and then the error
    raise ConfigInvalid(
        f"lacks w and h, and there is no picture {name!r} to take them from",
        where=where,
        hint='Add "w" and "h" to the file: the size of its pictures, in pixels.',
    )
