"""Layers of small networks, stored as the matrices that they multiply with."""

__all__ = ["Dense"]

from jaxtyping import Float
from torch import Tensor, nn


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
