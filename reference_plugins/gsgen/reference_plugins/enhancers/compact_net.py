"""The small network of Real-ESRGAN (SRVGGNetCompact): convolutions at the image's own size.

Its last layer gives all pixels of the enlarged image at once, as a residual to repeated pixels
(Wang et al. 2021, "Real-ESRGAN", and its models realesr-animevideov3 and realesr-general-x4v3).
"""

__all__ = ["CompactNet", "CompactOptions"]

from dataclasses import dataclass
from typing import final

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.enhancers.enhancer import ImageNetwork


@dataclass(frozen=True, slots=True, kw_only=True)
class CompactOptions:
    """The sizes of the network, as its weights tell them."""

    scale: int
    width: int
    layers: int  # convolutions between the first and the last one


@final
class CompactNet(ImageNetwork):
    """Convolutions with parametric rectifiers, then pixels out of channels."""

    source = "https://github.com/xinntao/Real-ESRGAN"

    def __init__(self, options: CompactOptions) -> None:
        super().__init__()
        self.options, self.scale = options, options.scale
        width, layers = options.width, list[nn.Module]()
        for index in range(options.layers + 1):
            layers += [nn.Conv2d(width if index else 3, width, 3, padding=1), nn.PReLU(width)]
        self.body = nn.ModuleList([*layers, nn.Conv2d(width, 3 * self.scale**2, 3, padding=1)])

    def forward(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 sh sw"]:
        """Return the enlarged image."""
        features = image
        for layer in self.body:
            features = layer(features)
        repeated = F.interpolate(image, scale_factor=float(self.scale), mode="nearest")
        return F.pixel_shuffle(features, self.scale) + repeated

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        options = self.options
        return (
            f"Real-ESRGAN (SRVGGNetCompact) × {self.scale}, "
            f"{options.layers + 2} convolutions of width {options.width}"
        )
