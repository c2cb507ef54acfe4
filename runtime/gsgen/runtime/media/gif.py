"""Writes animated GIFs: 256 colours per picture, and pixels that are opaque or absent."""

__all__ = ["save_gif"]

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import UInt8

if TYPE_CHECKING:
    from PIL.Image import Image

_MILLISECONDS: Final = 1000
_HALF: Final = 128
"""The least alpha of pixels that are shown as opaque."""
_OPAQUE: Final = 255
_ABSENT: Final = 255
"""The palette index of transparent pixels, and the number of colours."""
_CLEARED: Final = 2
"""GIF's disposal "restore to background": transparent pixels hide the previous frame."""


def save_gif(path: Path, pictures: Sequence[UInt8[np.ndarray, "..."]], fps: float) -> None:
    """Write grey, RGB or RGBA pictures with straight alpha as a GIF that repeats for ever.

    A pixel with an alpha of half or more is opaque, in its own colour; others are transparent.
    """
    from PIL import Image

    options: dict[str, Any] = {"duration": round(_MILLISECONDS / fps), "loop": 0}
    if any(picture.shape[2:] == (4,) and picture[..., 3].min() < _OPAQUE for picture in pictures):
        frames = [_with_transparent_color(picture) for picture in pictures]
        options |= {"disposal": _CLEARED, "transparency": _ABSENT, "optimize": False}
    else:
        frames = [
            Image.fromarray(picture[..., :3] if picture.ndim == 3 else picture)
            for picture in pictures
        ]
    frames[0].save(path, "gif", save_all=True, append_images=frames[1:], **options)


def _with_transparent_color(picture: UInt8[np.ndarray, "h w 4"]) -> "Image":
    """Quantise a picture to 255 colours and a transparent one."""
    from PIL import Image

    is_opaque = picture[..., 3] >= _HALF
    colors = Image.fromarray(picture[..., :3] * is_opaque[..., None]).quantize(_ABSENT)
    indices = np.where(is_opaque, np.asarray(colors), _ABSENT).astype(np.uint8)
    frame = Image.frombytes("P", colors.size, indices.tobytes())
    palette = colors.getpalette() or []
    frame.putpalette(palette + [0] * (3 * (_ABSENT + 1) - len(palette)))
    return frame
