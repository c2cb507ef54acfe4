"""Reads camera paths of nerfstudio's viewer: one camera per frame of a video.

``camera_to_world`` is the matrix of an OpenGL camera, sixteen numbers row by row; ``fov`` is the
vertical angle in degrees. The file also holds the frames between the viewer's keyframes.
"""

__all__ = ["is_path", "read_path"]

import math
from collections.abc import Mapping
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import camera_at, matrix, number, side, text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opengl

_STRAIGHT: Final = "perspective"
_PANORAMA: Final = "equirectangular"


def is_path(document: object) -> bool:
    """Return whether a JSON document is a camera path of nerfstudio."""
    return isinstance(document, dict) and isinstance(document.get("camera_path"), list)


def read_path(document: Mapping[str, Any], path: str) -> CameraFile:
    """Read the camera of each frame of a nerfstudio camera path."""
    kind = text(document, "camera_type", _STRAIGHT).lower()
    if kind not in (_STRAIGHT, _PANORAMA):
        raise ConfigInvalid(
            f"camera_type is {kind!r}, expected {_STRAIGHT} or {_PANORAMA}", where=path
        )
    if not document["camera_path"]:
        raise ConfigInvalid("has no frames, expected at least one", where=path)
    width, height = (side(document, "render_width", path), side(document, "render_height", path))
    cameras = tuple(
        _camera(frame, index, path, (width, height), kind)
        for index, frame in enumerate(document["camera_path"])
    )
    return CameraFile(path, "a camera path of nerfstudio", cameras)


def _camera(
    document: object, index: int, path: str, size: tuple[int, int], kind: str
) -> NamedCamera:
    where = f"{path}, frame {index}"
    if not isinstance(document, dict):
        raise ConfigInvalid(
            f"the JSON value is a {type(document).__name__}, expected an object", where=where
        )
    width, height = size
    to_world = matrix(document, "camera_to_world", (16,), where).reshape(4, 4)
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
        degrees = number(document, "fov", where)
        if not 0 < degrees < 180:
            raise ConfigInvalid(
                f"fov is {degrees}, expected degrees between 0 and 180", where=where
            )
        focal = height / 2 / math.tan(math.radians(degrees) / 2)
        values |= {"fx": focal, "fy": focal}
    return NamedCamera(str(index), camera_at(where, **values))
