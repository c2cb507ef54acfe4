"""The base class of post-process models: torch modules from image to image."""

__all__ = ["PostProcess"]

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Literal

from torch import nn

from gsgen.contract.spec.manifest import Input, Producer


class PostProcess(nn.Module, ABC):
    """Base class of post-process models: a torch module from the rendered image to an image.

    Subclasses set the class attributes below (or set them on the instance) and write ``forward``,
    which takes the declared inputs in order and returns [1, 3 or 4, scale H, scale W].

    Attributes:
        inputs: From the functions of :mod:`gsgen.sdk.authoring.inputs`: one ``image``, and other
            inputs of a frame (``timestep``, ``conditioning``, ``control``).
        channels: Channels of the input image if its size is open; otherwise its entry has them.
        image_range: Values of black and white in the input image.
        output_range: Values of black and white in the output image.
        color_space: Colour space of the output image.
        scale: Height and width of the output image, as multiples of those of the input image.
        tolerance: Allowed error of the exported model, as a fraction of the output's range.
        half_tolerance: The same for a model that computes in float16.
        family: A word such as ``diffusion``.
        producer: Tool, source and licence; the SDK itself if absent.
    """

    inputs: Sequence[Input] = ()
    channels: Literal[3, 4] = 3
    image_range: tuple[float, float] = (0.0, 1.0)
    output_range: tuple[float, float] = (0.0, 1.0)
    color_space: Literal["srgb", "linear"] = "srgb"
    scale: int = 1
    tolerance: float = 1e-3
    half_tolerance: float = 2e-2
    family: str | None = None
    producer: Producer | None = None

    @abstractmethod
    def forward(self, *inputs: Any, **_: Any) -> Any:
        """Return the processed image for a rendered image, [1, channels, scale H, scale W].

        Args:
            inputs: One tensor for each declared input, in order. A model that is exported as
                float16 gets the image as float16 and all other inputs as float32.
        """
