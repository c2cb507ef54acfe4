"""Layers of small networks, stored as the matrices that they multiply with."""

__all__ = ["Dense", "proportion"]

import torch
from jaxtyping import Float
from torch import Tensor, nn

# exp of it is a number of float32, and that of float16 infinite: both give no proportion.
_MOST = 80.0


def proportion(logit: Tensor) -> Tensor:
    """Return the sigmoid, as exact for small results as for large ones.

    ONNX Runtime's own is off by 1e-7 on a CPU however small its result, so that what is a hundred
    thousandth of a scale, or less, would be of another shape.
    """
    return torch.reciprocal(1 + torch.exp((-logit).clamp(max=_MOST)))


class Dense(nn.Module):
    """x W + b, with W as (in, out): a transposed weight would be one more kernel."""

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"]) -> None:
        """Take a weight as ``nn.Linear`` stores it, (out, in)."""
        super().__init__()
        self.register_buffer("weight", weight.t().contiguous())
        self.register_buffer("bias", bias.clone())

    def forward(self, inputs: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Apply the layer to rows."""
        return inputs @ self.weight + self.bias
