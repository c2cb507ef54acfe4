"""The base of post-process models that redraw the rendered image in a style."""

__all__ = ["StyleTransfer"]

from abc import abstractmethod

from jaxtyping import Float
from torch import Tensor

from gsgen.sdk import PostProcess, inputs


class StyleTransfer(PostProcess):
    """A network that redraws images in 0 … 1; how much of it is shown may be an input.

    Attributes:
        source: Where the network's own code is; None for networks of this package.
    """

    family = "stylisation"
    source: str | None = None

    def __init__(self, size: tuple[int, int] | None, *, slider: bool = True) -> None:
        super().__init__()
        self.size = size
        style_share = inputs.control("style", range=(0.0, 1.0), default=1.0, label="Style")
        self.inputs = [inputs.image(3, size), *([style_share] if slider else [])]

    @abstractmethod
    def redraw(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 H W"]:
        """Return the redrawn image, perhaps with more pixels at its right and lower edge."""

    @abstractmethod
    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""

    def forward(
        self, image: Float[Tensor, "1 3 h w"], style: Float[Tensor, "1"] | None = None
    ) -> Float[Tensor, "1 3 h w"]:
        """Return the image in the style that the network was trained for."""
        redrawn = self.redraw(image)[:, :, : image.shape[2], : image.shape[3]]
        if style is None:
            return redrawn
        return image + style.to(image.dtype).reshape(1, 1, 1, 1) * (redrawn - image)
