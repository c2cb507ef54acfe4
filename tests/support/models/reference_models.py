"""Small torch models shaped like the published methods: what a rewritten graph must capture."""

from itertools import pairwise

import torch
from torch import nn

from gsgen.sdk import GaussianGenerator, Gaussians, inputs, math


def _mlp(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(sizes):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class ScaffoldDecoder(GaussianGenerator):
    """Scaffold-GS (arXiv 2312.00109, sec. 4): anchors spawn Gaussians by three view-dependent MLPs.

    Opacity, colour and covariance of ``offsets`` Gaussians an anchor come from its feature, and
    from the direction and distance that it is seen from.
    """

    inputs = (inputs.view(), inputs.projection())
    family = "mlp"
    depends_on = {"projection": False}  # noqa: RUF012

    def __init__(self, anchors: int = 24, offsets: int = 10, features: int = 32) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(11)
            self.anchor = nn.Parameter(torch.randn(anchors, 3))
            self.offset = nn.Parameter(0.1 * torch.randn(anchors, offsets, 3))
            self.scaling = nn.Parameter(0.3 * torch.randn(anchors, 6) - 3)
            self.feature = nn.Parameter(torch.randn(anchors, features))
            width = features + 4
            self.opacity = nn.Sequential(_mlp(width, features, offsets), nn.Tanh())
            self.color = nn.Sequential(_mlp(width, features, 3 * offsets), nn.Sigmoid())
            self.covariance = _mlp(width, features, 7 * offsets)
        self.offsets = offsets

    def forward(self, view: torch.Tensor, proj: torch.Tensor) -> Gaussians:
        eye = -(view[:3, :3] @ view[3, :3])  # the tensor holds the transposed matrix
        view_offset = self.anchor - eye
        distance = view_offset.norm(dim=1, keepdim=True)
        code = torch.cat([self.feature, view_offset / distance, distance], dim=1)
        k = self.offsets
        result = self.covariance(code).reshape(-1, 7)
        scaling = torch.exp(self.scaling)[:, None].expand(-1, k, -1).reshape(-1, 6)
        center = self.anchor[:, None].expand(-1, k, -1).reshape(-1, 3)
        return Gaussians(
            position=center + self.offset.reshape(-1, 3) * scaling[:, :3],
            opacity=self.opacity(code).reshape(-1, 1).clamp(min=0),
            scale=scaling[:, 3:] * torch.sigmoid(result[:, :3]),
            rotation=nn.functional.normalize(result[:, 3:]),
            rgb=self.color(code).reshape(-1, 3),
        )


class HexPlane(GaussianGenerator):
    """4D-GS (arXiv 2310.08528, sec. 4.2): six feature planes and small heads move the Gaussians."""

    inputs = (inputs.time(),)
    family = "4d"

    def __init__(self, n: int = 60, channels: int = 8, size: int = 12) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(12)
            self.center = nn.Parameter(torch.rand(n, 3) * 2 - 1)
            self.log_scale = nn.Parameter(0.2 * torch.randn(n, 3) - 3)
            self.rotation = nn.Parameter(torch.randn(n, 4))
            self.logit = nn.Parameter(torch.randn(n, 1))
            self.sh = nn.Parameter(0.2 * torch.randn(n, 16, 3))
            self.planes = nn.ParameterList(
                1 + 0.1 * torch.randn(1, channels, size, size) for _ in range(6)
            )
            self.trunk = nn.Sequential(nn.Linear(channels, 64), nn.ReLU())
            self.heads = nn.ModuleList(_mlp(64, 64, out) for out in (3, 3, 4, 1, 48))

    def forward(self, time: torch.Tensor) -> Gaussians:
        n = len(self.center)
        where = torch.cat([self.center, (2 * time - 1).expand(n, 1)], dim=1)
        pairs = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))
        feature = torch.ones(())
        for plane, (a, b) in zip(self.planes, pairs, strict=True):
            grid = where[:, (a, b)].reshape(1, -1, 1, 2)
            sampled = nn.functional.grid_sample(plane, grid, align_corners=True)
            feature = feature * sampled.reshape(plane.shape[1], n).T
        hidden = self.trunk(feature)
        move, scale, turn, fade, sh = (head(hidden) for head in self.heads)
        return Gaussians(
            position=self.center + 0.1 * move,
            opacity=torch.sigmoid(self.logit + fade),
            scale=torch.exp(self.log_scale + 0.1 * scale),
            rotation=nn.functional.normalize(self.rotation + 0.1 * turn),
            sh=self.sh + 0.1 * sh.reshape(n, 16, 3),
        )


class Avatar(GaussianGenerator):
    """Linear blend skinning in the manner of SMPL (Loper et al. 2015, eqs. 2 to 4), with a chain.

    Every joint's rotation comes from an axis and an angle by Rodrigues' formula, and is multiplied
    along the chain of its parents.
    """

    inputs = (inputs.pose(6), inputs.root_translation())
    family = "avatar"

    def __init__(self, n: int = 60, joints: int = 6) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(13)
            self.rest = nn.Parameter(torch.rand(n, 3))
            self.weight = nn.Parameter(torch.softmax(3 * torch.randn(n, joints), dim=1))
            self.joint = nn.Parameter(torch.cumsum(0.2 * torch.rand(joints, 3), dim=0))
            self.root = nn.Parameter(torch.randn(n, 3))
        self.parents = [-1, 0, 1, 1, 3, 0]

    def forward(self, pose: torch.Tensor, root: torch.Tensor) -> Gaussians:
        angle = torch.sqrt((pose * pose).sum(dim=1, keepdim=True).clamp(min=1e-12))
        axis = pose / angle
        zero = torch.zeros_like(axis[:, 0])
        x, y, z = axis.unbind(1)
        cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)
        sine, cosine = torch.sin(angle)[..., None], torch.cos(angle)[..., None]
        turn = torch.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)
        rotations, places = [turn[0]], [self.joint[0]]
        for index, parent in enumerate(self.parents[1:], 1):
            rotations.append(rotations[parent] @ turn[index])
            step = rotations[parent] @ (self.joint[index] - self.joint[parent])
            places.append(places[parent] + step)
        rotation = torch.stack(rotations)
        translation = torch.stack(places) - (rotation @ self.joint[..., None])[..., 0]
        blended = torch.einsum("nj,jab->nab", self.weight, rotation)
        moved = (blended @ self.rest[..., None])[..., 0] + self.weight @ translation
        base = torch.diag(torch.tensor([4e-4, 1e-4, 9e-4]))
        covariance = blended @ base @ blended.transpose(1, 2)
        upper = covariance.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
        return Gaussians(
            position=moved + root,
            opacity=torch.full((len(self.rest),), 0.9),
            covariance=upper,
            rgb=torch.sigmoid(self.root),
        )


class Denoiser(nn.Module):
    """A U-Net with a time embedding, group norms and skips (DDPM, arXiv 2006.11239, appendix B)."""

    def __init__(self, width: int = 4) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(14)
            self.embed = nn.Sequential(nn.Linear(8, width), nn.SiLU(), nn.Linear(width, width))
            self.enter = nn.Conv2d(3, width, 3, padding=1)
            self.down = nn.Conv2d(width, 2 * width, 3, stride=2, padding=1)
            self.middle = nn.Conv2d(2 * width, 2 * width, 3, padding=1)
            self.up = nn.Conv2d(3 * width, width, 3, padding=1)
            self.leave = nn.Conv2d(width, 3, 3, padding=1)
            self.norms = nn.ModuleList(nn.GroupNorm(2, size) for size in (width, 2 * width, width))
        self.register_buffer("frequency", 2.0 ** torch.arange(4))

    def forward(self, image: torch.Tensor, timestep: torch.Tensor) -> torch.Tensor:
        angle = timestep.to(torch.float32) * 0.001 * self.frequency
        embedding = self.embed(torch.cat([torch.sin(angle), torch.cos(angle)])[None])
        skip = nn.functional.silu(self.norms[0](self.enter(image)))
        skip = skip + embedding[:, :, None, None]
        deep = nn.functional.silu(self.norms[1](self.down(skip)))
        deep = deep + self.middle(deep)
        upsampled = nn.functional.interpolate(deep, scale_factor=2.0, mode="nearest")
        joined = self.up(torch.cat([upsampled, skip], dim=1))
        return image - self.leave(nn.functional.silu(self.norms[2](joined)))


def rotation_of(pose: torch.Tensor) -> torch.Tensor:
    """Return what :class:`Avatar` should turn a joint by, by another way: a quaternion."""
    angle = pose.norm().clamp(min=1e-12)
    half = angle / 2
    quaternion = torch.cat([torch.cos(half)[None], torch.sin(half) * pose / angle])
    return math.quaternion_to_matrix(quaternion[None])[0]
