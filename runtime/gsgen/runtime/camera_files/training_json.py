"""Reads cameras.json, which the training of 3D Gaussian Splatting writes.

Kerbl et al. 2023, ``camera_to_JSON``: ``rotation`` is camera → world, its columns are the camera's
axes (+x right, +y down, +z forward), ``position`` is the camera centre. The principal point is the
middle of the image, as in the training.
"""

__all__ = ["is_training", "read_training"]

from typing import Any

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import camera_at, matrix, number, side, text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opencv


def is_training(document: object) -> bool:
    """Return whether a JSON document is a cameras.json of 3D Gaussian Splatting."""
    first = document[0] if isinstance(document, list) and document else None
    return isinstance(first, dict) and {"rotation", "position"} <= first.keys()


def read_training(document: list[Any], path: str) -> CameraFile:
    """Read the cameras of a cameras.json of 3D Gaussian Splatting."""
    cameras = tuple(_camera(entry, number, path) for number, entry in enumerate(document))
    return CameraFile(path, "cameras.json of 3D Gaussian Splatting", cameras)


def _camera(document: object, index: int, path: str) -> NamedCamera:
    where = f"{path}, camera {index}"
    if not isinstance(document, dict):
        raise ConfigInvalid(
            f"the JSON value is a {type(document).__name__}, expected an object", where=where
        )
    axes = matrix(document, "rotation", (3, 3), where)
    view = view_from_opencv(axes, matrix(document, "position", (3,), where))
    width, height = side(document, "width", where), side(document, "height", where)
    fx, fy = number(document, "fx", where), number(document, "fy", where)
    middle = {"cx": width / 2, "cy": height / 2}
    camera = camera_at(where, view=view, fx=fx, fy=fy, width=width, height=height, **middle)
    return NamedCamera(text(document, "img_name", str(index)), camera)
