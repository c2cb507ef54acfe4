"""Pictures: what a frame becomes on disk."""

__all__ = [
    "FILMS",
    "MODES",
    "OPAQUE",
    "SUFFIXES",
    "Mode",
    "array_of",
    "depth_range",
    "picture_of",
    "png_of",
    "save_array",
    "save_film",
    "save_picture",
]

import io
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Final, Literal

import numpy as np
from jaxtyping import Float32, UInt8

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media import mp4
from gsgen.runtime.media.gif import save_gif
from gsgen.runtime.media.gpano import gpano
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, Output
from gsgen.sdk.rewriting.atomic_model_files import atomic_write

Mode = Literal["color", "depth", "median-depth", "normal", "alpha"]

MODES: Final[dict[Mode, Output]] = {
    "color": "color",
    "depth": "depth",
    "median-depth": "depth",
    "normal": "normal",
    "alpha": "color",
}
"""What each mode has to ask the renderer for."""

SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""The suffixes that one picture can have."""

FILMS: Final = (".gif", ".mp4")
"""The suffixes that one film can have."""

OPAQUE: Final = (".jpg", ".jpeg", ".mp4", ".bmp")
"""The suffixes of formats without transparency."""

_SHARE: Final = 2.0  # percent of the depths, at each end, that the grey scale leaves out


def array_of(frame: Frame, mode: Mode) -> Float32[np.ndarray, "h w *c"]:
    """Return what ``mode`` shows, as it is: no clipping, no rounding, no colour curve."""
    arrays = {
        "color": frame.rgba,
        "depth": frame.depth,
        "median-depth": frame.median_depth,
        "normal": frame.normal,
        "alpha": frame.alpha,
    }
    array = arrays[mode]
    if array is None:
        raise ValueError(f"the frame was drawn without {MODES[mode]}")
    return array


def picture_of(
    frame: Frame, mode: Mode, depths: tuple[float, float] | None = None
) -> UInt8[np.ndarray, "h w *c"]:
    """Return what ``mode`` shows as bytes.

    Colours are sRGB with alpha. Depths are grey, near is bright and nothing is black. Normals
    are (n + 1) / 2 in world space. Alpha is grey.

    Args:
        frame: What to show.
        mode: How.
        depths: The depths that are white and nearly black; of most of the pixels where absent.
    """
    if mode == "color":
        return frame.srgb8
    array = array_of(frame, mode)
    if mode == "normal":
        return _bytes((array + 1) / 2 * array.any(axis=-1, keepdims=True))
    if mode == "alpha":
        return _bytes(array)
    near, far = depths or depth_range(array)
    share = (np.where(np.isfinite(array), array, far) - near) / max(far - near, 1e-12)
    return _bytes(np.where(np.isfinite(array), 1 - 0.9 * np.clip(share, 0, 1), 0))


def depth_range(depth: Float32[np.ndarray, "h w"]) -> tuple[float, float]:
    """Return the depths between which most of the pixels lie."""
    finite = depth[np.isfinite(depth)]
    if not finite.size:
        return 0.0, 1.0
    near, far = np.percentile(finite, [_SHARE, 100 - _SHARE])
    return float(near), float(far)


def _bytes(array: np.ndarray) -> UInt8[np.ndarray, "..."]:
    return np.asarray(np.rint(np.clip(array, 0, 1) * 255), np.uint8)


def save_picture(
    path: Path, picture: UInt8[np.ndarray, "h w *c"], camera: Camera | None = None
) -> None:
    """Write an image file, of the format that the suffix names; whole or not at all.

    Args:
        path: Where to.
        picture: What.
        camera: Of a panorama, which a JPEG then says it is.

    Raises:
        SceneInvalid: The image library is missing or cannot write such a file.
    """
    image = _image()
    metadata = _said_of(camera, picture) if path.suffix.lower() in (".jpg", ".jpeg") else {}
    with atomic_write(path) as draft:
        try:
            image.fromarray(_fitting(path, picture)).save(draft, **metadata)
        except ValueError as error:
            raise SceneInvalid(f"cannot be written: {error}", where=str(path)) from error


def png_of(picture: UInt8[np.ndarray, "h w *c"]) -> bytes:
    """Return a picture as a PNG file.

    Raises:
        SceneInvalid: The image library is missing.
    """
    file = io.BytesIO()
    _image().fromarray(picture).save(file, "png")
    return file.getvalue()


def _said_of(
    camera: Camera | None, picture: UInt8[np.ndarray, "h w *c"]
) -> dict[str, bytes]:
    """Return the metadata of a picture, unless a model made it another size."""
    if camera is None or picture.shape[:2] != (camera.height, camera.width):
        return {}
    packet = gpano(camera)
    return {} if packet is None else {"xmp": packet}


def save_array(path: Path, array: Float32[np.ndarray, "h w *c"]) -> None:
    """Write a NumPy file, whole or not at all."""
    with atomic_write(path) as draft:
        np.save(draft, array)


def save_film(path: Path, pictures: Iterable[UInt8[np.ndarray, "..."]], fps: float) -> None:
    """Write an MP4, or an animated GIF that repeats for ever; whole or not at all.

    An MP4 stands on black; what is transparent in a GIF, :func:`save_gif` says.

    Raises:
        SceneInvalid: The image library is missing or cannot write such a file.
    """
    image = _image()
    if path.suffix.lower() == ".mp4":
        colors = (
            image.fromarray(_fitting(path, picture)).convert("RGB") for picture in pictures
        )
        film = mp4.encode(colors, fps)
        with atomic_write(path) as draft:
            draft.write_bytes(film)
        return
    frames = list(pictures)
    with atomic_write(path) as draft:
        save_gif(draft, frames, fps)


def _fitting(path: Path, picture: UInt8[np.ndarray, "h w *c"]) -> np.ndarray:
    """Return the picture without alpha where the format has none: on black."""
    if picture.ndim == 3 and picture.shape[2] == 4 and path.suffix.lower() in OPAQUE:
        alpha = picture[..., 3:] / 255
        return np.asarray(np.rint(picture[..., :3] * alpha), np.uint8)
    return picture


def _image() -> ModuleType:
    try:
        from PIL import Image
    except ImportError as error:
        raise SceneInvalid(
            "image files need pillow, which is not installed",
            hint="pip install 'gsgen[runtime]'",
        ) from error
    return Image
