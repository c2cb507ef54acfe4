"""A cloud of points that the idioms of this package move."""

__all__ = ["POINTS", "Idiom", "Scene"]

from collections.abc import Callable

import torch
from torch import Tensor, nn

from gsgen.sdk import GaussianGenerator, Gaussians, inputs

POINTS = 24


class Scene(GaussianGenerator):
    """Points with weights, a tree of joints, tables and networks, moved by a function of them.

    Args:
        function: Returns the positions [24, 3] of the Gaussians at a time [1].
    """

    inputs = (inputs.time(),)

    def __init__(self, function: "Idiom") -> None:
        super().__init__()
        torch.manual_seed(3)
        self.function = function
        self.xyz = nn.Parameter(torch.rand(POINTS, 3) * 2 - 1)
        self.features = nn.Parameter(torch.randn(POINTS, 8))
        self.offsets = nn.Parameter(torch.where(torch.arange(30) % 7 == 3, 0.02, 0.0)[:, None])
        self.table = nn.Parameter(torch.randn(64, 3))
        self.register_buffer("parents", torch.tensor([-1, 0, 1, 1, 3]))
        self.register_buffer("part", torch.arange(POINTS) % 5)
        self.register_buffer("is_moving", torch.arange(POINTS) % 3 == 0)
        self.register_buffer("bounds", torch.tensor([[-1.5] * 3, [1.5] * 3]))
        self.register_buffer("canvas", torch.zeros(POINTS, 3))
        self.register_buffer("grid", torch.randn(1, 3, 8, 8))
        self.net = nn.Sequential(nn.Linear(8, 16), nn.ReLU(), nn.Linear(16, 3))
        self.norm = nn.BatchNorm1d(3)
        self.dropout = nn.Dropout(0.3)
        self.register_buffer(
            "appearance", torch.cat([torch.rand(POINTS, 4), torch.randn(POINTS, 4)], 1)
        )

    def moved(self, time: Tensor) -> Tensor:
        """Return positions [24, 3] that depend on the time."""
        return self.xyz + 0.2 * torch.sin(4 * time + self.features[:, :3])

    def forward(self, time: Tensor) -> Gaussians:
        """Return the Gaussians at a time."""
        position = self.function(self, time)
        rgb, opacity, rotation = self.appearance.split([3, 1, 4], dim=1)
        return Gaussians(position, opacity, torch.full((POINTS, 3), 0.1), rotation, rgb=rgb)


Idiom = Callable[[Scene, Tensor], Tensor]
