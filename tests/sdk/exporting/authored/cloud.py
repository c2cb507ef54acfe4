"""A cloud of Gaussians that the modules of this package move, turn, colour and select."""

__all__ = ["Cloud", "N"]

from typing import Any

import torch
from torch import Tensor

from gsgen.sdk import GaussianGenerator, Gaussians, inputs

N = 48


class Cloud(GaussianGenerator):
    """Gaussians at rest; subclasses compute some of their fields in every frame."""

    inputs = (inputs.time(),)

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(7)
        self.register_buffer("rest", torch.randn(N, 3))
        self.register_buffer("scale", 0.05 + 0.1 * torch.rand(N, 3))
        self.register_buffer("rotation", torch.randn(N, 4))
        self.register_buffer("opacity", 0.2 + 0.7 * torch.rand(N, 1))
        self.register_buffer("rgb", 0.1 + 0.8 * torch.rand(N, 3))

    def cloud(self, **fields: Any) -> Gaussians:
        """Return the Gaussians at rest, with some fields replaced."""
        at_rest: dict[str, Tensor] = {
            "position": self.rest,
            "opacity": self.opacity,
            "rgb": self.rgb,
        }
        if "covariance" not in fields:
            at_rest |= {"scale": self.scale, "rotation": self.rotation}
        return Gaussians(**(at_rest | fields))

    def forward(self, time: Tensor) -> Gaussians:
        """Return the Gaussians at a time."""
        raise NotImplementedError
