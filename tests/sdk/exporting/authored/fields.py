"""Feature grids: planes, volumes, hash tables, textures and maps of decoders."""

__all__ = ["MODULES"]

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the name that every method uses

from gsgen.sdk import Gaussians, math
from sdk.exporting.authored.cloud import Cloud, N

_PRIMES = (1, 2654435761, 805459861)


class HexPlaneSampled(Cloud):
    """4DGaussians: six planes of space and time, each read by ``grid_sample``."""

    PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))

    def __init__(self) -> None:
        super().__init__()
        self.planes = nn.ParameterList(0.5 + torch.rand(1, 8, 8, 8) for _ in self.PAIRS)
        self.head = nn.Sequential(nn.ReLU(), nn.Linear(8, 32), nn.ReLU(), nn.Linear(32, 3))

    def forward(self, time: Tensor) -> Gaussians:
        moment = (2 * time - 1).repeat(N, 1)
        points = torch.cat([self.rest / 3, moment], dim=-1)
        features: Tensor | float = 1.0
        for plane, pair in zip(self.planes, self.PAIRS, strict=True):
            grid = points[:, list(pair)].view(1, 1, N, 2)
            sampled = F.grid_sample(plane, grid, align_corners=True, padding_mode="border")
            features = features * sampled.view(8, N).T
        return self.cloud(position=self.rest + 0.1 * self.head(features))


class SkinningVolume(Cloud):
    """fast-SNARF: skinning weights are read from a volume by 3-D ``grid_sample``."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("volume", torch.rand(1, 6, 8, 8, 8))
        self.register_buffer("offsets", torch.randn(6, 3))

    def forward(self, time: Tensor) -> Gaussians:
        moved = self.rest + 0.2 * torch.sin(time)
        grid = (moved / 3).view(1, 1, 1, N, 3)
        weights = F.grid_sample(self.volume, grid, padding_mode="border", align_corners=True)
        weights = torch.softmax(4 * weights.view(6, N).T, dim=-1)
        return self.cloud(position=moved + weights @ (time * self.offsets))


class WideHashGrid(Cloud):
    """Instant-NGP's spatial hash as PyTorch ports write it: int64, primes, exclusive or."""

    def __init__(self) -> None:
        super().__init__()
        self.table = nn.Parameter(torch.randn(3, 512, 2))
        self.register_buffer("primes", torch.tensor(_PRIMES))
        self.head = nn.Linear(6, 3)

    def forward(self, time: Tensor) -> Gaussians:
        unit = torch.sigmoid(self.rest + time)
        features = []
        for level, resolution in enumerate((8, 13, 21)):
            cell = (unit * resolution).floor().to(torch.int64)
            mixed = cell * self.primes
            index = (mixed[:, 0] ^ mixed[:, 1] ^ mixed[:, 2]) % 512
            features.append(self.table[level][index])
        return self.cloud(rgb=torch.sigmoid(self.head(torch.cat(features, dim=-1))))


class NarrowHashGrid(Cloud):
    """A dense grid of a few cells, indexed in int32 to save memory."""

    def __init__(self) -> None:
        super().__init__()
        self.table = nn.Parameter(torch.randn(8, 8, 8, 3))

    def forward(self, time: Tensor) -> Gaussians:
        cell = (torch.sigmoid(self.rest + time) * 8).to(torch.int32).clamp(0, 7)
        color = self.table[cell[:, 0], cell[:, 1], cell[:, 2]]
        return self.cloud(rgb=torch.sigmoid(color))


class HashGridOfTheSdk(Cloud):
    """``math.hash_grid``: trilinear samples of a multiresolution hash grid in 32 bits."""

    def __init__(self) -> None:
        super().__init__()
        self.tables = nn.ParameterList(torch.randn(512, 2) for _ in range(3))
        self.head = nn.Linear(6, 3)

    def forward(self, time: Tensor) -> Gaussians:
        unit = torch.sigmoid(self.rest + time)
        features = math.hash_grid(list(self.tables), unit, (4, 8, 16))
        return self.cloud(rgb=torch.sigmoid(self.head(features)))


class UvTextureDecoder(Cloud):
    """Animatable Gaussians: a convolutional decoder paints a map, read at constant texels."""

    def __init__(self) -> None:
        super().__init__()
        self.code = nn.Parameter(torch.randn(1, 8, 4, 4))
        self.first, self.second = nn.Conv2d(8, 8, 3, padding=1), nn.Conv2d(8, 12, 3, padding=1)
        self.register_buffer("texel", torch.randperm(16 * 16)[:N])

    def forward(self, time: Tensor) -> Gaussians:
        image = F.interpolate(self.code * (1 + time), scale_factor=2, mode="nearest")
        image = F.leaky_relu(self.first(image), 0.2)
        image = F.pixel_shuffle(self.second(image), 2)
        features = image.flatten(2)[0].T[self.texel]
        return self.cloud(position=self.rest + 0.1 * features)


MODULES = (
    HexPlaneSampled,
    SkinningVolume,
    WideHashGrid,
    NarrowHashGrid,
    HashGridOfTheSdk,
    UvTextureDecoder,
)
