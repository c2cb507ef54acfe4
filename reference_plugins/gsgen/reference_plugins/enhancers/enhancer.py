"""A post-process model that restores or enlarges the rendered image by a network."""

__all__ = ["Enhancer", "ImageNetwork"]

from abc import ABC, abstractmethod
from typing import Literal, final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float, Int64
from torch import Tensor, nn

from gsgen.sdk import PostProcess, inputs


class ImageNetwork(nn.Module, ABC):
    """A network from an image in 0 … 1 to one that is ``scale`` times as high and wide.

    Attributes:
        source: Where the network's own code is.
        scale: Height and width of the result, as multiples of those of the image.
        multiple: What the sides of its images are multiples of.
        padding: How published code fills an image up to such a multiple.
    """

    source: str
    scale: int
    multiple: int = 1
    padding: Literal["constant", "reflect"] = "reflect"

    @abstractmethod
    def forward(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 sh sw"]:
        """Return the restored image, not clamped."""

    @abstractmethod
    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""


@final
class Enhancer(PostProcess):
    """An image network for images of any size, whose result is clamped to 0 … 1."""

    family = "enhancement"

    def __init__(self, network: ImageNetwork, size: tuple[int, int] | None) -> None:
        super().__init__()
        self.network, self.size, self.scale = network.eval(), size, network.scale
        self.inputs = [inputs.image(3, size)]

    def forward(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 sh sw"]:
        """Return the restored or enlarged image."""
        height, width = image.shape[2], image.shape[3]
        bottom, right = -height % self.network.multiple, -width % self.network.multiple
        is_padded = self.network.multiple > 1 and (self.size is None or bottom > 0 or right > 0)
        padded = image
        if is_padded and self.network.padding == "constant":
            padded = F.pad(image, (0, right, 0, bottom))
        elif is_padded:  # by indices, as the export of mirrored edges needs sizes
            padded = image.index_select(2, _mirrored(height, bottom))
            padded = padded.index_select(3, _mirrored(width, right))
        result: Tensor = self.network(padded)
        if is_padded:
            result = result[:, :, : self.scale * height, : self.scale * width]
        return result.clamp(0.0, 1.0)


def _mirrored(side: int, padding: int) -> Int64[Tensor, " n"]:
    """Return the rows of an image that is continued by its mirror image without its last row."""
    return side - 1 - (side - 1 - torch.arange(side + padding)).abs()
