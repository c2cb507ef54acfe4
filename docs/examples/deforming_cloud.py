"""Time-deformed: features of a HexPlane move, turn and stretch a cloud."""

import torch

from gsgen.sdk import GaussianGenerator, Gaussians, inputs, math

# The planes' coordinates, as 4D Gaussian Splatting orders them: xy, xz, xt, yz, yt, zt.
AXES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


class DeformingCloud(GaussianGenerator):
    """A cloud that deforms while time runs from 0 to 1."""

    inputs = (inputs.time(range=(0, 1)),)
    family = "4d"

    def __init__(self, n: int = 500, channels: int = 8, seed: int = 0) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.register_buffer("position", torch.rand(n, 3) * 2 - 1)
        self.register_buffer("quaternion", torch.randn(n, 4))
        self.register_buffer("log_scale", torch.randn(n, 3) * 0.3 - 3)
        self.register_buffer("opacity", torch.rand(n) * 0.7 + 0.3)
        self.register_buffer("sh", torch.randn(n, 4, 3) * 0.3)
        size = (16, 16, 16, 8)  # of the grid along x, y, z and time
        self.planes = torch.nn.ParameterList(
            1 + 0.3 * torch.randn(channels, size[b], size[a]) for a, b in AXES
        )
        self.head = torch.nn.Linear(channels, 3 + 4 + 3)

    def forward(self, time: torch.Tensor) -> Gaussians:
        """Deform the cloud to ``time``, [1]."""
        feature = math.hex_plane(list(self.planes), self.position, 2 * time - 1)
        move, turn, stretch = torch.split(0.1 * self.head(feature), [3, 4, 3], dim=1)
        return Gaussians(
            position=self.position + move,
            opacity=self.opacity,
            scale=torch.exp(self.log_scale + stretch),
            rotation=self.quaternion + turn,
            sh=self.sh,
        )
