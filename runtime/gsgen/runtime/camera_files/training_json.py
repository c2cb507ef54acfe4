"""cameras.json as 3D Gaussian Splatting's training writes it beside its point clouds.

Kerbl et al. 2023, ``camera_to_JSON``: ``rotation`` is camera → world, its columns are the camera's
axes (+x right, +y down, +z forward), ``position`` is the camera centre. The principal point is the
middle of the image, which is where training had it.
"""

__all__ = ["is_training", "read_training"]

from typing import Any

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import made_camera, matrix, number, side, text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.poses import view_from_opencv


def is_training(made: object) -> bool:
    """Say whether the content begins such a list."""
    first = made[0] if isinstance(made, list) and made else None
    return isinstance(first, dict) and {"rotation", "position"} <= first.keys()


def read_training(made: list[Any], path: str) -> CameraFile:
    """Read the list.

    Raises:
        ConfigInvalid: Something is missing or of another shape.
        SceneInvalid: The numbers make no camera.
    """
    cameras = tuple(_camera(one, number, path) for number, one in enumerate(made))
    return CameraFile(path, "cameras.json of 3D Gaussian Splatting", cameras)


def _camera(made: object, at: int, path: str) -> NamedCamera:
    where = f"{path}, camera {at}"
    if not isinstance(made, dict):
        raise ConfigInvalid(f"is a {type(made).__name__}, wanted an object", where=where)
    axes = matrix(made, "rotation", (3, 3), where)
    view = view_from_opencv(axes, matrix(made, "position", (3,), where))
    width, height = side(made, "width", where), side(made, "height", where)
    fx, fy = number(made, "fx", where), number(made, "fy", where)
    middle = {"cx": width / 2, "cy": height / 2}
    camera = made_camera(
        where, view=view, fx=fx, fy=fy, width=width, height=height, **middle
    )
    return NamedCamera(text(made, "img_name", str(at)), camera)
