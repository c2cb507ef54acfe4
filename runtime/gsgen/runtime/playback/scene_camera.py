"""Completes a command's camera options with settings from the scene files that it draws."""

__all__ = ["first_setting", "scene_viewpoint"]

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from gsgen.contract.errors import GsgenError
from gsgen.runtime.playback.camera_options import DEFAULT_FOV, Viewpoint, viewpoint
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.key_frames import KeyFrames
from gsgen.runtime.sources.scene_file import SceneFile

Setting = TypeVar("Setting")


def first_setting(values: Sequence[Setting | None]) -> Setting | None:
    """Return the first value that is not None, such as an option before a file's field."""
    return next((value for value in values if value is not None), None)


def scene_viewpoint(
    files: Sequence[SceneFile],
    camera: str | None = None,
    width: int | None = None,
    height: int | None = None,
    fov: float | None = None,
    up: str | None = None,
    *,
    orthographic: bool = False,
    panorama: bool = False,
) -> Viewpoint:
    """Return the viewpoint that the camera options, or else the scene files, describe.

    Options are those of :func:`gsgen.runtime.playback.camera_options.viewpoint`.
    """
    has_camera_option = orthographic or panorama or camera is not None
    kind = None if has_camera_option else first_setting([file.kind for file in files])
    cameras: list[str | Camera | KeyFrames | None] = [camera, *(file.camera for file in files)]
    scene_camera = next((entry for entry in cameras if entry is not None), None)
    text = scene_camera if isinstance(scene_camera, str) else None
    degrees = first_setting([fov, *(file.fov for file in files)])
    try:
        view = viewpoint(
            text,
            first_setting([width, *(file.width for file in files)]),
            first_setting([height, *(file.height for file in files)]),
            DEFAULT_FOV if degrees is None else degrees,
            first_setting([up, *(file.up for file in files)]),
            orthographic=orthographic or kind == "orthographic",
            panorama=panorama or kind == "panorama",
        )
    except GsgenError as error:
        if camera is not None or text is None or error.where != "--camera":
            raise
        path = next(file.path for file in files if file.camera is not None)
        raise error.located(f"{path}: camera") from error
    if isinstance(scene_camera, Camera):
        view = replace(view, orbit=None, cameras=(scene_camera,))
    keys = scene_camera if isinstance(scene_camera, KeyFrames) else None
    return replace(view, keys=keys, span=first_setting([file.span for file in files]))
