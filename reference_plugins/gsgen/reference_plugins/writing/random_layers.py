"""Random weights of networks, for synthetic checkpoints."""

__all__ = ["random_linear"]

import torch
from torch import Tensor


def random_linear(
    name: str, inputs: int, outputs: int, noise: torch.Generator, weight_gain: float = 1.0
) -> dict[str, Tensor]:
    """Return weight and bias of a linear layer, drawn from normal distributions.

    ``weight_gain`` is the standard deviation of an output for inputs of variance 1, and a tenth of it for
    the bias.
    """
    weight = torch.randn((outputs, inputs), generator=noise) * (weight_gain / inputs**0.5)
    bias = 0.1 * weight_gain * torch.randn(outputs, generator=noise)
    return {f"{name}.weight": weight, f"{name}.bias": bias}
