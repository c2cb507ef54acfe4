"""A camera path of nerfstudio's viewer: what a film shows, frame by frame.

``camera_to_world`` has the sixteen numbers of a matrix row by row, of an OpenGL camera; ``fov`` is
the vertical angle in degrees. The other frames between the viewer's keyframes are in the file.
"""

__all__ = ["is_path", "read_path"]

import math
from collections.abc import Mapping
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import made_camera, matrix, number, side, text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opengl

_STRAIGHT: Final = "perspective"
_PANORAMA: Final = "equirectangular"


def is_path(made: object) -> bool:
    """Say whether the content is such an object."""
    return isinstance(made, dict) and isinstance(made.get("camera_path"), list)


def read_path(made: Mapping[str, Any], path: str) -> CameraFile:
    """Read the frames.

    Raises:
        ConfigInvalid: Something is missing or of another shape, or the camera is neither a pinhole
            nor a panorama.
        SceneInvalid: The numbers make no camera.
    """
    kind = text(made, "camera_type", _STRAIGHT).lower()
    if kind not in (_STRAIGHT, _PANORAMA):
        raise ConfigInvalid(
            f"camera_type is {kind!r}, wanted {_STRAIGHT} or {_PANORAMA}", where=path
        )
    if not made["camera_path"]:
        raise ConfigInvalid("has no frames", where=path)
    width, height = side(made, "render_width", path), side(made, "render_height", path)
    cameras = tuple(
        _camera(frame, at, path, (width, height), kind)
        for at, frame in enumerate(made["camera_path"])
    )
    return CameraFile(path, "a camera path of nerfstudio", cameras)


def _camera(
    made: object, at: int, path: str, size: tuple[int, int], kind: str
) -> NamedCamera:
    where = f"{path}, frame {at}"
    if not isinstance(made, dict):
        raise ConfigInvalid(f"is a {type(made).__name__}, wanted an object", where=where)
    width, height = size
    to_world = matrix(made, "camera_to_world", (16,), where).reshape(4, 4)
    values: dict[str, Any] = {
        "view": view_from_opengl(to_world),
        "cx": width / 2,
        "cy": height / 2,
        "width": width,
        "height": height,
    }
    if kind == _PANORAMA:
        values |= {"fx": width / (2 * math.pi), "fy": height / math.pi, "kind": "panorama"}
    else:
        degrees = number(made, "fov", where)
        if not 0 < degrees < 180:
            raise ConfigInvalid(
                f"fov is {degrees}, wanted degrees between 0 and 180", where=where
            )
        focal = height / 2 / math.tan(math.radians(degrees) / 2)
        values |= {"fx": focal, "fy": focal}
    return NamedCamera(str(at), made_camera(where, **values))
