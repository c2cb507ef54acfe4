"""Reads gsgen's own camera files: JSON with the attributes of ``Camera`` and a name."""

__all__ = ["is_own", "read_own"]

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.fields import text
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera


def is_own(document: object) -> bool:
    """Return whether a JSON document is one gsgen camera, or a list that begins with one camera."""
    first = document[0] if isinstance(document, list) and document else document
    return isinstance(first, dict) and not first.keys().isdisjoint(("view", "fx", "fy"))


def read_own(document: object, path: str) -> CameraFile:
    """Read the cameras of a JSON document: one gsgen camera, or a list of cameras."""
    entries = document if isinstance(document, list) else [document]
    if not entries:
        raise ConfigInvalid("has no cameras, expected at least one", where=path)
    cameras = tuple(_camera(entry, number, path) for number, entry in enumerate(entries))
    return CameraFile(path, "cameras of gsgen", cameras)


def _camera(document: object, number: int, path: str) -> NamedCamera:
    name = str(number)
    if isinstance(document, dict):
        name = text(document, "name", name)
        document = {key: value for key, value in document.items() if key != "name"}
    try:
        return NamedCamera(name, Camera.from_dict(document))
    except SceneInvalid as error:
        where = f"{path}, camera {number}, {error.where}"
        raise SceneInvalid(error.message, where=where, hint=error.hint) from error
