"""Opens camera files of any supported format."""

__all__ = ["open_cameras", "split_pick"]

import json
import os
from pathlib import Path
from typing import Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.file_kinds.recognition import kind_of_file
from gsgen.runtime.camera_files.camera_lists import (
    is_camera_path,
    is_gsgen_camera,
    is_training,
    read_camera_path,
    read_gsgen_cameras,
    read_training_cameras,
)
from gsgen.runtime.camera_files.colmap import COLMAP_FOLDERS, model_folder, read_colmap
from gsgen.runtime.camera_files.file import CameraFile
from gsgen.runtime.camera_files.other_programs import unreadable_camera_file
from gsgen.runtime.camera_files.photogrammetry_json import (
    is_openmvg,
    is_opensfm,
    read_openmvg,
    read_opensfm,
)
from gsgen.runtime.camera_files.photogrammetry_text import (
    is_bundler,
    is_metashape,
    read_bundler,
    read_metashape,
)
from gsgen.runtime.camera_files.transforms_json import is_transforms, read_transforms

_MAX_JSON_BYTES: Final = 256 << 20  # bytes of JSON: a hundred thousand cameras take a tenth of them
_KNOWN_FORMATS: Final = (
    "Supported: cameras of gsgen, transforms.json (nerfstudio, Instant-NGP), camera paths of "
    "nerfstudio, cameras.json of 3D Gaussian Splatting, reconstruction.json of OpenSfM, "
    "sfm_data.json of openMVG, bundle.out of Bundler, XML of Metashape, and folders of COLMAP with "
    "cameras and images as .bin or .txt."
)
_RECOGNITION_BYTES: Final = 4096
_FOLDER_FILES: Final = (
    "transforms.json",
    "cameras.json",
    "transforms_train.json",
    "transforms_test.json",
    "reconstruction.json",
    "sfm_data.json",
    "bundle.out",
)


def open_cameras(path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> CameraFile:
    """Read the cameras of a file or a data set; the format is recognised by the content.

    Args:
        path: A file or its address, or the folder of a data set or of a COLMAP model.
        size: Width and height, in pixels, of cameras for which neither the file nor a picture
            beside it has a size.

    Raises:
        ConfigInvalid: The file cannot be read, or its format is not supported.
        SceneInvalid: A camera's numbers are invalid.
        InputUnreadable: The file at an address cannot be had.
    """
    location = Path(path)
    if not location.exists():
        from gsgen.contract.model.fetched_inputs import local_file

        location = local_file(path)
    if location.is_dir():
        return _open_folder(location, size)
    try:
        if not location.is_file():
            problem = "is not a file" if location.exists() else "does not exist"
            raise ConfigInvalid(problem, where=str(location), hint=_KNOWN_FORMATS)
        with open(location, "rb") as file:
            start = file.read(_RECOGNITION_BYTES)
            is_text = _may_be_json(start) or is_bundler(start) or start.lstrip()[:1] == b"<"
            file_size = location.stat().st_size
            if is_text and file_size > _MAX_JSON_BYTES:
                raise ConfigInvalid(
                    f"has {file_size:,} bytes, expected at most {_MAX_JSON_BYTES:,}",
                    where=str(location),
                )
            content = start + file.read() if is_text else start
    except (OSError, ValueError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(location)) from error
    if _may_be_json(start):
        return _cameras_from_json(content, location, size)
    if is_bundler(content):
        return read_bundler(content, location, size)
    if is_metashape(content):
        return read_metashape(content, str(location))
    model = model_folder(location.parent)
    if model is not None and location.stem in ("cameras", "images", "points3D"):
        return read_colmap(model)
    raise unreadable_camera_file(content, location, _KNOWN_FORMATS)


def split_pick(text: str) -> tuple[Path, str | None]:
    """Split ``FILE#CAMERA`` into path and camera, unless a file with the whole name exists."""
    whole_path = Path(text)
    name, separator, selection = text.rpartition("#")
    try:
        if not separator or whole_path.exists():
            return whole_path, None
    except OSError:  # for example a name that is too long
        return whole_path, None
    return Path(name), selection


def _may_be_json(start: bytes) -> bool:
    return start.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"[")


def _open_folder(folder: Path, size: tuple[int, int] | None) -> CameraFile:
    model = model_folder(folder)
    if model is not None:
        return read_colmap(model)
    for name in _FOLDER_FILES:
        if (folder / name).is_file():
            return open_cameras(folder / name, size)
    raise ConfigInvalid(
        "is a folder without cameras",
        where=str(folder),
        hint=f"Expected {', '.join(_FOLDER_FILES)}, or cameras and images of COLMAP as .bin or .txt, "
        f"there or in {', '.join(COLMAP_FOLDERS[1:])}.",
    )


def _cameras_from_json(content: bytes, location: Path, size: tuple[int, int] | None) -> CameraFile:
    try:
        document = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ConfigInvalid(f"is not valid JSON: {error}", where=str(location)) from error
    if is_transforms(document):
        return read_transforms(document, str(location), size)
    if is_camera_path(document):
        return read_camera_path(document, str(location))
    if is_training(document):
        return read_training_cameras(document, str(location))
    if is_opensfm(document):
        return read_opensfm(document, str(location))
    if is_openmvg(document):
        return read_openmvg(document, str(location))
    if is_gsgen_camera(document):
        return read_gsgen_cameras(document, str(location))
    if document in ([], {}):
        raise ConfigInvalid(
            "has no cameras, expected at least one", where=str(location), hint=_KNOWN_FORMATS
        )
    first = document[0] if isinstance(document, list) else document
    kind = kind_of_file(location)
    if kind is not None and kind.name != "json":
        message = f"is {kind.title}, expected a camera file"
        raise ConfigInvalid(message, where=str(location), hint=f"{kind.hint} {_KNOWN_FORMATS}")
    keys = ", ".join(map(str, list(first)[:8])) if isinstance(first, dict) else repr(first)[:60]
    raise ConfigInvalid(
        f"is JSON without cameras, but with {keys}", where=str(location), hint=_KNOWN_FORMATS
    )
