"""Writes pictures of more than 8 bits: OpenEXR files of floats, and PNG files of 16 bits."""

__all__ = [
    "EXR_SUFFIX",
    "exr_channels",
    "exr_package",
    "picture16_of",
    "png_package",
    "save_exr",
    "save_png16",
]

from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Final

import numpy as np
from jaxtyping import Float32, UInt16

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.srgb import linear_of_srgb
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media.pictures import Mode, array_of, levels_of
from gsgen.runtime.scene.frame import Frame

EXR_SUFFIX: Final = ".exr"
"""The suffix of OpenEXR files."""

_MAX_UINT16 = 65535


def exr_channels(frame: Frame, mode: Mode) -> dict[str, Float32[np.ndarray, "h w *c"]]:
    """Return the channels of a frame as OpenEXR expects them, by name.

    Colours are linear light multiplied by alpha. Depths are distances, infinite where nothing is
    drawn, in the channel Z; normals are N.X, N.Y and N.Z in world space.
    """
    if mode == "color":
        linear_colors = linear_of_srgb(frame.srgb[..., :3])
        alpha = np.clip(frame.alpha if frame.rgba is None else frame.rgba[..., 3], 0, 1)
        rgba = np.concatenate([linear_colors * alpha[..., None], alpha[..., None]], axis=-1)
        return {"RGBA": np.ascontiguousarray(rgba, np.float32)}
    array = np.asarray(array_of(frame, mode), np.float32)
    if mode == "normal":
        return {f"N.{axis}": np.ascontiguousarray(array[..., k]) for k, axis in enumerate("XYZ")}
    return {"A" if mode == "alpha" else "Z": np.ascontiguousarray(array)}


def save_exr(path: Path, frame: Frame, mode: Mode) -> None:
    """Write a frame as an OpenEXR file of 32-bit floats, atomically.

    Raises:
        ConfigInvalid: The file cannot be written.
        SceneInvalid: The package OpenEXR is not installed.
    """
    exr = exr_package()
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    with atomic_write(path) as temporary_path, exr.File(header, exr_channels(frame, mode)) as file:
        try:
            file.write(str(temporary_path))
        except RuntimeError as error:  # a full disk, among others; the cause is its last sentence
            cause = str(error).rstrip(".").rpartition(". ")[2]
            raise ConfigInvalid(f"cannot be written: {cause}", where=str(path)) from error


def picture16_of(
    frame: Frame, mode: Mode, depths: tuple[float, float] | None = None
) -> UInt16[np.ndarray, "h w *c"]:
    """Return a frame's output for a display mode, as an image of 16-bit integers."""
    return np.asarray(np.rint(levels_of(frame, mode, depths) * _MAX_UINT16), np.uint16)


def save_png16(path: Path, picture: UInt16[np.ndarray, "h w *c"]) -> None:
    """Write a picture as a PNG file of 16 bits, atomically.

    Raises:
        SceneInvalid: The package pypng is not installed.
    """
    png = png_package()
    height, width, *channels = picture.shape
    kind = {(): "L;16", (3,): "RGB;16", (4,): "RGBA;16"}[tuple(channels)]
    rows = picture.reshape(height, -1)
    with atomic_write(path) as temporary_path:
        png.from_array(rows, kind, {"width": width, "height": height}).save(str(temporary_path))


def exr_package() -> ModuleType:
    """Return the package OpenEXR; raise if it is not installed."""
    return _require_package("OpenEXR", "EXR files need OpenEXR")


def png_package() -> ModuleType:
    """Return the package pypng; raise if it is not installed."""
    return _require_package("png", "PNG files of 16 bits need pypng")


def _require_package(name: str, purpose: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise SceneInvalid(
            f"{purpose}, which is not installed", hint="pip install 'gsgen[deep]'"
        ) from error
