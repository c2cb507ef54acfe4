"""Reads pictures and their cameras for the inputs of a generator's scene pass."""

__all__ = ["camera_list", "picture_files", "picture_tracks"]

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64, UInt8

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.camera_files import NamedCamera, open_cameras, split_pick
from gsgen.runtime.media.fitted_pictures import PictureFit, fit_picture
from gsgen.runtime.media.pictures import IMAGE_SUFFIXES, require_pillow
from gsgen.runtime.playback.input_tracks import Track, counted_pictures
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.natural_order import natural_key
from gsgen.runtime.sources.sequence_source import numbered_files
from gsgen.runtime.sources.source import Source

_OPTION: Final = "--image"
_CAMERA_OPTION: Final = "--image-cameras"
_MAX_PIXELS: Final = 1 << 26  # of a picture that is read
_FILES_HINT: Final = "Give FILE,FILE,…, a folder of pictures, or a pattern such as views/%04d.png."


@final
@dataclass(frozen=True, slots=True)
class _Picture:
    """A picture that is given to a model, and the camera that took it, if it is known."""

    file: Path
    pixels: UInt8[np.ndarray, "h w 4"]
    camera: Camera | None = None


def picture_tracks(
    images: Sequence[str], cameras: str | None, sources: Sequence[Source]
) -> list[Track]:
    """Return the values of all inputs of pictures and of their cameras, the same in each frame.

    Args:
        images: Values of ``--image``; see :func:`picture_files`.
        cameras: Value of ``--image-cameras``: a file of cameras, with ``#`` and a selection.
        sources: The scenes, of which the models with pictures take them.

    Raises:
        ConfigInvalid: The number of pictures or cameras differs from the model's, or no model
            takes them.
        InputUnreadable: A file is not a picture.
    """
    if not images:
        if cameras is not None:
            raise _without_pictures()
        return []
    pictures = [_read_picture(file) for file in picture_files(images)]
    if cameras is not None:
        pictures = _with_cameras(pictures, cameras)
    tracks = [track for source in sources for track in _tracks_of(source, pictures)]
    if not tracks:
        raise ConfigInvalid(
            "names pictures, but no scene is computed from pictures",
            where=_OPTION,
            hint="`gsgen inspect` lists the inputs of a model.",
        )
    if cameras is not None and all(track.where == _OPTION for track in tracks):
        raise ConfigInvalid(
            "names cameras, but the model assumes cameras of its own",
            where=_CAMERA_OPTION,
            hint="Leave the option out.",
        )
    return tracks


def _without_pictures() -> ConfigInvalid:
    hint = f"Give the pictures with {_OPTION}."
    return ConfigInvalid("has cameras without pictures", where=_CAMERA_OPTION, hint=hint)


def camera_list(text: str, files: Sequence[Path]) -> str:
    """Return the cameras of pictures as a JSON list of gsgen, in their order, for pages.

    Args:
        text: The value of ``--image-cameras``.
        files: The pictures.

    Raises:
        ConfigInvalid: There are no pictures, or another number than cameras.
    """
    if not files:
        raise _without_pictures()
    pictures = _with_cameras([_read_picture(file) for file in files], text)
    cameras = [json.loads(picture.camera.to_json()) for picture in pictures if picture.camera]
    return json.dumps(cameras)


def picture_files(texts: Iterable[str]) -> list[Path]:
    """Return the files of the option ``--image``, in order.

    A text is a file, files joined by commas, a folder of pictures in the order of their names, or
    a pattern of numbers.

    Raises:
        ConfigInvalid: A file or folder does not exist or holds no picture.
    """
    files: list[Path] = []
    for text in texts:
        parts = [text] if Path(text).exists() else [part for part in text.split(",") if part]
        for part in parts:
            files += _files_of(Path(part))
    if not files:
        raise ConfigInvalid("names no picture", where=_OPTION, hint=_FILES_HINT)
    return files


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    files: Iterable[Path] | None = numbered_files(path)
    if path.is_dir():
        files = (file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    if files is None:
        raise ConfigInvalid("does not exist", where=f"{_OPTION} {path}", hint=_FILES_HINT)
    pictures = sorted(files, key=lambda file: natural_key(file.name))
    if not pictures:
        raise ConfigInvalid("holds no picture", where=f"{_OPTION} {path}", hint=_FILES_HINT)
    return pictures


def _read_picture(path: Path) -> _Picture:
    """Read a picture of 8 bits a channel as RGB and alpha, turned upright as its file says."""
    require_pillow()
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            if image.width * image.height > _MAX_PIXELS:
                size = f"{image.width}×{image.height} pixels"
                message = f"has {size}, expected at most {_MAX_PIXELS:,} in all"
                raise InputUnreadable(message, where=str(path))
            if image.mode.startswith(("I", "F")):
                message = f"has samples of the kind {image.mode}, expected 8 bits a channel"
                raise InputUnreadable(message, where=str(path), hint="Save it with 8 bits.")
            pixels = np.asarray(ImageOps.exif_transpose(image).convert("RGBA"))
    except (Image.DecompressionBombError, UnidentifiedImageError, OSError) as error:
        raise InputUnreadable(f"is not a picture: {error}", where=str(path)) from error
    return _Picture(path, pixels)


def _with_cameras(pictures: Sequence[_Picture], text: str) -> list[_Picture]:
    """Give each picture its camera: by the names of the files, or else in the order of the file."""
    path, selection = split_pick(text)
    height, width = pictures[0].pixels.shape[:2]
    cameras = open_cameras(path, (width, height)).pick(selection)
    camera_by_stem = {Path(entry.name).stem: entry for entry in cameras}
    entries: Sequence[NamedCamera] = cameras
    if all(picture.file.stem in camera_by_stem for picture in pictures):
        entries = [camera_by_stem[picture.file.stem] for picture in pictures]
    if len(entries) != len(pictures):
        raise ConfigInvalid(
            f"has {len(entries)} cameras for {counted_pictures(len(pictures))}, "
            "and their names are not those of the pictures",
            where=f"{_CAMERA_OPTION} {text}",
            hint="Select the cameras: FILE#NAME for one, FILE#0:4 for the first four.",
        )
    return [
        _Picture(picture.file, picture.pixels, _scaled_camera(picture, entry))
        for picture, entry in zip(pictures, entries, strict=True)
    ]


def _scaled_camera(picture: _Picture, entry: NamedCamera) -> Camera:
    """Return the camera of a picture in the picture's own pixels."""
    height, width = picture.pixels.shape[:2]
    camera = entry.camera
    if camera.kind != "pinhole":
        message = f"the camera {entry.name!r} is {camera.kind}, expected one with perspective"
        raise ConfigInvalid(message, where=_CAMERA_OPTION)
    if not camera.has_shape(width, height):
        raise ConfigInvalid(
            f"the camera {entry.name!r} takes pictures of {camera.width}×{camera.height} pixels, "
            f"but {picture.file.name} has {width}×{height}",
            where=_CAMERA_OPTION,
        )
    return camera.scaled(width, height)


def _tracks_of(source: Source, pictures: Sequence[_Picture]) -> Iterator[Track]:
    """Yield the values of a source's inputs of pictures, and of their cameras if these are known."""
    for spec in source.named("image"):
        shape = source.shape(spec.name)
        size = shape[2], shape[3]
        if len(pictures) != shape[0]:
            raise ConfigInvalid(
                f"has {counted_pictures(len(pictures))}, expected {shape[0]} for the input {spec.name!r}",
                where=_OPTION,
                hint=_FILES_HINT,
            )
        yield _picture_track(spec, size, pictures)
        cameras = [picture.camera for picture in pictures if picture.camera is not None]
        if not cameras:
            continue
        for view_spec in source.named("image_view"):
            views = np.stack([camera.view for camera in cameras])
            yield Track(view_spec.name, views, _CAMERA_OPTION)
        for lens_spec in source.named("image_intrinsics"):
            matrices = np.stack([_fitted_intrinsics(camera, size) for camera in cameras])
            yield Track(lens_spec.name, matrices, _CAMERA_OPTION)


def _picture_track(spec: Input, size: tuple[int, int], pictures: Sequence[_Picture]) -> Track:
    low, high = spec.range or (0.0, 1.0)
    background = spec.background or (0.0, 0.0, 0.0)
    fitted = np.stack([fit_picture(picture.pixels, size, background) for picture in pictures])
    values = np.clip(low + (high - low) * fitted, low, high).astype(np.float32)
    return Track(spec.name, values, _OPTION)


def _fitted_intrinsics(camera: Camera, size: tuple[int, int]) -> Float64[np.ndarray, "3 3"]:
    fit = PictureFit.of_sizes((camera.height, camera.width), size)
    return fit.intrinsics(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)
