"""Orders, masks and scatters: which rows are drawn, and what they gather from others."""

__all__ = ["MODULES"]

import torch
from torch import Tensor, nn

from gsgen.sdk import Gaussians, inputs
from sdk.exporting.authored.cloud import Cloud, N


class SortedByDepth(Cloud):
    """Gaussians in the order of their depth, as a renderer without a sort needs them."""

    inputs = (inputs.view(),)

    def forward(self, view: Tensor) -> Gaussians:
        depth = self.rest @ view[2, :3] + view[2, 3]
        return self.cloud().take(torch.argsort(depth))


class StrongestRows(Cloud):
    """The opacities change with time; the strongest half of the rows is drawn."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("phase", 6 * torch.rand(N))

    def forward(self, time: Tensor) -> Gaussians:
        opacity = self.opacity[:, 0] * (0.6 + 0.4 * torch.sin(self.phase + time))
        _, rows = torch.topk(opacity, N // 2)
        return self.cloud(opacity=opacity).take(rows)


class PooledByVoxel(Cloud):
    """Features of a voxel: the maximum over its points, by ``scatter_reduce``."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("voxel", torch.randint(8, (N,)))
        self.net = nn.Linear(4, 3)

    def forward(self, time: Tensor) -> Gaussians:
        features = self.net(torch.cat([self.rest, time.expand(N, 1)], dim=-1))
        index = self.voxel[:, None].expand(N, 3)
        pooled = torch.zeros(8, 3).scatter_reduce(0, index, features, "amax", include_self=False)
        return self.cloud(rgb=torch.sigmoid(pooled[self.voxel]))


class SummedByPart(Cloud):
    """The centroid of each part, by ``index_add``; Gaussians are drawn to it."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("part", torch.arange(N) % 6)

    def forward(self, time: Tensor) -> Gaussians:
        moved = self.rest * (1 + time)
        total = torch.zeros(6, 3).index_add(0, self.part, moved)
        return self.cloud(position=torch.lerp(moved, total[self.part] / 8, 0.5))


class RowsOverwritten(Cloud):
    """The dynamic rows of a still scene are written by ``index_put`` and by slices."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("dynamic", torch.randperm(N)[:10])

    def forward(self, time: Tensor) -> Gaussians:
        position, rgb = self.rest.clone(), self.rgb.clone()
        position[self.dynamic] = self.rest[self.dynamic] + torch.sin(time)
        rgb[:, 0] = 0.5 + 0.4 * torch.cos(time)
        return self.cloud(position=position, rgb=rgb)


class AccumulatedAlongRays(Cloud):
    """Weights of volume rendering: exclusive products of transparency along each ray."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("density", torch.rand(6, 8))

    def forward(self, time: Tensor) -> Gaussians:
        alpha = 1 - torch.exp(-self.density * (0.5 + time))
        transmittance = torch.cumprod(
            torch.cat([torch.ones(6, 1), 1 - alpha + 1e-10], dim=-1), dim=-1
        )
        return self.cloud(opacity=(alpha * transmittance[:, :-1]).reshape(-1, 1))


class LevelsByDistance(Cloud):
    """Octree-GS: ``bucketize`` picks the level of detail; rows of finer levels fade."""

    inputs = (inputs.camera_position(),)
    count_semantics = "upper-bound"

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("level", torch.randint(4, (N,)))
        self.register_buffer("edges", torch.tensor([1.0, 2.0, 4.0]))

    def forward(self, camera: Tensor) -> Gaussians:
        distance = torch.linalg.vector_norm(self.rest - camera, dim=-1)
        level_index = 3 - torch.bucketize(distance, self.edges)
        return self.cloud(opacity=self.opacity[:, 0] * (self.level <= level_index).float())


MODULES = (
    SortedByDepth,
    StrongestRows,
    PooledByVoxel,
    SummedByPart,
    RowsOverwritten,
    AccumulatedAlongRays,
    LevelsByDistance,
)
