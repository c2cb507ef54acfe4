"""The network over points and time that Deformable-3D-Gaussians and SC-GS share."""

__all__ = ["DeformationNetwork"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.deformation.deformation_checkpoint import (
    BLENDER_TIME_OCTAVES,
    Deformation,
)
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.positional_encoding import (
    POINT_OCTAVES,
    encoded_size,
    positional_encoding,
)


class _SplitLayer(nn.Module):
    """A dense layer of point, time and hidden inputs; all points share one row of time inputs."""

    def __init__(self, weight: Tensor, bias: Tensor, point_inputs: int, time: int) -> None:
        super().__init__()
        self.point = Dense(weight[:, :point_inputs], bias)
        self.time = Dense(weight[:, point_inputs : point_inputs + time], torch.zeros_like(bias))
        hidden_weight = weight[:, point_inputs + time :]
        self.hidden = (
            Dense(hidden_weight, torch.zeros_like(bias)) if hidden_weight.shape[1] else None
        )

    def forward(self, point: Tensor, time: Tensor, hidden: Tensor | None = None) -> Tensor:
        result: Tensor = self.point(point) + time @ self.time.weight
        if self.hidden is not None and hidden is not None:
            result = result + hidden @ self.hidden.weight
        return result


@final
class DeformationNetwork(nn.Module):
    """Hidden layers of a deformation network; one of them sees the encoded inputs again."""

    def __init__(self, net: Deformation) -> None:
        super().__init__()
        self.skip = net.skip
        self.time = nn.ModuleList(Dense(*layer) for layer in net.time or ())
        point_inputs = encoded_size(3, POINT_OCTAVES)
        time_inputs = net.layers[0][0].shape[1] - point_inputs
        self.layers = nn.ModuleList(
            _SplitLayer(*layer, point_inputs, time_inputs)
            if index in (0, net.skip)
            else Dense(*layer)
            for index, layer in enumerate(net.layers)
        )

    def moment(self, time: Float[Tensor, "1"]) -> Float[Tensor, "1 m"]:
        """Encode a time, by the two time layers that only networks of Blender scenes have."""
        if not len(self.time):
            return positional_encoding(time.reshape(1, 1), POINT_OCTAVES)
        first, second = self.time
        encoded = positional_encoding(time.reshape(1, 1), BLENDER_TIME_OCTAVES)
        moment: Tensor = second(torch.relu(first(encoded)))
        return moment

    def forward(
        self, encoded: Float[Tensor, "n p"], moment: Float[Tensor, "1 m"]
    ) -> Float[Tensor, "n w"]:
        """Return the hidden features of encoded points at an encoded time."""
        hidden = torch.relu(self.layers[0](encoded, moment))
        for index, layer in enumerate(self.layers[1:], start=1):
            result = layer(encoded, moment, hidden) if index == self.skip else layer(hidden)
            hidden = torch.relu(result)
        return hidden
