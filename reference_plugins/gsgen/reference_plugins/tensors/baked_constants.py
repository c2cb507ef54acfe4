"""Stores the constant results of a computation, or its input tensors where these are smaller.

ONNX Runtime computes nodes without inputs once, when it loads a model, on any device. So a product
larger than its factors need not be in the file: neither choice costs time in a frame.
"""

__all__ = ["BAKE_MODES", "Bake", "Constants"]

import copy
from collections.abc import Iterable, Sequence
from typing import Literal

import torch
from torch import Tensor, nn

Bake = Literal["auto", "always", "never"]
BAKE_MODES: tuple[Bake, ...] = ("auto", "always", "never")


class Constants(nn.Module):
    """A module's constant output tensors: stored, or computed from the module's buffers."""

    def __init__(
        self, make: nn.Module, arguments: Sequence[Tensor] = (), bake: Bake = "auto"
    ) -> None:
        """Store a module's constant outputs, or instead the buffers that they are computed from.

        Args:
            make: Module that returns a tuple of tensors, computed from its buffers.
            arguments: Its arguments; the model stores them anyway, so they are not counted.
            bake: ``always`` keeps the results, ``never`` the buffers, ``auto`` the smaller.
        """
        super().__init__()
        with torch.no_grad():  # in float64, so that results are rounded only once
            float64_module = copy.deepcopy(make).double()
            results = float64_module(
                *(tensor.double() if tensor.is_floating_point() else tensor for tensor in arguments)
            )
        stored_tensors = [
            tensor.float() if tensor.is_floating_point() else tensor for tensor in results
        ]
        is_stored_smaller = _byte_count(stored_tensors) <= _byte_count(make.buffers())
        self.bakes = bake == "always" or (bake == "auto" and is_stored_smaller)
        self.make = None if self.bakes else make
        self.count = len(stored_tensors)
        for index, tensor in enumerate(stored_tensors if self.bakes else ()):
            self.register_buffer(f"made_{index}", tensor.contiguous())

    def forward(self, *arguments: Tensor) -> tuple[Tensor, ...]:
        """Return the constant tensors, either stored or recomputed from the module's buffers."""
        if self.make is None:
            return tuple(getattr(self, f"made_{index}") for index in range(self.count))
        results: tuple[Tensor, ...] = self.make(*arguments)
        return results


def _byte_count(tensors: Iterable[Tensor]) -> int:
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)
