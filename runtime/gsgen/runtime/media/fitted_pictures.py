"""Fits pictures of any size to a model's input: crop to its shape, then resample.

The rule is the specification's (the section "Pictures" of its roles), so that every runtime feeds
the same numbers.
"""

__all__ = ["PictureFit", "fit_picture", "resample"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8


@final
@dataclass(frozen=True, slots=True)
class PictureFit:
    """The part of a picture that a model's input shows: centred, as large as possible.

    Attributes:
        scale: Pixels of the picture per pixel of the input.
        left: Left edge of the part, in pixels of the picture.
        top: Upper edge of the part, in pixels of the picture.
    """

    scale: float
    left: float
    top: float

    @classmethod
    def of_sizes(cls, picture: tuple[int, int], expected: tuple[int, int]) -> "PictureFit":
        """Return the part of a picture, from heights and widths of the picture and of the input."""
        (height, width), (rows, columns) = picture, expected
        scale = min(width / columns, height / rows)
        return cls(scale, (width - scale * columns) / 2, (height - scale * rows) / 2)

    def intrinsics(
        self, *, fx: float, fy: float, cx: float, cy: float
    ) -> Float64[np.ndarray, "3 3"]:
        """Return the pinhole matrix of the input's pixels, from that of the picture's pixels."""
        return np.array(
            [
                [fx / self.scale, 0.0, (cx - self.left) / self.scale],
                [0.0, fy / self.scale, (cy - self.top) / self.scale],
                [0.0, 0.0, 1.0],
            ]
        )


def fit_picture(
    picture: UInt8[np.ndarray, "h w 4"],
    size: tuple[int, int],
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Float32[np.ndarray, "3 rows columns"]:
    """Return a picture cropped and resampled to a size, over a background, from 0 to 1.

    Args:
        picture: RGB and alpha, not multiplied by it.
        size: Height and width, in pixels.
        background: RGB under transparent pixels, from 0 to 1.
    """
    fit = PictureFit.of_sizes(picture.shape[:2], size)
    # Step 1: over the background, in encoded numbers.
    alpha = picture[..., 3:] / 255
    colors = alpha * (picture[..., :3] / 255) + (1 - alpha) * np.asarray(background)
    # Step 2: triangle filter.
    resampled = _resample_part(colors, size, fit).transpose(2, 0, 1)
    return np.asarray(np.clip(resampled, 0, 1), np.float32)


def resample(
    picture: Float[np.ndarray, "h w c"], size: tuple[int, int]
) -> Float32[np.ndarray, "rows columns c"]:
    """Return a picture of the same shape in another size, by the same filter."""
    fit = PictureFit.of_sizes(picture.shape[:2], size)
    return np.asarray(_resample_part(picture, size, fit), np.float32)


def _resample_part(
    picture: Float[np.ndarray, "h w c"], size: tuple[int, int], fit: PictureFit
) -> Float[np.ndarray, "rows columns c"]:
    """Apply a triangle filter to a part of a picture, first over rows, then over columns."""
    vertical = _resampling_weights(picture.shape[0], size[0], fit.scale, fit.top)
    horizontal = _resampling_weights(picture.shape[1], size[1], fit.scale, fit.left)
    rows = np.einsum("yh,hwc->cyw", vertical, picture, optimize=True)
    return np.asarray((rows @ horizontal.T).transpose(1, 2, 0))


def _resampling_weights(
    source: int, target: int, scale: float, start: float
) -> Float[np.ndarray, "target source"]:
    """Return the share of each source pixel in each target pixel along one axis.

    A triangle around the target pixel's centre, two target pixels wide, or two source pixels where
    the picture is enlarged.
    """
    centers = start + scale * (np.arange(target) + 0.5)
    distances = np.abs(np.arange(source) + 0.5 - centers[:, None]) / max(scale, 1.0)
    weights = np.maximum(0.0, 1.0 - distances)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
