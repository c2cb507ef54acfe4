"""The result of rendering a scene: an image with depths, Gaussian ids and normals."""

__all__ = ["COLOR_OUTPUT_ONLY", "NOTHING", "OUTPUTS", "Frame", "Output", "psnr"]

import io
import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float, Float32, Int64, UInt8

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.srgb import srgb_of_linear

Output = Literal["color", "depth", "normal"]
"""Outputs of a frame; ``depth`` includes both depths and the ids."""

OUTPUTS: Final[tuple[Output, ...]] = ("color", "depth", "normal")
"""All outputs of a frame."""

COLOR_OUTPUT_ONLY: Final[tuple[Output, ...]] = ("color",)
"""The default outputs of a frame."""

NOTHING: Final = -1
"""The id of pixels at which no Gaussian took half of the light."""


_ENCODED_ROWS: Final = 256  # rows of an image at a time


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frame:
    """A rendered image with its depths, ids and normals; outputs that were not requested are None.

    Attributes:
        rgba: Red, green, blue multiplied by alpha, and alpha, [height, width, 4], as blended:
            in the colour space of the Gaussians, neither clipped nor quantised.
        alpha: How much of the background is covered, [height, width], in [0, 1].
        depth: Mean distance along the camera's +z, in a panorama from the camera, weighted as the
            colours are, in world units; infinite where nothing is drawn.
        median_depth: Distance of the Gaussian that took half of the light; infinite where no
            Gaussian did.
        ids: Index of that Gaussian in the scene, or NOTHING; see ``Scene.locate``.
        normal: Unit vectors in world space that point towards the camera, [height, width, 3];
            zero where nothing is drawn.
        visible: Number of drawn Gaussians; of those in cells, all that are in the image. In an
            image that is drawn in bands, because it exceeds a GPU binding, a Gaussian counts in
            each band that it touches.
        pairs: Number of pairs of a tile and a splat or cell that touches it, which the cost
            grows with.
        color_space: Colour space of ``rgba``.
    """

    rgba: Float32[np.ndarray, "h w 4"] | None
    alpha: Float32[np.ndarray, "h w"]
    depth: Float32[np.ndarray, "h w"] | None
    median_depth: Float32[np.ndarray, "h w"] | None
    ids: Int64[np.ndarray, "h w"] | None
    normal: Float32[np.ndarray, "h w 3"] | None
    visible: int
    pairs: int
    color_space: Literal["srgb", "linear"] = "srgb"

    @property
    def srgb8(self) -> UInt8[np.ndarray, "h w 4"]:
        """The image for files and screens: sRGB bytes with straight alpha.

        Raises:
            ValueError: Colours were not requested.
        """
        rgba = self._colors()
        image = np.empty(rgba.shape, np.uint8)
        for first in range(
            0, len(rgba), _ENCODED_ROWS
        ):  # large images would take five times the memory
            rows = slice(first, first + _ENCODED_ROWS)
            image[rows] = np.rint(self._encode_srgb(rgba[rows]) * 255)
        return image

    @property
    def srgb(self) -> Float[np.ndarray, "h w 4"]:
        """The image as sRGB with straight alpha, from 0 to 1, not quantised.

        Raises:
            ValueError: Colours were not requested.
        """
        return self._encode_srgb(self._colors())

    def _colors(self) -> Float32[np.ndarray, "h w 4"]:
        if self.rgba is None:
            raise ValueError("this frame has no colours: pass 'color' in the outputs of render()")
        return self.rgba

    def _encode_srgb(self, rgba: Float32[np.ndarray, "h w 4"]) -> Float[np.ndarray, "h w 4"]:
        """Encode rows of colours as sRGB with straight alpha."""
        alpha = np.clip(rgba[..., 3:], 0, 1)
        straight_colors = rgba[..., :3] / np.where(alpha > 0, alpha, 1)
        color = np.clip(straight_colors, 0, 1)
        if self.color_space == "linear":
            color = srgb_of_linear(color)
        return np.concatenate([color, alpha], axis=-1)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the colours as a picture, such as a PNG, or all channels as an ``.npy``.

        Raises:
            ConfigInvalid: No kind of picture has this suffix, or the file cannot be written.
            ValueError: Colours were not requested.
        """
        from PIL import Image

        file, kinds = Path(path), Image.registered_extensions()
        suffix = file.suffix.lower()
        if suffix != ".npy" and kinds.get(suffix) not in Image.SAVE:
            raise ConfigInvalid(
                f"has the suffix {suffix or '(none)'}, expected that of a picture",
                where=str(file),
                hint=f"Name {file.with_suffix('.png')}.",
            )
        with atomic_write(file) as draft:
            if suffix == ".npy":
                np.save(draft, self.srgb8)
            else:
                picture = Image.fromarray(self.srgb8)
                picture.convert("RGB" if kinds[suffix] == "JPEG" else "RGBA").save(draft)

    def __repr__(self) -> str:
        images = [
            name
            for name in ("rgba", "depth", "median_depth", "ids", "normal")
            if getattr(self, name) is not None
        ]
        height, width = self.alpha.shape
        drawn = f"{self.visible:,} visible Gaussians"
        return f"<Frame: {width}×{height} pixels, {', '.join([*images, drawn])}>"

    def _repr_png_(self) -> bytes | None:
        """Return the colours as a PNG, for notebooks; None without colours or without pillow."""
        if self.rgba is None or find_spec("PIL") is None:
            return None
        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(self.srgb8).save(file, "png")
        return file.getvalue()


def psnr(a: Float[np.ndarray, "..."], b: Float[np.ndarray, "..."]) -> float:
    """Return the peak signal-to-noise ratio of two pictures with peak 1, in decibels.

    The ratio is infinite if the pictures are equal.
    """
    error = float(np.square(a.astype(np.float64) - b).mean())
    return float(-10 * np.log10(error)) if error > 0 else float("inf")
