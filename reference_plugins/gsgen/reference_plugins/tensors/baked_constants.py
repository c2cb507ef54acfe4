"""Tensors that no input changes: stored, or left to the graph to compute from what is smaller.

ONNX Runtime computes what follows from weights alone once, when it loads a model, whatever device
the rest runs on. So a product that is larger than what it was made of need not be in the file: it
costs no time of a frame either way.
"""

__all__ = ["BAKES", "Bake", "Constants"]

import copy
from collections.abc import Iterable, Sequence
from typing import Literal

import torch
from torch import Tensor, nn

Bake = Literal["auto", "always", "never"]
BAKES: tuple[Bake, ...] = ("auto", "always", "never")


class Constants(nn.Module):
    """What a module makes, either as it is or as what makes it."""

    def __init__(
        self, make: nn.Module, given: Sequence[Tensor] = (), bake: Bake = "auto"
    ) -> None:
        """Measure both, and keep the smaller one.

        Args:
            make: Returns a tuple of tensors; its buffers are what it takes to compute them.
            given: Its arguments, which the model has for another reason, and so for free.
            bake: ``always`` keeps what ``make`` returns, ``never`` its buffers, ``auto`` what is
                smaller.
        """
        super().__init__()
        with torch.no_grad():  # a copy in float64, as the result is rounded once only
            exact = copy.deepcopy(make).double()
            made = exact(
                *(one.double() if one.is_floating_point() else one for one in given)
            )
        stored = [one.float() if one.is_floating_point() else one for one in made]
        smaller = _bytes(stored) <= _bytes(make.buffers())
        self.bakes = bake == "always" or (bake == "auto" and smaller)
        self.make = None if self.bakes else make
        self.count = len(stored)
        for index, one in enumerate(stored if self.bakes else ()):
            self.register_buffer(f"made_{index}", one.contiguous())

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Return the tensors; ``given`` are the arguments of the module that makes them."""
        if self.make is None:
            return tuple(getattr(self, f"made_{index}") for index in range(self.count))
        made: tuple[Tensor, ...] = self.make(*given)
        return made


def _bytes(tensors: Iterable[Tensor]) -> int:
    return sum(one.numel() * one.element_size() for one in tensors)
