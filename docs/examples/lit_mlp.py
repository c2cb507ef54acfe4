"""View-dependent: a small network colours each Gaussian by the direction it is seen from."""

import torch

from gsgen.sdk import GaussianGenerator, Gaussians, inputs, math


class LitMlp(GaussianGenerator):
    """A ball of Gaussians; in the place of the random weights stand your trained ones."""

    inputs = (inputs.view(),)
    family = "mlp"

    def __init__(self, n: int = 500, width: int = 32, seed: int = 0) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.register_buffer("position", math.safe_normalize(torch.randn(n, 3)))
        x, y, z = self.position.T  # discs along the ball: rotations from the z axis outwards
        self.register_buffer("rotation", torch.stack([1 + z, -y, x, 0 * z], dim=1))
        self.feature = torch.nn.Parameter(torch.randn(n, 8))
        self.head = torch.nn.Sequential(
            torch.nn.Linear(8 + 3, width), torch.nn.ReLU(), torch.nn.Linear(width, 4)
        )

    def forward(self, view: torch.Tensor) -> Gaussians:
        """Colour the ball for the camera of ``view``, world→camera [4, 4]."""
        towards = math.safe_normalize(self.position - math.camera_centre(view))
        features = self.head(torch.cat([self.feature, towards], dim=1))
        return Gaussians(
            position=self.position,
            opacity=0.2 + 0.8 * torch.sigmoid(4 * features[:, 3]),
            scale=torch.tensor([0.06, 0.06, 0.01]).expand_as(self.position),
            rotation=self.rotation,
            rgb=torch.sigmoid(features[:, :3]),
        )
