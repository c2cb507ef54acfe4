"""A frame: what a camera sees of a scene."""

__all__ = ["Frame"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float32, UInt8


@final
@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """An image and what belongs to it.

    Attributes:
        rgba: Red, green, blue multiplied by alpha, and alpha, [height, width, 4], as blended:
            neither clipped nor quantised.
        visible: How many Gaussians were drawn.
        pairs: Of a splat and a tile it touches; what drawing costs grows with them.
    """

    rgba: Float32[np.ndarray, "h w 4"]
    visible: int
    pairs: int

    @property
    def srgb8(self) -> UInt8[np.ndarray, "h w 4"]:
        """The image in bytes, for files and screens; alpha is straight where it is not 1."""
        return np.asarray(np.clip(np.rint(self.rgba * 255), 0, 255), np.uint8)
