"""Random weights of networks, for synthetic checkpoints."""

__all__ = ["add_noise", "random_linear"]

import torch
from torch import Tensor, nn


def add_noise(network: nn.Module) -> None:
    """Add noise to all weights of a network, so that norms and biases differ from 1 and 0."""
    with torch.no_grad():
        for weight in network.parameters():
            weight.add_(0.1 * torch.randn_like(weight))


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
