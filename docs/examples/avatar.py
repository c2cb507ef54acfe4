"""Skinned: a pose turns joints, and Gaussians follow the joints they hang on."""

import torch

from gsgen.sdk import GaussianGenerator, Gaussians, inputs, math

# An arm of three joints with two fingers; -1 is the root.
PARENTS = (-1, 0, 1, 2, 2)
JOINTS = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0), (1.2, 0.1, 0.0), (1.2, -0.1, 0.0))


class Avatar(GaussianGenerator):
    """An arm of Gaussians."""

    inputs = (inputs.pose(len(PARENTS)), inputs.root_translation())
    family = "avatar"

    def __init__(self, n: int = 500, seed: int = 0) -> None:
        super().__init__()
        torch.manual_seed(seed)
        along = torch.linspace(0, 1.3, n)[:, None]
        rest_centers = along * torch.tensor([1.0, 0.0, 0.0]) + 0.08 * torch.randn(n, 3)
        joints = torch.tensor(JOINTS)
        self.register_buffer("rest", rest_centers)
        self.register_buffer("joints", joints)
        self.register_buffer(
            "weights", torch.softmax(-20 * torch.cdist(rest_centers, joints), dim=1)
        )
        scale = torch.tensor([0.05, 0.02, 0.02]).expand(n, 3)
        # The shape at rest does not change, so its covariance is computed once.
        self.register_buffer("covariance", math.covariance_upper(scale, torch.randn(n, 4)))
        self.register_buffer("color", torch.rand(n, 3))

    def forward(self, pose: torch.Tensor, translation: torch.Tensor) -> Gaussians:
        """Bend the arm by ``pose``, axis-angles [5, 3], and move it."""
        transforms = math.skinning_transforms(
            math.axis_angle_to_matrix(pose), self.joints, PARENTS, translation
        )
        position, turn = math.skin(self.rest, self.weights, transforms)
        return Gaussians(
            position=position,
            opacity=torch.full_like(position[:, 0], 0.9),
            covariance=math.rotate_covariance(self.covariance, turn),
            rgb=self.color,
        )
