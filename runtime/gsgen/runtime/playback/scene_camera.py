"""What scene files say about the picture, unless a command's options say something else."""

__all__ = ["scene_view", "told"]

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from gsgen.contract.errors import GsgenError
from gsgen.runtime.playback.camera_options import Viewpoint, viewpoint
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.scene_file import SceneFile

_FOV: Final = 50.0


def told(files: Sequence[SceneFile], name: str) -> Any:
    """Return what the first file that says something about ``name`` says, or None."""
    values = (getattr(scene_file, name) for scene_file in files)
    return next((value for value in values if value is not None), None)


def scene_view(
    files: Sequence[SceneFile],
    camera: str | None = None,
    width: int | None = None,
    height: int | None = None,
    fov: float | None = None,
    up: str | None = None,
    flat: bool = False,
    around: bool = False,
) -> Viewpoint:
    """Return from where scenes are seen: as options say, or else as their files say.

    Args:
        files: The scene files among the scenes.
        camera: See :func:`gsgen.runtime.playback.camera_options.viewpoint`.
        width: See there.
        height: See there.
        fov: See there; 50 degrees if nobody says anything.
        up: See there.
        flat: See there.
        around: See there.

    Raises:
        ConfigInvalid: It is no camera.
        SceneInvalid: The file of cameras holds something that is none.
    """
    kind = None if flat or around or camera is not None else told(files, "kind")
    shot = told(files, "camera") if camera is None else camera
    text = None if isinstance(shot, Camera) else shot
    try:
        view = viewpoint(
            text,
            width or told(files, "width"),
            height or told(files, "height"),
            next(
                degrees
                for degrees in (fov, told(files, "fov"), _FOV)
                if degrees is not None
            ),
            up or told(files, "up"),
            flat or kind == "orthographic",
            around or kind == "panorama",
        )
    except GsgenError as error:
        if camera is not None or text is None or error.where != "--camera":
            raise
        where = f"{next(scene_file.path for scene_file in files if scene_file.camera is not None)}: camera"
        raise type(error)(error.message, where=where, hint=error.hint) from error
    return replace(view, orbit=None, cameras=(shot,)) if isinstance(shot, Camera) else view
