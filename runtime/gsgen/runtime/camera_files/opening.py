"""Open a file of cameras, whatever its format."""

__all__ = ["open_cameras", "split_pick"]

import json
import os
from pathlib import Path
from typing import Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files.colmap import FOLDERS, model_folder, read_colmap
from gsgen.runtime.camera_files.file import CameraFile
from gsgen.runtime.camera_files.own_json import is_own, read_own
from gsgen.runtime.camera_files.path_json import is_path, read_path
from gsgen.runtime.camera_files.training_json import is_training, read_training
from gsgen.runtime.camera_files.transforms_json import is_transforms, read_transforms

_LARGEST: Final = 256 << 20  # bytes of JSON: a hundred thousand cameras have a tenth of it
_KNOWN: Final = (
    "Known: cameras of gsgen, transforms.json (nerfstudio, Instant-NGP), camera paths of "
    "nerfstudio, cameras.json of 3D Gaussian Splatting, and folders of COLMAP with cameras and "
    "images as .bin or .txt."
)
_IN_FOLDER: Final = ("transforms.json", "cameras.json", "transforms_train.json")


def open_cameras(path: str | os.PathLike[str]) -> CameraFile:
    """Read the cameras at ``path``, whose format its content tells and not its name.

    Args:
        path: A file, or the folder of a data set or a model of COLMAP.

    Raises:
        ConfigInvalid: It cannot be read, or is of no format that is known.
        SceneInvalid: Its numbers make no camera.
    """
    place = Path(path)
    if place.is_dir():
        return _in_folder(place)
    try:
        if not place.is_file():
            missing = "is no file" if place.exists() else "does not exist"
            raise ConfigInvalid(missing, where=str(place), hint=_KNOWN)
        if place.stat().st_size > _LARGEST and place.suffix == ".json":
            raise ConfigInvalid(
                f"has {place.stat().st_size:,} bytes, more than {_LARGEST:,}",
                where=str(place),
            )
        with open(place, "rb") as file:
            start = file.read(64)
            content = start + file.read(_LARGEST) if _may_be_json(start) else b""
    except (OSError, ValueError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(place)) from error
    if content:
        return _from_json(content, place)
    model = model_folder(place.parent)
    if model is not None and place.stem in ("cameras", "images", "points3D"):
        return read_colmap(model)
    raise ConfigInvalid(
        f"begins with {start[:16]!r}, which no file of cameras does",
        where=str(place),
        hint=_KNOWN,
    )


def split_pick(text: str) -> tuple[Path, str | None]:
    """Part ``FILE#WHICH``, unless there is a file of the whole name."""
    whole = Path(text)
    name, mark, which = text.rpartition("#")
    try:
        if not mark or whole.exists():
            return whole, None
    except OSError:  # a name that is too long, say
        return whole, None
    return Path(name), which


def _may_be_json(start: bytes) -> bool:
    return start.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"[")


def _in_folder(folder: Path) -> CameraFile:
    model = model_folder(folder)
    if model is not None:
        return read_colmap(model)
    for name in _IN_FOLDER:
        if (folder / name).is_file():
            return open_cameras(folder / name)
    raise ConfigInvalid(
        "is a folder without cameras",
        where=str(folder),
        hint=f"Wanted {', '.join(_IN_FOLDER)}, or cameras and images of COLMAP as .bin or .txt, "
        f"there or in {', '.join(FOLDERS[1:])}.",
    )


def _from_json(content: bytes, place: Path) -> CameraFile:
    try:
        made = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ConfigInvalid(f"is no JSON: {error}", where=str(place)) from error
    if is_transforms(made):
        return read_transforms(made, str(place))
    if is_path(made):
        return read_path(made, str(place))
    if is_training(made):
        return read_training(made, str(place))
    if is_own(made):
        return read_own(made, str(place))
    if made in ([], {}):
        raise ConfigInvalid("holds no camera", where=str(place), hint=_KNOWN)
    first = made[0] if isinstance(made, list) else made
    keys = (
        ", ".join(map(str, list(first)[:8]))
        if isinstance(first, dict)
        else repr(first)[:60]
    )
    raise ConfigInvalid(
        f"is JSON, but of no cameras: it has {keys}", where=str(place), hint=_KNOWN
    )
