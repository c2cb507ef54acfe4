"""Converts drawn frames to arrays and bytes, and writes image files and videos."""

__all__ = [
    "IMAGE_SUFFIXES",
    "OPAQUE_SUFFIXES",
    "PICTURE_MODES",
    "VIDEO_SUFFIXES",
    "Mode",
    "array_of",
    "depth_range",
    "gpano",
    "levels_of",
    "picture_of",
    "png_of",
    "require_pillow",
    "save_array",
    "save_gif",
    "save_picture",
    "save_video",
]

import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from jaxtyping import Float, Float32, UInt8

from gsgen.contract.process.atomic_files import atomic_write
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media import mp4
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, Output

if TYPE_CHECKING:
    from PIL.Image import Image

Mode = Literal["color", "depth", "median-depth", "normal", "alpha"]

PICTURE_MODES: Final[dict[Mode, Output]] = {
    "color": "color",
    "depth": "depth",
    "median-depth": "depth",
    "normal": "normal",
    "alpha": "color",
}
"""The renderer's output that each display mode needs."""

IMAGE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Suffixes of image files."""

VIDEO_SUFFIXES: Final = (".gif", ".mp4")
"""Suffixes of videos and animations."""

OPAQUE_SUFFIXES: Final = (".jpg", ".jpeg", ".mp4", ".bmp")
"""Suffixes of formats without transparency."""

_OUTLIER_PERCENT: Final = 2.0  # percent of the depths, at each end, outside the grey scale

# Animated GIFs have 256 colours a picture, and pixels that are opaque or absent.
_MILLISECONDS: Final = 1000
_ALPHA_THRESHOLD: Final = 128
"""The least alpha of pixels that are shown as opaque."""
_OPAQUE_ALPHA: Final = 255
_TRANSPARENT_INDEX: Final = 255
"""The palette index of transparent pixels, and the number of colours."""
_DISPOSE_TO_BACKGROUND: Final = 2
"""GIF's disposal "restore to background": transparent pixels hide the previous frame."""

_XMP_TEMPLATE: Final = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
    "{}/></rdf:RDF></x:xmpmeta>"
)


def array_of(frame: Frame, mode: Mode) -> Float32[np.ndarray, "h w *c"]:
    """Return a frame's output for a display mode, as floats without any conversion."""
    arrays = {
        "color": frame.rgba,
        "depth": frame.depth,
        "median-depth": frame.median_depth,
        "normal": frame.normal,
        "alpha": frame.alpha,
    }
    array = arrays[mode]
    if array is None:
        raise ValueError(
            f"the frame has no {mode}: pass {PICTURE_MODES[mode]!r} in the outputs of render()"
        )
    return array


def picture_of(
    frame: Frame, mode: Mode, depths: tuple[float, float] | None = None
) -> UInt8[np.ndarray, "h w *c"]:
    """Return a frame's output for a display mode, as an image of bytes.

    Colours are sRGB with alpha. Depths are grey: near is bright, and pixels without a depth are
    black; ``depths`` become white and nearly black, by default those of most pixels. Normals are
    (n + 1) / 2 in world space. Alpha is grey.
    """
    return np.asarray(np.rint(levels_of(frame, mode, depths) * 255), np.uint8)


def levels_of(
    frame: Frame, mode: Mode, depths: tuple[float, float] | None = None
) -> Float[np.ndarray, "h w *c"]:
    """Return a frame's output for a display mode, as an image of floats from 0 to 1."""
    if mode == "color":
        return frame.srgb
    array = array_of(frame, mode)
    if mode == "normal":
        return np.asarray(np.clip((array + 1) / 2 * array.any(axis=-1, keepdims=True), 0, 1))
    if mode == "alpha":
        return np.asarray(np.clip(array, 0, 1))
    near, far = depths or depth_range(array)
    depth_fraction = (np.where(np.isfinite(array), array, far) - near) / max(far - near, 1e-12)
    return np.asarray(np.where(np.isfinite(array), 1 - 0.9 * np.clip(depth_fraction, 0, 1), 0))


def depth_range(depth: Float32[np.ndarray, "h w"]) -> tuple[float, float]:
    """Return the range of depths that most pixels of a depth image have."""
    finite = depth[np.isfinite(depth)]
    if not finite.size:
        return 0.0, 1.0
    near, far = np.percentile(finite, [_OUTLIER_PERCENT, 100 - _OUTLIER_PERCENT])
    return float(near), float(far)


def save_picture(
    path: Path, picture: UInt8[np.ndarray, "h w *c"], camera: Camera | None = None
) -> None:
    """Write an image file atomically, in the format of its suffix.

    A JPEG whose ``camera`` is a panorama gets GPano metadata.

    Raises:
        SceneInvalid: Pillow is missing, or cannot write such a file.
    """
    image = _image()
    metadata = _metadata(camera, picture) if path.suffix.lower() in (".jpg", ".jpeg") else {}
    with atomic_write(path) as temporary_path:
        try:
            image.fromarray(_composite_on_black(path, picture)).save(temporary_path, **metadata)
        except ValueError as error:
            raise SceneInvalid(f"cannot be written: {error}", where=str(path)) from error


def png_of(picture: UInt8[np.ndarray, "h w *c"]) -> bytes:
    """Encode a picture as a PNG file."""
    file = io.BytesIO()
    _image().fromarray(picture).save(file, "png")
    return file.getvalue()


def _metadata(camera: Camera | None, picture: UInt8[np.ndarray, "h w *c"]) -> dict[str, bytes]:
    """Return the metadata of an image file, unless a post-process model changed its size."""
    if camera is None or picture.shape[:2] != (camera.height, camera.width):
        return {}
    xmp = gpano(camera)
    return {} if xmp is None else {"xmp": xmp}


def gpano(camera: Camera) -> bytes | None:
    """Return the XMP packet of a panorama camera, in the terms of Google's Photo Sphere.

    The terms place the picture in the full sphere, whose middle is the camera's direction. The
    result is None for other cameras, and where the terms do not suffice: for a sphere that is not
    twice as wide as high, and for a picture across its seam.
    """
    width, height = round(camera.period), round(math.pi * camera.fy)
    left = round(width / 2 - camera.cx)
    top = round(height / 2 - camera.cy)
    is_inside = left >= 0 and top >= 0
    is_inside &= left + camera.width <= width and top + camera.height <= height
    if camera.kind != "panorama" or width != 2 * height or not is_inside:
        return None
    panorama_fields = {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaImageWidthPixels": camera.width,
        "CroppedAreaImageHeightPixels": camera.height,
        "CroppedAreaLeftPixels": left,
        "CroppedAreaTopPixels": top,
    }
    attributes = " ".join(f'GPano:{name}="{value}"' for name, value in panorama_fields.items())
    return _XMP_TEMPLATE.format(attributes).encode()


def save_array(path: Path, array: Float32[np.ndarray, "h w *c"]) -> None:
    """Write an array as an .npy file atomically."""
    with atomic_write(path) as temporary_path:
        np.save(temporary_path, array)


def save_video(
    path: Path,
    pictures: Iterable[UInt8[np.ndarray, "..."]],
    fps: float,
    sound: mp4.Sound | None = None,
) -> None:
    """Write an MP4, or an animated GIF that repeats for ever and is silent, atomically.

    An MP4 is blended with black; :func:`save_gif` describes the transparency of a GIF.

    Raises:
        SceneInvalid: Pillow is missing, or cannot write such a file.
    """
    image = _image()
    if path.suffix.lower() == ".mp4":
        colors = (
            image.fromarray(_composite_on_black(path, picture)).convert("RGB")
            for picture in pictures
        )
        video = mp4.encode(colors, fps, sound)
        with atomic_write(path) as temporary_path:
            temporary_path.write_bytes(video)
        return
    frames = list(pictures)
    with atomic_write(path) as temporary_path:
        save_gif(temporary_path, frames, fps)


def save_gif(path: Path, pictures: Sequence[UInt8[np.ndarray, "..."]], fps: float) -> None:
    """Write grey, RGB or RGBA pictures with straight alpha as a GIF that repeats for ever.

    A pixel with an alpha of half or more is opaque, in its own colour; others are transparent.
    """
    image = _image()
    options: dict[str, Any] = {"duration": round(_MILLISECONDS / fps), "loop": 0}
    if any(
        picture.shape[2:] == (4,) and picture[..., 3].min() < _OPAQUE_ALPHA for picture in pictures
    ):
        frames = [_palette_image(picture) for picture in pictures]
        options |= {
            "disposal": _DISPOSE_TO_BACKGROUND,
            "transparency": _TRANSPARENT_INDEX,
            "optimize": False,
        }
    else:
        frames = [
            image.fromarray(picture[..., :3] if picture.ndim == 3 else picture)
            for picture in pictures
        ]
    frames[0].save(path, "gif", save_all=True, append_images=frames[1:], **options)


def _palette_image(picture: UInt8[np.ndarray, "h w 4"]) -> "Image":
    """Quantise a picture to 255 colours and a transparent one."""
    image = _image()
    is_opaque = picture[..., 3] >= _ALPHA_THRESHOLD
    colors = image.fromarray(picture[..., :3] * is_opaque[..., None]).quantize(_TRANSPARENT_INDEX)
    color_indices = np.where(is_opaque, np.asarray(colors), _TRANSPARENT_INDEX).astype(np.uint8)
    frame: Image = image.frombytes("P", colors.size, color_indices.tobytes())
    palette = colors.getpalette() or []
    frame.putpalette(palette + [0] * (3 * (_TRANSPARENT_INDEX + 1) - len(palette)))
    return frame


def _composite_on_black(path: Path, picture: UInt8[np.ndarray, "h w *c"]) -> np.ndarray:
    """Blend a picture with black if the file format has no transparency."""
    if picture.ndim == 3 and picture.shape[2] == 4 and path.suffix.lower() in OPAQUE_SUFFIXES:
        alpha = picture[..., 3:] / 255
        return np.asarray(np.rint(picture[..., :3] * alpha), np.uint8)
    return picture


def require_pillow() -> None:
    """Raise if pillow, which writes image files, is not installed."""
    _image()


def _image() -> ModuleType:
    try:
        from PIL import Image
    except ImportError as error:
        raise SceneInvalid(
            "image files need pillow, which is not installed", hint="pip install 'gsgen[runtime]'"
        ) from error
    return Image
