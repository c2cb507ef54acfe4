"""Generators that several SDK tests export."""

import torch

from gsgen.contract.spec.manifest import Space, WeightedSum
from gsgen.sdk import Cells, GaussianGenerator, Gaussians, inputs, math


class Drift(GaussianGenerator):
    """Gaussians that move with time; SH colours."""

    inputs = (inputs.time(),)

    def __init__(self, n: int = 50, degree: int = 3) -> None:
        super().__init__()
        seeded = torch.Generator().manual_seed(4)
        self.rest = torch.nn.Parameter(torch.randn(n, 3, generator=seeded))
        self.velocity = torch.nn.Parameter(torch.randn(n, 3, generator=seeded))
        self.register_buffer("rotation", torch.randn(n, 4, generator=seeded))
        self.register_buffer("scale", 0.05 + 0.1 * torch.rand(n, 3, generator=seeded))
        self.register_buffer("opacity", 0.2 + 0.7 * torch.rand(n, 1, generator=seeded))
        self.register_buffer("sh", 0.2 * torch.randn(n, (degree + 1) ** 2, 3, generator=seeded))

    def forward(self, time: torch.Tensor) -> Gaussians:
        return Gaussians(
            position=self.rest + time * self.velocity,
            opacity=self.opacity,
            scale=self.scale,
            rotation=self.rotation,
            sh=self.sh,
        )


class Lit(GaussianGenerator):
    """View-dependent: a small network colours each Gaussian by the direction it is seen from."""

    inputs = (inputs.view(), inputs.projection())
    depends_on = {"projection": False}  # noqa: RUF012
    space = Space(matrix_order="row")

    def __init__(self, n: int = 64) -> None:
        super().__init__()
        seeded = torch.Generator().manual_seed(6)
        self.register_buffer("centre", torch.randn(n, 3, generator=seeded))
        self.net = torch.nn.Sequential(
            torch.nn.Linear(3, 16), torch.nn.ReLU(), torch.nn.Linear(16, 4)
        )
        self.register_buffer("covariance", torch.tensor([[0.01, 0, 0, 0.01, 0, 0.01]]).repeat(n, 1))

    def forward(self, view: torch.Tensor, proj: torch.Tensor) -> Gaussians:
        eye = -(view[:3, :3].T @ view[:3, 3])
        color = self.net(math.safe_normalize(self.centre - eye))
        opacity = 0.3 + 0.6 * torch.sigmoid(color[:, 3])
        return Gaussians(
            position=self.centre + 0 * proj[:1, :3],
            opacity=opacity,
            covariance=self.covariance,
            rgb=torch.sigmoid(color[:, :3]),
        )


class Growing(GaussianGenerator):
    """The number of live rows depends on time."""

    inputs = (inputs.time(),)

    def forward(self, time: torch.Tensor) -> Gaussians:
        n = 20
        line = torch.arange(n)[:, None] / n
        count = (5 + 10 * time).round()
        return Gaussians(
            position=torch.cat([line, line * 0, line * 0], dim=1) + 0.01 * time,
            opacity=torch.full((n,), 0.7),
            scale=torch.full((n, 3), 0.02),
            rotation=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
            rgb=torch.full((n, 3), 0.5),
            count=count.to(torch.int64),
        )


class Skinned(GaussianGenerator):
    """Two bones: a pose turns half of the Gaussians; a slider brightens all."""

    inputs = (
        inputs.pose(2),
        inputs.root_translation(),
        inputs.control("brightness", range=(0, 1), default=0.5),
    )
    family = "avatar"

    def __init__(self) -> None:
        super().__init__()
        line = torch.linspace(0, 1, 30)
        self.register_buffer("rest", torch.stack([line, 0.1 * line, line * 0], dim=1))
        self.register_buffer("weight", (line > 0.5).float()[:, None])

    def forward(
        self, pose: torch.Tensor, root: torch.Tensor, brightness: torch.Tensor
    ) -> Gaussians:
        angle = torch.sqrt((pose * pose).sum(dim=1, keepdim=True).clamp(min=1e-12))
        half = 0.5 * angle
        quaternion = torch.cat([torch.cos(half), torch.sin(half) * pose / angle], dim=1)
        bones = math.quaternion_to_matrix(quaternion)
        posed_points = self.rest @ bones[0].T
        bent = (self.rest - 0.5) @ bones[1].T + 0.5
        return Gaussians(
            position=posed_points * (1 - self.weight) + bent * self.weight + root,
            opacity=torch.full((30,), 0.9),
            scale=torch.full((30, 3), 0.03),
            rotation=torch.tensor([[1.0, 0, 0, 0]]).repeat(30, 1),
            rgb=0.2 + 0.8 * brightness * torch.ones(30, 3),
        )


CELLS, EACH = 8, 3
WEIGHTS = WeightedSum(background=0.1, depth_range=9.0, opacity_divisor=2.0)


class Bunches(GaussianGenerator):
    """Cells that drift; later ones are hidden early in time, with their Gaussians."""

    inputs = (inputs.time(),)
    weighted_sum = WEIGHTS
    count_semantics = "upper-bound"

    def __init__(self) -> None:
        super().__init__()
        seeded = torch.Generator().manual_seed(8)
        self.register_buffer("centre", torch.randn(CELLS, 3, generator=seeded))
        off = 0.1 * torch.randn(CELLS, EACH, 3, generator=seeded)
        self.register_buffer("offset", off.clamp(-0.2, 0.2))
        self.register_buffer("rotation", torch.randn(CELLS, 4, generator=seeded))
        self.register_buffer("scale", 0.2 + 0.1 * torch.rand(CELLS, 3, generator=seeded))
        self.register_buffer("rgb", torch.rand(CELLS * EACH, 3, generator=seeded))

    def forward(self, time: torch.Tensor) -> Gaussians:
        centre = self.centre + time * torch.tensor([0.3, 0.0, -0.2])
        shown = (self.centre[:, :1] < 1 + 4 * (time - 0.5)).to(torch.float32)
        opacity = 0.8 * shown.expand(CELLS, EACH)
        spread = self.scale[:, None].expand(CELLS, EACH, 3) / 3
        turned = self.rotation[:, None].expand(CELLS, EACH, 4)
        return Gaussians(
            position=(centre[:, None] + self.offset).reshape(-1, 3),
            opacity=opacity.reshape(-1),
            scale=spread.reshape(-1, 3),
            rotation=turned.reshape(-1, 4),
            rgb=self.rgb,
            cells=Cells(centre, shown * 0.75, self.scale, self.rotation),
        )
