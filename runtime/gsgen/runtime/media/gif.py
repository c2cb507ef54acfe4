"""GIF: films of 256 colours a picture, whose pixels are there or not, and nothing between."""

__all__ = ["save_gif"]

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import UInt8

_MILLISECONDS: Final = 1000
_HALF: Final = 128
"""The least alpha that is shown, opaque."""
_ABSENT: Final = 255
"""Which entry of a palette is no colour."""
_CLEARED: Final = 2
"""GIF's "restore to background": what a frame leaves out shows no frame before it."""


def save_gif(path: Path, pictures: Sequence[UInt8[np.ndarray, "..."]], fps: float) -> None:
    """Write an animated GIF that repeats for ever.

    A pixel that is covered by half or more is opaque, in its own colour; others are transparent.

    Args:
        path: Where to.
        pictures: Grey, RGB or RGBA; alpha is not multiplied into colours.
        fps: Frames a second.
    """
    from PIL import Image

    options: dict[str, Any] = {"duration": round(_MILLISECONDS / fps), "loop": 0}
    if any(
        picture.shape[2:] == (4,) and picture[..., 3].min() < _ABSENT
        for picture in pictures
    ):
        frames = [_keyed(Image, picture) for picture in pictures]
        options |= {"disposal": _CLEARED, "transparency": _ABSENT, "optimize": False}
    else:
        frames = [
            Image.fromarray(picture[..., :3] if picture.ndim == 3 else picture)
            for picture in pictures
        ]
    frames[0].save(path, "gif", save_all=True, append_images=frames[1:], **options)


def _keyed(image: Any, picture: UInt8[np.ndarray, "h w 4"]) -> Any:
    """Return a picture of 255 colours and one that is none."""
    is_opaque = picture[..., 3] >= _HALF
    colors = image.fromarray(picture[..., :3] * is_opaque[..., None]).quantize(_ABSENT)
    indices = np.where(is_opaque, np.asarray(colors), _ABSENT).astype(np.uint8)
    frame = image.frombytes("P", colors.size, indices.tobytes())
    palette = colors.getpalette()
    frame.putpalette(palette + [0] * (3 * (_ABSENT + 1) - len(palette)))
    return frame
