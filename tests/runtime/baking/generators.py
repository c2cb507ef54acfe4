"""Generators whose colours and counts follow from the camera in known ways."""

import torch

from gsgen.sdk import GaussianGenerator, Gaussians, inputs

ROWS = 40


def _basis(d: torch.Tensor) -> torch.Tensor:
    """The nine real harmonics up to degree 2 of unit vectors, with 3DGS signs, [n, 9]."""
    x, y, z = d[:, 0], d[:, 1], d[:, 2]
    columns = [
        0.28209479177387814 + 0 * x,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
    ]
    return torch.stack(columns, dim=1)


class Harmonic(GaussianGenerator):
    """RGB that is exactly an SH of degree 2 of the viewing direction."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        seeded = torch.Generator().manual_seed(2)
        self.register_buffer("centre", torch.randn(ROWS, 3, generator=seeded))
        self.register_buffer("sh", 0.08 * torch.randn(ROWS, 9, 3, generator=seeded))
        self.register_buffer("rotation", torch.randn(ROWS, 4, generator=seeded))
        self.register_buffer("scale", 0.1 + 0.1 * torch.rand(ROWS, 3, generator=seeded))

    def forward(self, eye: torch.Tensor) -> Gaussians:
        ray = self.centre - eye
        direction = ray / torch.sqrt((ray * ray).sum(dim=1, keepdim=True).clamp(min=1e-9))
        color = (_basis(direction)[:, :, None] * self.sh).sum(dim=1)
        return Gaussians(
            position=self.centre,
            opacity=torch.full((ROWS,), 0.8),
            scale=self.scale,
            rotation=self.rotation,
            rgb=0.5 + color,
        )


class HalfSeen(GaussianGenerator):
    """Rows that the camera's side hides are left out, and the others move up."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        seeded = torch.Generator().manual_seed(5)
        self.register_buffer("centre", torch.randn(ROWS, 3, generator=seeded))
        self.register_buffer("rgb", torch.rand(ROWS, 3, generator=seeded))

    def forward(self, eye: torch.Tensor) -> Gaussians:
        visible_mask = (self.centre * eye).sum(dim=1) >= 0
        order = torch.argsort((~visible_mask).to(torch.float32) * ROWS + torch.arange(ROWS))
        return Gaussians(
            position=self.centre[order],
            opacity=(0.9 * visible_mask.to(torch.float32))[order],
            scale=torch.full((ROWS, 3), 0.1),
            rotation=torch.tensor([[1.0, 0, 0, 0]]).repeat(ROWS, 1),
            rgb=self.rgb[order],
            count=visible_mask.sum().to(torch.int64),
        )
