"""Thirty generators as the authors of methods write them, of own code: bench_authors_modules.py.

Each docstring names the method whose way of writing it follows.
"""

__all__ = ["MODULES", "Cloud"]

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gsgen.sdk import GaussianGenerator, Gaussians, inputs

N = 10_000
_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]


def inverse_sigmoid(x: Tensor) -> Tensor:
    return torch.log(x / (1 - x))


def build_rotation(r: Tensor) -> Tensor:
    """As 3DGS's general_utils: a matrix that is filled by element."""
    q = r / torch.sqrt(r[:, 0] ** 2 + r[:, 1] ** 2 + r[:, 2] ** 2 + r[:, 3] ** 2)[:, None]
    matrix = torch.zeros((q.size(0), 3, 3), device=r.device)
    w, x, y, z = q[:, 0], q[:, 1], q[:, 2], q[:, 3]
    matrix[:, 0, 0], matrix[:, 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z)
    matrix[:, 0, 2], matrix[:, 1, 0] = 2 * (x * z + w * y), 2 * (x * y + w * z)
    matrix[:, 1, 1], matrix[:, 1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    matrix[:, 2, 0], matrix[:, 2, 1] = 2 * (x * z - w * y), 2 * (y * z + w * x)
    matrix[:, 2, 2] = 1 - 2 * (x * x + y * y)
    return matrix


def batch_rodrigues(vectors: Tensor) -> Tensor:
    """As smplx.lbs: rotations of axis angles, by a skew-symmetric matrix."""
    angle = torch.norm(vectors + 1e-8, dim=1, keepdim=True)
    axis = vectors / angle
    cosine, sine = torch.cos(angle)[:, None], torch.sin(angle)[:, None]
    x, y, z = torch.split(axis, 1, dim=1)
    zeros = torch.zeros((len(vectors), 1))
    skew = torch.cat([zeros, -z, y, z, zeros, -x, -y, x, zeros], dim=1).view(-1, 3, 3)
    return torch.eye(3)[None] + sine * skew + (1 - cosine) * torch.bmm(skew, skew)


def batch_rigid_transform(rotations: Tensor, joints: Tensor, parents: Tensor) -> Tensor:
    """As smplx.lbs: the kinematic chain, with parents in a buffer."""
    relative = joints.clone()
    relative[1:] -= joints[parents[1:]]
    local = torch.cat([functional.pad(rotations, [0, 0, 0, 1]),
                       functional.pad(relative[..., None], [0, 0, 0, 1], value=1)], dim=2)  # fmt: skip
    chain = [local[0]]
    for i in range(1, parents.shape[0]):
        chain.append(torch.matmul(chain[parents[i]], local[i]))
    transforms = torch.stack(chain)
    rest = functional.pad(joints[..., None], [0, 0, 0, 1])
    return transforms - functional.pad(torch.matmul(transforms, rest), [3, 0])


def positional_encoding(x: Tensor, bands: int) -> Tensor:
    parts = [x]
    for frequency in 2.0 ** np.linspace(0, bands - 1, bands):
        for function in (torch.sin, torch.cos):
            parts.append(function(x * frequency))
    return torch.cat(parts, -1)


def matrix_to_quaternion(matrix: Tensor) -> Tensor:
    """As pytorch3d: the best of four candidates, selected by a mask of one True a row."""
    m = [matrix[..., i, j] for i in range(3) for j in range(3)]
    squares = torch.stack([1 + m[0] + m[4] + m[8], 1 + m[0] - m[4] - m[8],
                           1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8]], -1)  # fmt: skip
    q_abs = torch.sqrt(functional.relu(squares) + 1e-12)
    by_rijk = torch.stack(
        [
            torch.stack([q_abs[..., 0] ** 2, m[7] - m[5], m[2] - m[6], m[3] - m[1]], -1),
            torch.stack([m[7] - m[5], q_abs[..., 1] ** 2, m[3] + m[1], m[2] + m[6]], -1),
            torch.stack([m[2] - m[6], m[3] + m[1], q_abs[..., 2] ** 2, m[5] + m[7]], -1),
            torch.stack([m[3] - m[1], m[6] + m[2], m[7] + m[5], q_abs[..., 3] ** 2], -1),
        ],
        -2,
    )
    candidates = by_rijk / (2 * q_abs[..., None].max(torch.tensor(0.1)))
    chosen = functional.one_hot(q_abs.argmax(dim=-1), num_classes=4) > 0.5
    return candidates[chosen, :].reshape(matrix.shape[0], 4)


class Cloud(GaussianGenerator):
    """The parameters of 3DGS, with their activations as properties."""

    inputs: Any = (inputs.time(),)
    capacity: int | None = None  # of a module whose frames have different numbers of Gaussians

    def __init__(self, n: int = N) -> None:
        super().__init__()
        torch.manual_seed(0)
        self._xyz = nn.Parameter(torch.rand(n, 3) * 2 - 1)
        self._scaling = nn.Parameter(torch.randn(n, 3) * 0.3 - 4)
        self._rotation = nn.Parameter(torch.randn(n, 4))
        self._opacity = nn.Parameter(inverse_sigmoid(0.1 + 0.8 * torch.rand(n, 1)))
        self._features_dc = nn.Parameter(torch.randn(n, 1, 3) * 0.3)
        self._features_rest = nn.Parameter(torch.randn(n, 3, 3) * 0.1)

    @property
    def get_scaling(self) -> Tensor:
        return torch.exp(self._scaling)

    @property
    def get_rotation(self) -> Tensor:
        return functional.normalize(self._rotation)

    def cloud(self, xyz: Tensor | None = None, **fields: Tensor) -> Gaussians:
        """Return the Gaussians with some fields replaced."""
        known = {
            "position": self._xyz if xyz is None else xyz,
            "opacity": torch.sigmoid(self._opacity),
            "scale": self.get_scaling,
            "rotation": self.get_rotation,
        }
        if "rgb" not in fields:
            known["sh"] = torch.cat([self._features_dc, self._features_rest], dim=1)
        return Gaussians(**(known | fields))


def mlp(*widths: int, end: nn.Module | None = None) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in zip(widths, widths[1:], strict=False):  # noqa: RUF007
        layers += [nn.Linear(a, b), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers[:-1], *([end] if end is not None else []))


class DeformNetwork(Cloud):
    """Deformable 3DGS: eight layers of 256, the encoding again after the fourth."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.ModuleList(
            [nn.Linear(84, 64)] + [nn.Linear(64 + (84 if i == 3 else 0), 64) for i in range(7)]
        )
        self.warp, self.turn, self.scale = nn.Linear(64, 3), nn.Linear(64, 4), nn.Linear(64, 3)

    def forward(self, time: Tensor) -> Gaussians:
        t = time.unsqueeze(0).expand(self._xyz.shape[0], -1)
        encoded = torch.cat(
            [positional_encoding(self._xyz.detach(), 10), positional_encoding(t, 10)], -1
        )
        h = encoded
        for i, layer in enumerate(self.linear):
            h = functional.relu(layer(h))
            if i == 3:
                h = torch.cat([encoded, h], -1)
        return self.cloud(
            self._xyz + 0.01 * self.warp(h),
            rotation=functional.normalize(self._rotation + self.turn(h)),
            scale=torch.exp(self._scaling + 0.1 * self.scale(h)),
        )


class HexPlanes(Cloud):
    """4DGaussians: six planes by grid_sample, multiplied; heads that flags switch off."""

    def __init__(self) -> None:
        super().__init__()
        self.grids = nn.ParameterList(nn.Parameter(torch.rand(1, 16, 32, 32)) for _ in range(6))
        self.register_buffer("aabb", torch.tensor([[1.0] * 3, [-1.0] * 3]))
        self.feature, self.pos = mlp(16, 64), mlp(64, 64, 3)
        self.no_ds = self.no_do = True

    def forward(self, time: Tensor) -> Gaussians:
        points = (self._xyz - self.aabb[0]) * (2.0 / (self.aabb[1] - self.aabb[0])) - 1.0
        points = torch.cat([points, time.repeat(points.shape[0], 1) * 2 - 1], dim=-1)
        interpolated: Any = 1.0
        for grid, (a, b) in zip(
            self.grids, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)], strict=True
        ):
            coordinates = points[..., (a, b)].view([1] + [1] * 1 + [-1, 2])
            sampled = functional.grid_sample(
                grid, coordinates, align_corners=True, padding_mode="border"
            )
            interpolated = interpolated * sampled.view(1, 16, -1).transpose(-1, -2).squeeze()
        hidden = functional.relu(self.feature(interpolated))
        mask = torch.ones_like(self._opacity[:, 0]).unsqueeze(-1)
        scales = self._scaling if self.no_ds else self._scaling * mask
        return self.cloud(self._xyz * mask + 0.05 * self.pos(hidden), scale=torch.exp(scales))


class TemporalBasis(Cloud):
    """SpacetimeGaussians: a radial basis in time, and polynomials."""

    def __init__(self) -> None:
        super().__init__()
        self._trbf_center = nn.Parameter(torch.rand(N, 1))
        self._trbf_scale = nn.Parameter(torch.rand(N, 1))
        self._motion, self._omega = (
            nn.Parameter(torch.randn(N, 9) * 0.1),
            nn.Parameter(torch.randn(N, 4) * 0.1),
        )

    def forward(self, time: Tensor) -> Gaussians:
        tforpoly = time - self._trbf_center.detach()
        distance = tforpoly / torch.exp(self._trbf_scale)
        opacity = torch.sigmoid(self._opacity) * torch.exp(-1 * distance.pow(2))
        means = (self._xyz + self._motion[:, 0:3] * tforpoly + self._motion[:, 3:6] * tforpoly**2
                 + self._motion[:, 6:9] * tforpoly * tforpoly * tforpoly)  # fmt: skip
        rotation = functional.normalize(self._rotation + tforpoly * self._omega)
        return self.cloud(means, opacity=opacity, rotation=rotation)


class PerGaussianEmbedding(Cloud):
    """E-D3DGS: embeddings of Gaussians and of time, and the mean of the offsets that are not 0."""

    def __init__(self) -> None:
        super().__init__()
        self.embedding, self.weight = (
            nn.Parameter(torch.randn(N, 16)),
            nn.Parameter(torch.randn(1, 24, 1, 16)),
        )
        offsets = torch.zeros(30, 1)
        offsets[3], offsets[5] = 0.01, -0.02
        self.offsets, self.net = nn.Parameter(offsets), mlp(40, 64, 64, 10)

    def forward(self, time: Tensor) -> Gaussians:
        offset = torch.masked_select(self.offsets, self.offsets.ne(0)).mean()
        offset[torch.isnan(offset)] = 0
        grid = torch.cat([torch.zeros(1), (time + offset) * 2 - 1]).reshape(1, 1, 1, 2)
        sampled = functional.grid_sample(
            self.weight.permute(0, 1, 3, 2),
            grid,
            mode="bilinear",
            padding_mode="reflection",
            align_corners=True,
        )
        feature = torch.cat([self.embedding, sampled.reshape(1, 24).repeat(N, 1)], 1)
        moved, turned, scaled = self.net(feature).split([3, 4, 3], 1)
        return self.cloud(
            self._xyz + 0.02 * moved,
            rotation=functional.normalize(self._rotation + turned),
            scale=torch.exp(self._scaling + 0.1 * scaled),
        )


class ControlPoints(Cloud):
    """SC-GS: the nearest of 128 nodes by cdist in forward, weights by their radius."""

    def __init__(self) -> None:
        super().__init__()
        self.nodes, self._node_radius = (
            nn.Parameter(torch.rand(128, 3) * 2 - 1),
            nn.Parameter(torch.zeros(128)),
        )
        self.net = mlp(3 + 13, 64, 6)

    def forward(self, time: Tensor) -> Gaussians:
        dists, idxs = torch.topk(torch.cdist(self._xyz, self.nodes) ** 2, 3, dim=1, largest=False)
        weight = torch.exp(-dists / (2 * torch.exp(self._node_radius)[idxs] ** 2)) + 1e-7
        weight = weight / weight.sum(dim=-1, keepdim=True)
        out = self.net(torch.cat([self.nodes, positional_encoding(time, 6).expand(128, -1)], -1))
        rotations = batch_rodrigues(0.1 * out[:, 3:])
        local = self._xyz[:, None] - self.nodes[idxs]
        moved = (
            torch.einsum("nkab,nkb->nka", rotations[idxs], local)
            + self.nodes[idxs]
            + 0.05 * out[idxs, :3]
        )
        return self.cloud((weight[..., None] * moved).sum(1))


class NeuralAnchors(Cloud):
    """Scaffold-GS: anchors decode Gaussians by view; those of an opacity above 0 are kept."""

    inputs = (inputs.camera_position(),)
    count_semantics = "exact"
    capacity = 10_000

    def __init__(self) -> None:
        super().__init__(1)
        self.anchor, self._anchor_feat = (
            nn.Parameter(torch.rand(2000, 3) * 2 - 1),
            nn.Parameter(torch.randn(2000, 32)),
        )
        self._offset, self.scaling = (
            nn.Parameter(torch.randn(2000, 5, 3) * 0.1),
            nn.Parameter(torch.randn(2000, 6) * 0.1 - 3),
        )
        self.mlp_opacity, self.mlp_cov, self.mlp_color = (
            mlp(36, 32, 5, end=nn.Tanh()),
            mlp(36, 32, 35),
            mlp(36, 32, 15, end=nn.Sigmoid()),
        )

    def forward(self, camera: Tensor) -> Gaussians:
        ob_view = self.anchor - camera
        ob_dist = ob_view.norm(dim=1, keepdim=True)
        feature = torch.cat([self._anchor_feat, ob_view / ob_dist, ob_dist], dim=1)
        neural_opacity = self.mlp_opacity(feature).reshape([-1, 1])
        mask = (neural_opacity > 0.0).view(-1)
        opacity = neural_opacity[mask]
        color = self.mlp_color(feature).reshape([-1, 3])
        scale_rot = self.mlp_cov(feature).reshape([-1, 7])
        concatenated = torch.cat([torch.exp(self.scaling), self.anchor], dim=-1)
        repeated = concatenated.unsqueeze(1).repeat(1, 5, 1).view(-1, 9)
        combined = torch.cat([repeated, color, scale_rot, self._offset.view(-1, 3)], dim=-1)
        scaling_repeat, anchor_repeat, color, scale_rot, offsets = combined[mask].split(
            [6, 3, 3, 7, 3], dim=-1
        )
        return Gaussians(
            anchor_repeat + offsets * scaling_repeat[:, :3], opacity,
            scaling_repeat[:, 3:] * torch.sigmoid(scale_rot[:, :3]), functional.normalize(scale_rot[:, 3:7]), rgb=color,
        )  # fmt: skip


class LevelsOfDetail(Cloud):
    """Octree-GS: the level of a distance; finer ones are hidden by a mask."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("_level", torch.randint(5, (N, 1)))
        self.register_buffer("_extra_level", torch.rand(N))
        self.standard_dist, self.fork, self.levels = 4.0, 2, 5

    def forward(self, camera: Tensor) -> Gaussians:
        dist = torch.sqrt(torch.sum((self._xyz - camera) ** 2, dim=1))
        pred = torch.log2(self.standard_dist / dist) / math.log2(self.fork) + self._extra_level
        int_level = torch.clamp(torch.round(pred).int(), min=0, max=self.levels - 1)
        visible = self._level.squeeze(dim=1) <= int_level
        return self.cloud(opacity=torch.sigmoid(self._opacity) * visible.unsqueeze(-1).float())


class BodyTemplate(Cloud):
    """GART: the kinematic chain of smplx and blended transforms."""

    inputs = (inputs.pose(24),)

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("parents", torch.tensor(_PARENTS))
        self.register_buffer("joints", torch.randn(24, 3) * 0.3)
        self.register_buffer("weights", torch.softmax(3 * torch.randn(N, 24), 1))

    def forward(self, pose: Tensor) -> Gaussians:
        transforms = batch_rigid_transform(batch_rodrigues(pose), self.joints, self.parents)
        blended = torch.einsum("nj,jab->nab", self.weights, transforms)
        xyz = torch.einsum("nab,nb->na", blended[:, :3, :3], self._xyz) + blended[:, :3, 3]
        turned = matrix_to_quaternion(blended[:, :3, :3] @ build_rotation(self._rotation))
        return self.cloud(xyz, rotation=turned)


class TriplaneBody(Cloud):
    """HUGS: a tri-plane, decoders of appearance and geometry, rotations by pytorch3d."""

    inputs = (inputs.pose(24),)

    def __init__(self) -> None:
        super().__init__()
        self.planes = nn.ParameterList(nn.Parameter(torch.randn(1, 8, 64, 64)) for _ in range(3))
        self.decoder, self.register = mlp(24, 64, 64, end=nn.GELU()), None
        self.heads = nn.ModuleDict(
            {"xyz": nn.Linear(64, 3), "rot6d": nn.Linear(64, 6), "lbs": nn.Linear(64, 24)}
        )
        self.register_buffer("parents", torch.tensor(_PARENTS))
        self.register_buffer("joints", torch.randn(24, 3) * 0.3)

    def forward(self, pose: Tensor) -> Gaussians:
        x = self._xyz.clamp(-1, 1)
        samples = [
            functional.grid_sample(
                plane, x[:, list(axes)][None, None], mode="bilinear", align_corners=True
            )[0, :, 0].T
            for plane, axes in zip(self.planes, [(0, 1), (0, 2), (1, 2)], strict=True)
        ]
        hidden = self.decoder(torch.cat(samples, 1))
        weights = functional.softmax(self.heads["lbs"](hidden) / 0.1, dim=-1)
        a1, a2 = self.heads["rot6d"](hidden).split(3, -1)
        b1 = functional.normalize(a1, dim=-1)
        b2 = functional.normalize(a2 - (b1 * a2).sum(-1, keepdim=True) * b1, dim=-1)
        rotmat = torch.stack((b1, b2, torch.cross(b1, b2, dim=-1)), dim=-2)
        transforms = batch_rigid_transform(batch_rodrigues(pose), self.joints, self.parents)
        blended = (weights @ transforms.reshape(24, 16)).reshape(-1, 4, 4)
        homogeneous = torch.cat([x + 0.01 * self.heads["xyz"](hidden), torch.ones(N, 1)], -1)
        posed = (blended @ homogeneous.unsqueeze(-1))[:, :3, 0]
        return self.cloud(posed, rotation=matrix_to_quaternion(blended[:, :3, :3] @ rotmat))


class FaceBound(Cloud):
    """GaussianAvatars: Gaussians in the frames of FLAME's triangles, with expressions."""

    inputs = (inputs.expression(20),)

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("v_template", torch.randn(500, 3) * 0.3)
        self.register_buffer("exprdirs", torch.randn(500, 3, 20) * 0.02)
        self.register_buffer("faces", torch.stack([torch.randperm(500)[:3] for _ in range(900)]))
        self.register_buffer("binding", torch.randint(900, (N,)))

    def forward(self, expression: Tensor) -> Gaussians:
        verts = self.v_template + torch.einsum("l,vkl->vk", expression, self.exprdirs)
        v0, v1, v2 = (verts[self.faces[:, i]] for i in range(3))
        a0 = functional.normalize(v1 - v0, dim=-1, eps=1e-6)
        a1 = functional.normalize(torch.cross(a0, v2 - v0, dim=-1), dim=-1, eps=1e-6)
        a2 = -functional.normalize(torch.cross(a1, a0, dim=-1), dim=-1, eps=1e-6)
        orientation = torch.stack([a0, a1, a2], dim=-1)
        s0 = (v1 - v0).norm(dim=-1, keepdim=True)
        s1 = (a2 * (v2 - v0)).sum(-1, keepdim=True).abs()
        scaling = (s0 + s1) / 2
        xyz = torch.bmm(orientation[self.binding], self._xyz[..., None]).squeeze(-1)
        xyz = xyz * scaling[self.binding] + ((v0 + v1 + v2) / 3)[self.binding]
        rotation = matrix_to_quaternion(orientation[self.binding] @ build_rotation(self._rotation))
        return self.cloud(xyz, rotation=rotation, scale=self.get_scaling * scaling[self.binding])


class EmbeddedOnMesh(Cloud):
    """SplattingAvatar: barycentric embedding, normals of vertices by index_add."""

    inputs = (inputs.expression(10),)

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("verts", torch.randn(600, 3) * 0.4)
        self.register_buffer("dirs", torch.randn(10, 600, 3) * 0.02)
        self.register_buffer("faces", torch.stack([torch.randperm(600)[:3] for _ in range(1000)]))
        self.register_buffer("sample_fidxs", torch.randint(1000, (N,)))
        self.register_buffer("sample_bary", torch.softmax(torch.randn(N, 3), 1))

    def forward(self, expression: Tensor) -> Gaussians:
        verts = self.verts + torch.tensordot(expression, self.dirs, dims=1)
        triangles = verts[self.faces]
        face_normals = torch.cross(
            triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0], dim=-1
        )
        normals = torch.zeros_like(verts)
        for corner in range(3):
            normals = normals.index_add(0, self.faces[:, corner], face_normals)
        normals = functional.normalize(normals, eps=1e-6, dim=1)
        picked = self.faces[self.sample_fidxs]
        base = (verts[picked] * self.sample_bary[..., None]).sum(dim=1)
        normal = functional.normalize(
            (normals[picked] * self.sample_bary[..., None]).sum(1), dim=-1
        )
        return self.cloud(base + 0.05 * self._xyz[:, 2:] * normal)


class HeadRegions(Cloud):
    """Gaussian-Head-Avatar: near and far regions are written by constant masks."""

    inputs = (inputs.expression(16), inputs.pose(1, convention="axis-angle"))

    def __init__(self) -> None:
        super().__init__()
        self.exp_deform_mlp, self.pose_deform_mlp = (
            mlp(43, 64, 3, end=nn.Tanh()),
            mlp(30, 64, 3, end=nn.Tanh()),
        )
        self.register_buffer("dists", torch.rand(N, 1) * 0.4)
        self.dist_threshold_near, self.dist_threshold_far = 0.1, 0.2

    def forward(self, expression: Tensor, pose: Tensor) -> Gaussians:
        encoded = positional_encoding(self._xyz, 4)
        exp_weights = torch.clamp(
            (self.dist_threshold_far - self.dists)
            / (self.dist_threshold_far - self.dist_threshold_near),
            0.0,
            1.0,
        )
        near = (self.dists < self.dist_threshold_far).squeeze(-1)
        far = (self.dists > self.dist_threshold_near).squeeze(-1)
        delta = torch.zeros_like(self._xyz)
        condition = expression[None].repeat(N, 1)
        delta[near] += (
            self.exp_deform_mlp(torch.cat([encoded[near], condition[near]], 1)) * exp_weights[near]
        )
        angles = pose.reshape(1, 3).repeat(N, 1)
        delta[far] += self.pose_deform_mlp(torch.cat([encoded[far], angles[far]], 1)) * (
            1 - exp_weights[far]
        )
        return self.cloud(self._xyz + 0.1 * delta)


class BlendShapeHead(Cloud):
    """MonoGaussianAvatar: blend shapes and skinning weights of a network."""

    inputs = (inputs.expression(20), inputs.pose(5, convention="flame"))

    def __init__(self) -> None:
        super().__init__()
        self.net = mlp(27, 64, 64, 60 + 5)
        self.register_buffer("joints", torch.randn(5, 3) * 0.1)
        self.register_buffer("parents", torch.tensor([-1, 0, 1, 1, 1]))

    def forward(self, expression: Tensor, pose: Tensor) -> Gaussians:
        out = self.net(positional_encoding(self._xyz, 4))
        shapedirs, lbs_weights = (
            out[:, :60].reshape(-1, 20, 3),
            functional.softmax(out[:, 60:] * 5, -1),
        )
        shaped = self._xyz + 0.02 * torch.einsum("m,nmk->nk", expression, shapedirs)
        transforms = batch_rigid_transform(batch_rodrigues(pose), self.joints, self.parents)
        weighted = torch.matmul(lbs_weights, transforms.view(5, 16)).view(-1, 4, 4)
        padded = torch.cat([shaped, torch.ones([N, 1])], dim=1)
        return self.cloud(torch.matmul(weighted, padded.unsqueeze(-1))[:, :3, 0])


class AudioAttention(Cloud):
    """GaussianTalker: a window of audio features by convolutions, and cross attention."""

    inputs = (inputs.condition(8 * 16, name="audio_features"),)

    def __init__(self) -> None:
        super().__init__()
        self.convs = nn.Sequential(
            nn.Conv1d(16, 32, 3, 2, 1),
            nn.LeakyReLU(0.02, True),
            nn.Conv1d(32, 32, 3, 2, 1),
            nn.LeakyReLU(0.02, True),
        )
        self.embed, self.attention = (
            nn.Linear(3, 32),
            nn.MultiheadAttention(32, 2, batch_first=True),
        )
        self.norm, self.head = nn.LayerNorm(32), nn.Linear(32, 6)

    def forward(self, audio_features: Tensor) -> Gaussians:
        tokens = self.convs(audio_features.view(1, 8, 16).permute(0, 2, 1)).permute(0, 2, 1)
        query = self.embed(self._xyz)[None]
        attended, _ = self.attention(query, tokens, tokens)
        moved, scaled = self.head(self.norm(query + attended))[0].chunk(2, -1)
        return self.cloud(self._xyz + 0.02 * moved, scale=torch.exp(self._scaling + 0.1 * scaled))


class HashedSpaceTime(Cloud):
    """Grid4D: hash grids in plain torch for xyz and for two planes with time."""

    def __init__(self) -> None:
        super().__init__()
        self.tables = nn.Parameter(torch.randn(4, 4096, 2))
        self.net = mlp(8, 32, 3)

    def forward(self, time: Tensor) -> Gaussians:
        x = torch.cat([self._xyz[:, :2] * 0.5 + 0.5, time.expand(N, 1)], 1).clamp(0, 1)
        features = []
        for level in range(4):
            scaled = x * (8 * 2**level)
            corner = torch.floor(scaled).long()
            f = scaled - corner
            total: Any = 0
            for c in range(8):
                bits = torch.tensor([(c >> d) & 1 for d in range(3)])
                weight = torch.where(bits > 0, f, 1 - f).prod(dim=-1, keepdim=True)
                p = corner + bits
                key = (p[:, 0] ^ p[:, 1] * 2654435761 ^ p[:, 2] * 805459861) & 0xFFFFFFFF
                total = total + weight * self.tables[level][key % 4096]
            features.append(total)
        return self.cloud(self._xyz + 0.02 * self.net(torch.cat(features, -1)))


class PhysicallyShaded(Cloud):
    """Relightable 3DGS: GGX with bounds of mixed types, light by harmonics."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        self._normal, self._base_color = (
            nn.Parameter(torch.randn(N, 3)),
            nn.Parameter(torch.randn(N, 3)),
        )
        self._roughness, self.light = (
            nn.Parameter(torch.randn(N, 1)),
            nn.Parameter(torch.rand(3, 4)),
        )

    def forward(self, camera: Tensor) -> Gaussians:
        n = functional.normalize(self._normal, dim=-1)
        v = functional.normalize(camera - self._xyz, dim=-1)
        l = functional.normalize(torch.tensor([0.3, 1.0, 0.2]), dim=-1)  # noqa: E741
        h = functional.normalize(v + l, dim=-1)
        ndotv = torch.sum(n * v, -1, keepdim=True).clamp_(1e-6, 1)
        ndotl = torch.sum(n * l, -1, keepdim=True).clamp_(1e-6, 1)
        ndoth = torch.sum(n * h, -1, keepdim=True).clamp_(1e-6, 1)
        alpha2 = torch.sigmoid(self._roughness) ** 4
        d = alpha2 / (np.pi * (ndoth**2 * (alpha2 - 1) + 1) ** 2).clamp(1e-6, 4 * np.pi)
        k = (torch.sigmoid(self._roughness) + 1) ** 2 / 8
        g = 1 / ((ndotl * (1 - k) + k) * (ndotv * (1 - k) + k)).clamp(1e-6, 4 * np.pi)
        basis = torch.cat([torch.full_like(ndotl, 0.28), 0.49 * n], -1)
        diffuse = torch.sigmoid(self._base_color) / np.pi * (basis @ self.light.T).clamp_min(0)
        return self.cloud(rgb=torch.clamp(diffuse + 0.04 * d * g * ndotl, 0, 1))


class AnisotropicLobes(Cloud):
    """Spec-Gaussian: anisotropic spherical Gaussians of a reflected direction."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        theta = torch.linspace(0, np.pi, 8)
        self.register_buffer(
            "omega", torch.stack([torch.sin(theta), torch.zeros(8), torch.cos(theta)], -1)[None]
        )
        self.asg, self.render = mlp(16, 32, 8 * 4), mlp(8 + 15 + 1, 32, 3)
        self.feature = nn.Parameter(torch.randn(N, 16))

    def forward(self, camera: Tensor) -> Gaussians:
        normal = build_rotation(self._rotation)[:, :, 2]
        view = functional.normalize(self._xyz - camera, dim=-1)
        reflected = view - 2 * (view * normal).sum(dim=-1, keepdim=True) * normal
        a, la, mu, _ = self.asg(self.feature).view(-1, 8, 4).split([1, 1, 1, 1], dim=-1)
        smooth = functional.relu((reflected[:, None] * self.omega).sum(dim=-1, keepdim=True))
        lobes = (
            a
            * smooth
            * torch.exp(
                -functional.softplus(la) * (1 - smooth) - functional.softplus(mu) * smooth**2
            )
        ).squeeze(-1)
        features = torch.cat(
            [lobes, positional_encoding(view, 2), (view * normal).sum(-1, keepdim=True)], -1
        )
        return self.cloud(rgb=torch.sigmoid(self.render(features)))


class ShortestAxisNormals(Cloud):
    """GaussianShader: the normal is the shortest axis, turned towards the camera."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        self.diffuse, self.tint = nn.Parameter(torch.randn(N, 3)), nn.Parameter(torch.randn(N, 3))

    def forward(self, camera: Tensor) -> Gaussians:
        rotations = build_rotation(self._rotation)
        smallest = torch.min(self.get_scaling, dim=-1)[1][..., None, None].expand(-1, 3, -1)
        normal = rotations.gather(2, smallest).squeeze(dim=2)
        dir_pp = camera.repeat(N, 1) - self._xyz
        dir_pp = dir_pp / dir_pp.norm(dim=1, keepdim=True)
        positive = torch.sum(normal * dir_pp, -1, keepdim=True) > 0
        normal = torch.where(positive, normal, -normal)
        reflection = 2 * (dir_pp * normal).sum(-1, keepdim=True) * normal - dir_pp
        shine = torch.sigmoid(self.tint) * (0.5 * reflection[:, 1:2] + 0.5).clamp(min=0, max=1)
        return self.cloud(
            rgb=torch.clamp(torch.sigmoid(self.diffuse) * 0.7 + 0.3 * shine, 0.0, 1.0)
        )


class AppearanceEmbedding(Cloud):
    """WildGaussians: the embedding of a picture and of each Gaussian give a colour map."""

    inputs = (inputs.appearance_id(24),)

    def __init__(self) -> None:
        super().__init__()
        self.appearance_embeddings = nn.Embedding(24, 16)
        self.embeddings, self.appearance_mlp = nn.Parameter(torch.randn(N, 12)), mlp(31, 64, 64, 6)

    def forward(self, index: Tensor) -> Gaussians:
        embedding = self.appearance_embeddings(index.long()).expand(N, -1)
        dc = self._features_dc.squeeze(1)
        offset, multiplier = torch.split(
            self.appearance_mlp(torch.cat((embedding, self.embeddings, dc), -1)) * 0.01, [3, 3], -1
        )
        return self.cloud(
            rgb=torch.clamp_min(dc * (1 + multiplier) + offset + 0.5, 0.0).clamp(max=1)
        )


class UnprojectedPixels(Cloud):
    """MVSplat: Gaussians of pixels; asserts, a constant inverse, and a module made in forward."""

    def __init__(self) -> None:
        super().__init__(64 * 64)
        self.register_buffer("intrinsics", torch.tensor([[50.0, 0, 32], [0, 50, 32], [0, 0, 1]]))
        self.net = nn.Sequential(
            nn.Conv2d(6, 16, 3, padding=1), nn.GELU(), nn.Conv2d(16, 8, 3, padding=1)
        )
        self.map = nn.Parameter(torch.randn(1, 4, 64, 64))

    def forward(self, time: Tensor) -> Gaussians:
        assert self.intrinsics[2, 2] == 1
        assert torch.linalg.det(self.intrinsics) > 0
        ys, xs = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
        pixels = torch.stack([xs, ys, torch.ones_like(xs)], -1).float().reshape(-1, 3)
        rays = pixels @ torch.inverse(self.intrinsics).T
        encoding = torch.cat([torch.sin(3 * time), torch.cos(3 * time)])[
            None, :, None, None
        ].expand(1, 2, 64, 64)
        out = self.net(torch.cat([self.map, encoding], 1))[0].flatten(1).T
        depth = nn.Softplus()(out[:, :1]) + 1
        rotation = functional.normalize(out[:, 4:8] + self.get_rotation, dim=-1)
        scale = (0.5 + 2 * torch.sigmoid(out[:, 1:4])) * depth / 50
        return self.cloud(rays * depth - torch.tensor([0.0, 0, 2]), rotation=rotation, scale=scale)


class FrameTables(Cloud):
    """Dynamic 3D Gaussians: positions and rotations of each frame in tables."""

    inputs = (inputs.frame_index(20),)

    def __init__(self) -> None:
        super().__init__()
        self.means3D = nn.Parameter(torch.rand(20, N, 3) * 2 - 1)
        self.unnorm_rotations = nn.Parameter(torch.randn(20, N, 4))

    def forward(self, frame_index: Tensor) -> Gaussians:
        t = frame_index.long()
        return self.cloud(
            self.means3D[t][0], rotation=functional.normalize(self.unnorm_rotations[t][0])
        )


class Rotors(Cloud):
    """4D-Rotor Gaussian Splatting: two quaternions turn a covariance in space and time."""

    def __init__(self) -> None:
        super().__init__()
        self._t, self._scaling_t = (
            nn.Parameter(torch.rand(N, 1)),
            nn.Parameter(torch.randn(N, 1) * 0.1 - 1),
        )
        self._rotation_r = nn.Parameter(torch.randn(N, 4))

    def forward(self, time: Tensor) -> Gaussians:
        a, b = (
            functional.normalize(self._rotation, dim=-1),
            functional.normalize(self._rotation_r, dim=-1),
        )
        a, b = a.unbind(-1), b.unbind(-1)
        left = torch.stack(
            [
                a[0],
                -a[1],
                -a[2],
                -a[3],
                a[1],
                a[0],
                -a[3],
                a[2],
                a[2],
                a[3],
                a[0],
                -a[1],
                a[3],
                -a[2],
                a[1],
                a[0],
            ],
            1,
        ).reshape(-1, 4, 4)
        right = torch.stack(
            [
                b[0],
                b[1],
                b[2],
                b[3],
                -b[1],
                b[0],
                -b[3],
                b[2],
                -b[2],
                b[3],
                b[0],
                -b[1],
                -b[3],
                -b[2],
                b[1],
                b[0],
            ],
            1,
        ).reshape(-1, 4, 4)
        turned = (left @ right).flip(1, 2) @ torch.diag_embed(
            torch.exp(torch.cat([self._scaling, self._scaling_t], 1))
        )
        sigma = turned @ turned.transpose(1, 2)
        cov_t = sigma[:, 3, 3].unsqueeze(-1)
        cov_12 = sigma[:, 0:3, 3]
        conditional = (
            sigma[:, :3, :3] - cov_12.unsqueeze(-1) @ cov_12.unsqueeze(1) / cov_t[..., None]
        )
        means = self._xyz + cov_12 / cov_t * (time - self._t)
        opacity = torch.sigmoid(self._opacity) * torch.exp(-0.5 * (time - self._t) ** 2 / cov_t)
        upper = torch.triu_indices(3, 3)
        packed = conditional[:, upper[0], upper[1]] + 1e-6 * torch.tensor([1.0, 0, 0, 1, 0, 1])
        sh = torch.cat([self._features_dc, self._features_rest], dim=1)
        return Gaussians(means, opacity, covariance=packed, sh=sh)


class Keyframes(Cloud):
    """Ex4DGS: cubic Hermite splines of positions, spherical interpolation of rotations."""

    def __init__(self) -> None:
        super().__init__()
        self.keys, self.turns = (
            nn.Parameter(torch.randn(N, 8, 3) * 0.3),
            nn.Parameter(torch.randn(N, 8, 4)),
        )
        self.register_buffer("interval", torch.tensor(1 / 7))

    def forward(self, time: Tensor) -> Gaussians:
        index = torch.floor(time / self.interval).long().clamp(0, 6)
        t = time / self.interval - index
        p0, p1 = self.keys[:, index].squeeze(1), self.keys[:, index + 1].squeeze(1)
        m0 = (p1 - self.keys[:, (index - 1).clamp(min=0)].squeeze(1)) / 2
        m1 = (self.keys[:, (index + 2).clamp(max=7)].squeeze(1) - p0) / 2
        t2, t3 = t * t, t * t * t
        xyz = (
            (2 * t3 - 3 * t2 + 1) * p0
            + (t3 - 2 * t2 + t) * m0
            + (-2 * t3 + 3 * t2) * p1
            + (t3 - t2) * m1
        )
        q0, q1 = (
            functional.normalize(self.turns[:, i].squeeze(1), dim=-1) for i in (index, index + 1)
        )
        dot = (q0 * q1).sum(-1, keepdim=True)
        q1 = torch.where(dot < 0, -q1, q1)
        theta = torch.acos(dot.abs().clamp(max=0.9995))
        rotation = (torch.sin((1 - t) * theta) * q0 + torch.sin(t * theta) * q1) / torch.sin(theta)
        return self.cloud(xyz, rotation=rotation)


class FourierMotion(Cloud):
    """Gaussian-Flow: polynomials and Fourier series of all fields."""

    def __init__(self) -> None:
        super().__init__()
        self.poly, self.fourier = (
            nn.Parameter(torch.randn(N, 3, 3) * 0.1),
            nn.Parameter(torch.randn(N, 3, 8) * 0.05),
        )

    def forward(self, time: Tensor) -> Gaussians:
        powers = torch.stack([time[0] ** i for i in range(1, 4)])
        k = torch.arange(1, 5)
        waves = torch.cat([torch.cos(2 * math.pi * k * time), torch.sin(2 * math.pi * k * time)])
        return self.cloud(self._xyz + self.poly @ powers + (self.fourier * waves).sum(-1))


class SplineCurves(Cloud):
    """Curves of control points: a Bernstein basis from binomials (MoDGS, SplineGS)."""

    def __init__(self) -> None:
        super().__init__()
        self.control = nn.Parameter(torch.randn(N, 6, 3) * 0.3)
        self.register_buffer("binomials", torch.tensor([math.comb(5, i) for i in range(6)]))

    def forward(self, time: Tensor) -> Gaussians:
        i = torch.arange(6)
        t = time.clamp(1e-4, 1 - 1e-4)
        basis = self.binomials * torch.pow(t, i) * torch.pow(1 - t, 5 - i)
        return self.cloud(torch.einsum("k,nkc->nc", basis, self.control))


class PoseMaps(Cloud):
    """Animatable Gaussians: maps of a convolutional decoder, read by a constant mask of pixels."""

    inputs = (inputs.pose(8),)

    def __init__(self) -> None:
        mask = torch.rand(64, 64, generator=torch.Generator().manual_seed(1)) > 0.4
        super().__init__(int(mask.sum()))
        self.register_buffer("cano_mask", mask)
        self.style, self.const = nn.Linear(24, 16), nn.Parameter(torch.randn(1, 16, 16, 16))
        self.up = nn.Sequential(
            nn.Upsample(scale_factor=2),
            nn.Conv2d(16, 16, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Upsample(scale_factor=2),
            nn.Conv2d(16, 6, 3, padding=1),
        )

    def forward(self, pose: Tensor) -> Gaussians:
        modulated = self.const * (1 + self.style(pose.reshape(1, -1)))[:, :, None, None]
        out = self.up(modulated)[0].permute(1, 2, 0)[self.cano_mask]
        return self.cloud(self._xyz + 0.05 * torch.tanh(out[:, :3]), rgb=torch.sigmoid(out[:, 3:]))


class NonRigidAvatar(Cloud):
    """3DGS-Avatar: pose features, a network of skinning weights, and both deformations."""

    inputs = (inputs.pose(24),)

    def __init__(self) -> None:
        super().__init__()
        self.pose_encoder, self.nonrigid = mlp(24 * 9, 64, 16), mlp(27 + 16, 64, 10)
        self.skinning = nn.utils.parametrizations.weight_norm(nn.Linear(3, 24))
        self.register_buffer("parents", torch.tensor(_PARENTS))
        self.register_buffer("joints", torch.randn(24, 3) * 0.3)

    def forward(self, pose: Tensor) -> Gaussians:
        rotations = batch_rodrigues(pose)
        feature = self.pose_encoder((rotations - torch.eye(3)).reshape(1, -1))
        delta = self.nonrigid(
            torch.cat([positional_encoding(self._xyz, 4), feature.expand(N, -1)], 1)
        )
        x = self._xyz + 0.01 * delta[:, :3]
        weights = functional.softmax(20 * self.skinning(x), dim=1)
        transforms = batch_rigid_transform(rotations, self.joints, self.parents)
        fwd = (weights @ transforms.view(-1, 16)).view(-1, 4, 4)
        posed = torch.matmul(fwd, torch.cat([x, torch.ones_like(x[..., :1])], -1).unsqueeze(-1))[
            :, :3, 0
        ]
        return self.cloud(
            posed,
            scale=torch.exp(self._scaling + 0.1 * delta[:, 3:6]),
            rotation=functional.normalize(self._rotation + 0.1 * delta[:, 6:]),
        )


class Codebooks(Cloud):
    """Compact 3DGS: residual codebooks of scale and rotation, a constant mask of the rows."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("indices", torch.randint(64, (N, 3)))
        self.codebook = nn.ParameterList(nn.Parameter(torch.randn(64, 4) * 0.5) for _ in range(3))
        self._mask = nn.Parameter(torch.randn(N, 1))

    def forward(self, time: Tensor) -> Gaussians:
        quantized: Any = 0
        for level, book in enumerate(self.codebook):
            quantized = quantized + functional.embedding(self.indices[:, level], book)
        mask = (
            (torch.sigmoid(self._mask) > 0.01).float() - torch.sigmoid(self._mask)
        ).detach() + torch.sigmoid(self._mask)
        keep = torch.sigmoid(self._mask).squeeze(-1) > 0.3
        moved = (self._xyz + 0.1 * torch.sin(6 * time))[keep]
        return Gaussians(moved, torch.sigmoid(self._opacity[keep]) * mask[keep].clamp(0, 1), self.get_scaling[keep],
                         functional.normalize(quantized[keep]), rgb=torch.sigmoid(self._features_dc[keep, 0]))  # fmt: skip


class SmoothedScales(Cloud):
    """Mip-Splatting: a low pass of each Gaussian by the sampling rate, with its opacity."""

    inputs = (inputs.view(),)

    def forward(self, view: Tensor) -> Gaussians:
        rotation, translation = view[:3, :3], view[:3, 3]
        depth = (self._xyz @ rotation.T + translation[None])[:, 2].abs()
        depth = torch.clamp(depth, min=0.2)
        filter_3d = (depth / 1000.0 * (0.2**0.5))[..., None]
        squared = torch.square(self.get_scaling)
        det1 = squared.prod(dim=1)
        after = squared + torch.square(filter_3d)
        coefficient = torch.sqrt(det1 / after.prod(dim=1))
        return self.cloud(
            scale=torch.sqrt(after), opacity=torch.sigmoid(self._opacity) * coefficient[..., None]
        )


class ContractedField(Cloud):
    """A colour field of an unbounded scene: points outside of the ball are written by a mask."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        self.net = mlp(27 + 9, 64, 3, end=nn.Sigmoid())

    def forward(self, camera: Tensor) -> Gaussians:
        offset = self._xyz * 3 - camera
        norm = torch.linalg.norm(offset, dim=-1)
        contracted = offset.clone()
        outside = norm > 1
        contracted[outside] = ((2 - 1 / norm[outside]) / norm[outside])[:, None] * offset[outside]
        direction = torch.nan_to_num(offset / norm[:, None])
        color = self.net(
            torch.cat(
                [positional_encoding(contracted / 2, 4), positional_encoding(direction, 1)], -1
            )
        )
        return self.cloud(rgb=color)


MODULES: tuple[type[Cloud], ...] = (
    DeformNetwork, HexPlanes, TemporalBasis, PerGaussianEmbedding, ControlPoints, NeuralAnchors,
    LevelsOfDetail, BodyTemplate, TriplaneBody, FaceBound, EmbeddedOnMesh, HeadRegions,
    BlendShapeHead, AudioAttention, HashedSpaceTime, PhysicallyShaded, AnisotropicLobes,
    ShortestAxisNormals, AppearanceEmbedding, UnprojectedPixels, FrameTables, Rotors, Keyframes,
    FourierMotion, SplineCurves, PoseMaps, NonRigidAvatar, Codebooks, SmoothedScales,
    ContractedField,
)  # fmt: skip
