"""What an author of a post-process model writes: a torch module from image to image."""

__all__ = ["PostProcess"]

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Literal

from torch import nn

from gsgen.contract.spec.manifest import Input, Producer


class PostProcess(nn.Module, ABC):
    """A torch module that takes the rendered image and returns one of the same size.

    Subclasses set the class attributes below (or set them on the instance) and write ``forward``,
    which takes the declared inputs in order and returns [1, 3 or 4, H, W].

    Attributes:
        inputs: Made by the functions of :mod:`gsgen.sdk.authoring.inputs`: one ``image``, and what else a
            frame needs (``timestep``, ``conditioning``, ``control``).
        channels: Of the image that comes in, where its size is open; otherwise the entry says it.
        image_range: Values of black and white in the image that comes in.
        output_range: The same of the one that goes out.
        color_space: Of the image that goes out.
        tolerance: How far the exported model may be off, as a share of the output's range.
        half_tolerance: The same where it computes in float16.
        family: A word such as ``diffusion``.
        producer: Tool, source and licence; the SDK fills in itself where absent.
    """

    inputs: Sequence[Input] = ()
    channels: Literal[3, 4] = 3
    image_range: tuple[float, float] = (0.0, 1.0)
    output_range: tuple[float, float] = (0.0, 1.0)
    color_space: Literal["srgb", "linear"] = "srgb"
    tolerance: float = 1e-3
    half_tolerance: float = 2e-2
    family: str | None = None
    producer: Producer | None = None

    @abstractmethod
    def forward(self, *inputs: Any, **_: Any) -> Any:
        """Return the image.

        Args:
            inputs: One tensor for each declared input, in order. A model that is exported as
                float16 gets its image as float16, and all else as float32.
        """
