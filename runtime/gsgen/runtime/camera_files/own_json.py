"""Our own JSON: the attributes of :class:`gsgen.runtime.Camera`, and a name if there is one."""

__all__ = ["is_own", "read_own"]

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera


def is_own(made: object) -> bool:
    """Say whether the content is one camera, or begins a list of them."""
    first = made[0] if isinstance(made, list) and made else made
    return isinstance(first, dict) and not first.keys().isdisjoint(("view", "fx", "fy"))


def read_own(made: object, path: str) -> CameraFile:
    """Read one camera, or a list of them.

    Raises:
        SceneInvalid: An object is no camera.
        ConfigInvalid: There are none.
    """
    several = made if isinstance(made, list) else [made]
    if not several:
        raise ConfigInvalid("holds no camera", where=path)
    cameras = tuple(_camera(one, number, path) for number, one in enumerate(several))
    return CameraFile(path, "cameras of gsgen", cameras)


def _camera(made: object, number: int, path: str) -> NamedCamera:
    name = str(number)
    if isinstance(made, dict):
        name = text(made, "name", name)
        made = {key: value for key, value in made.items() if key != "name"}
    try:
        return NamedCamera(name, Camera.from_dict(made))
    except SceneInvalid as error:
        where = f"{path}, camera {number}, {error.where}"
        raise SceneInvalid(error.message, where=where, hint=error.hint) from error
