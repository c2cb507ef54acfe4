"""Reads camera files that are lists of cameras in JSON, of three programs.

1. gsgen: the attributes of ``Camera`` and a name.
2. The training of 3D Gaussian Splatting (Kerbl et al. 2023, ``camera_to_JSON``): ``rotation`` is
   camera → world, its columns are the camera's axes (+x right, +y down, +z forward), ``position``
   is the camera centre. The principal point is the middle of the image, as in the training.
3. nerfstudio's viewer: one camera per frame of a video. ``camera_to_world`` is the matrix of an
   OpenGL camera, sixteen numbers row by row; ``fov`` is the vertical angle in degrees of a
   perspective camera, whose focal length a fisheye has, too, and
   ``render_time`` the time of the scene. The frames between the viewer's keyframes are in the file.
"""

__all__ = [
    "is_camera_path",
    "is_gsgen_camera",
    "is_training",
    "read_camera_path",
    "read_gsgen_cameras",
    "read_training_cameras",
]

import math
from collections.abc import Mapping
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import (
    Fields,
    camera_at,
    matrix,
    number,
    pixel_count,
    require_object,
    text,
    unused_fields,
)
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opencv, view_from_opengl
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera

_PERSPECTIVE_TYPE: Final = "perspective"
_PANORAMA_MODEL: Final = "equirectangular"
_FISHEYE_TYPE: Final = "fisheye"


def is_gsgen_camera(document: object) -> bool:
    """Return whether a JSON document is one gsgen camera, or a list that begins with one camera."""
    first = document[0] if isinstance(document, list) and document else document
    return isinstance(first, dict) and not first.keys().isdisjoint(("view", "fx", "fy"))


def read_gsgen_cameras(document: object, path: str) -> CameraFile:
    """Read the cameras of a JSON document: one gsgen camera, or a list of cameras."""
    entries = document if isinstance(document, list) else [document]
    if not entries:
        raise ConfigInvalid("has no cameras, expected at least one", where=path)
    cameras = tuple(_gsgen_camera(entry, index, path) for index, entry in enumerate(entries))
    return CameraFile(path=path, format="cameras of gsgen", cameras=cameras)


def _gsgen_camera(document: object, index: int, path: str) -> NamedCamera:
    name = str(index)
    if isinstance(document, dict):
        name = text(document, "name", name)
        document = {key: value for key, value in document.items() if key != "name"}
    try:
        return NamedCamera(name, Camera.from_dict(document))
    except SceneInvalid as error:
        where = f"{path}, camera {index}, {error.where}"
        raise SceneInvalid(error.message, where=where, hint=error.hint) from error


def is_training(document: object) -> bool:
    """Return whether a JSON document is a cameras.json of 3D Gaussian Splatting."""
    first = document[0] if isinstance(document, list) and document else None
    return isinstance(first, dict) and {"rotation", "position"} <= first.keys()


def read_training_cameras(document: list[Any], path: str) -> CameraFile:
    """Read the cameras of a cameras.json of 3D Gaussian Splatting."""
    objects = [
        Fields(require_object(entry, f"{path}, camera {index}"))
        for index, entry in enumerate(document)
    ]
    cameras = tuple(
        _trained_camera(fields, index, f"{path}, camera {index}")
        for index, fields in enumerate(objects)
    )
    notes = unused_fields(path, objects)
    return CameraFile(
        path=path, format="cameras.json of 3D Gaussian Splatting", cameras=cameras, notes=notes
    )


def _trained_camera(fields: Fields, index: int, where: str) -> NamedCamera:
    axes = matrix(fields, "rotation", (3, 3), where)
    view = view_from_opencv(axes, matrix(fields, "position", (3,), where))
    width, height = pixel_count(fields, "width", where), pixel_count(fields, "height", where)
    fx, fy = number(fields, "fx", where), number(fields, "fy", where)
    image_center = {"cx": width / 2, "cy": height / 2}
    camera = camera_at(where, view=view, fx=fx, fy=fy, width=width, height=height, **image_center)
    return NamedCamera(text(fields, "img_name", text(fields, "id", str(index))), camera)


def is_camera_path(document: object) -> bool:
    """Return whether a JSON document is a camera path of nerfstudio."""
    return isinstance(document, dict) and isinstance(document.get("camera_path"), list)


def read_camera_path(document: Mapping[str, Any], path: str) -> CameraFile:
    """Read the camera of each frame of a nerfstudio camera path, with its ``render_time``."""
    shared_fields = Fields(document)
    kind = text(shared_fields, "camera_type", _PERSPECTIVE_TYPE).lower()
    types = (_PERSPECTIVE_TYPE, _FISHEYE_TYPE, _PANORAMA_MODEL)
    if kind not in types:
        message = f"camera_type is {kind!r}, expected one of {', '.join(types)}"
        raise ConfigInvalid(message, where=path)
    frames = shared_fields["camera_path"]
    if not frames:
        raise ConfigInvalid("has no frames, expected at least one", where=path)
    width, height = (
        pixel_count(shared_fields, "render_width", path),
        pixel_count(shared_fields, "render_height", path),
    )
    objects = [
        Fields(require_object(frame, f"{path}, frame {index}"))
        for index, frame in enumerate(frames)
    ]
    cameras = tuple(
        _path_camera(fields, index, f"{path}, frame {index}", (width, height), kind)
        for index, fields in enumerate(objects)
    )
    fps = _path_rate(shared_fields, len(frames), path)
    notes = unused_fields(path, [shared_fields, *objects])
    return CameraFile(
        path=path, format="a camera path of nerfstudio", cameras=cameras, notes=notes, fps=fps
    )


def _path_rate(shared_fields: Fields, count: int, path: str) -> float | None:
    """Return the frames per second of a camera path: ``seconds`` divides its frames, or ``fps``."""
    fps = number(shared_fields, "fps", path) if shared_fields.get("fps") is not None else None
    seconds = (
        number(shared_fields, "seconds", path) if shared_fields.get("seconds") is not None else None
    )
    if seconds is not None and seconds > 0:
        return count / seconds
    return fps if fps is not None and fps > 0 else None


def _path_camera(
    fields: Fields, index: int, where: str, size: tuple[int, int], kind: str
) -> NamedCamera:
    width, height = size
    to_world = matrix(fields, "camera_to_world", (16,), where).reshape(4, 4)
    values: dict[str, Any] = {
        "view": view_from_opengl(to_world),
        "cx": width / 2,
        "cy": height / 2,
        "width": width,
        "height": height,
    }
    if kind == _PANORAMA_MODEL:
        values |= {"fx": width / (2 * math.pi), "fy": height / math.pi, "kind": "panorama"}
    else:
        degrees = number(fields, "fov", where)
        if not 0 < degrees < 180:
            raise ConfigInvalid(
                f"fov is {degrees}, expected degrees between 0 and 180", where=where
            )
        focal = height / 2 / math.tan(math.radians(degrees) / 2)
        values |= {"fx": focal, "fy": focal}
        values["kind"] = "fisheye" if kind == _FISHEYE_TYPE else "pinhole"
    has_time = fields.get("render_time") is not None
    time = number(fields, "render_time", where) if has_time else None
    return NamedCamera(str(index), camera_at(where, **values), time)
