"""Bodies, faces and control graphs: skinning, blendshapes, triangles and nodes."""

__all__ = ["MODULES"]

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the name that every method uses

from gsgen.sdk import Gaussians, inputs, math
from sdk.exporting.authored.cloud import Cloud, N

_PARENTS = (-1, 0, 1, 1, 3)


class KinematicChain(Cloud):
    """SMPL: Rodrigues' formula, a loop over parents, and linear blend skinning by ``einsum``."""

    inputs = (inputs.pose(5), inputs.shape(4))

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("joints", torch.randn(5, 3))
        self.register_buffer("weights", torch.softmax(torch.randn(N, 5), dim=-1))
        self.register_buffer("shapes", 0.05 * torch.randn(N, 3, 4))

    def forward(self, pose: Tensor, betas: Tensor) -> Gaussians:
        angle = torch.norm(pose + 1e-8, dim=1, keepdim=True)
        axis = pose / angle
        x, y, z = axis.unbind(dim=1)
        zero = torch.zeros_like(x)
        cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).view(-1, 3, 3)
        sine, cosine = torch.sin(angle)[..., None], torch.cos(angle)[..., None]
        local = torch.eye(3) + sine * cross + (1 - cosine) * torch.bmm(cross, cross)
        chain = [F.pad(torch.cat([local[0], self.joints[0, :, None]], 1), (0, 0, 0, 1))]
        for joint in range(1, 5):
            bone = self.joints[joint] - self.joints[_PARENTS[joint]]
            matrix = F.pad(torch.cat([local[joint], bone[:, None]], 1), (0, 0, 0, 1))
            chain.append(chain[_PARENTS[joint]] @ (matrix + _CORNER))
        world = torch.stack(chain)
        shaped = self.rest + torch.einsum("l,nkl->nk", betas, self.shapes)
        per_point = torch.einsum("nj,jab->nab", self.weights, world)[:, :3]
        homogeneous = F.pad(shaped, (0, 1), value=1.0)
        return self.cloud(position=torch.matmul(per_point, homogeneous[..., None])[..., 0])


_CORNER = torch.zeros(4, 4)
_CORNER[3, 3] = 1.0


class FacesOfAMesh(Cloud):
    """GaussianAvatars: Gaussians ride on triangles of a mesh that expressions deform."""

    inputs = (inputs.expression(4),)

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("vertices", torch.randn(20, 3))
        self.register_buffer("shapes", 0.1 * torch.randn(4, 20, 3))
        self.register_buffer("faces", torch.stack([torch.randperm(20)[:3] for _ in range(30)]))
        self.register_buffer("binding", torch.randint(30, (N,)))

    def forward(self, expression: Tensor) -> Gaussians:
        vertices = self.vertices + torch.tensordot(expression, self.shapes, dims=1)
        corners = vertices[self.faces]
        edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        x = F.normalize(edge, dim=-1)
        normal = F.normalize(torch.cross(edge, other, dim=-1), dim=-1)
        frame = torch.stack([x, torch.cross(normal, x, dim=-1), normal], dim=-1)
        size = 0.5 * (edge.norm(dim=-1) + other.norm(dim=-1))[self.binding, None]
        turn = frame[self.binding]
        position = (turn @ (0.1 * self.rest)[..., None]).squeeze(-1) * size
        position = position + corners.mean(dim=1)[self.binding]
        covariance = math.covariance_matrix(math.covariance_upper(self.scale * size, self.rotation))
        turned = turn @ covariance @ turn.transpose(1, 2)
        return self.cloud(position=position, covariance=math.upper_triangle(turned))


class SparseControls(Cloud):
    """SC-GS: the nearest control nodes move a Gaussian, weighted by distance."""

    def __init__(self) -> None:
        super().__init__()
        self.nodes = nn.Parameter(torch.randn(12, 3))
        self.radius = nn.Parameter(torch.zeros(12))
        self.net = nn.Sequential(nn.Linear(4, 16), nn.ReLU(), nn.Linear(16, 7))

    def forward(self, time: Tensor) -> Gaussians:
        distance, index = torch.topk(torch.cdist(self.rest, self.nodes), 3, largest=False)
        weight = torch.exp(-(distance**2) / (2 * torch.exp(self.radius)[index] ** 2))
        weight = weight / weight.sum(dim=-1, keepdim=True)
        moved = self.net(torch.cat([self.nodes, time.expand(12, 1)], dim=-1))
        turn = F.normalize(moved[:, 3:] + torch.tensor([1.0, 0, 0, 0]), dim=-1)
        turns = math.quaternion_to_matrix(turn)[index]
        local = (self.rest[:, None] - self.nodes[index])[..., None]
        blended_positions = (turns @ local)[..., 0] + self.nodes[index] + 0.1 * moved[index, :3]
        rotation = math.quaternion_multiply((turn[index] * weight[..., None]).sum(1), self.rotation)
        return self.cloud(
            position=(blended_positions * weight[..., None]).sum(1), rotation=rotation
        )


class NearestNodeMoves(Cloud):
    """Each Gaussian follows the one node that is nearest now, by ``argmin``."""

    def __init__(self) -> None:
        super().__init__()
        self.nodes = nn.Parameter(2 * torch.randn(6, 3))
        self.velocity = nn.Parameter(torch.randn(6, 3))

    def forward(self, time: Tensor) -> Gaussians:
        moved = self.nodes + time * self.velocity
        nearest = torch.argmin(((self.rest[:, None] - moved[None]) ** 2).sum(-1), dim=1)
        return self.cloud(position=self.rest + 0.5 * time * self.velocity[nearest])


class DualQuaternions(Cloud):
    """Skinning by blended dual quaternions."""

    inputs = (inputs.pose(3, convention="quaternion-wxyz"), inputs.root_translation())

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("weights", torch.softmax(torch.randn(N, 3), dim=-1))

    def forward(self, pose: Tensor, root: Tensor) -> Gaussians:
        real = F.normalize(pose, dim=-1)
        real = torch.where(real[:, :1] < 0, -real, real)
        moved = torch.cat([torch.zeros(3, 1), root.expand(3, 3)], dim=-1)
        dual = 0.5 * math.quaternion_multiply(moved, real)
        blended = torch.einsum("nj,jk->nk", self.weights, torch.cat([real, dual], dim=-1))
        length = blended[:, :4].norm(dim=-1, keepdim=True).clamp(min=1e-6)
        real, dual = blended[:, :4] / length, blended[:, 4:] / length
        conjugate = real * torch.tensor([1.0, -1, -1, -1])
        shift = 2 * math.quaternion_multiply(dual, conjugate)[:, 1:]
        turned = (math.quaternion_to_matrix(real) @ self.rest[..., None]).squeeze(-1)
        return self.cloud(position=turned + shift)


MODULES = (KinematicChain, FacesOfAMesh, SparseControls, NearestNodeMoves, DualQuaternions)
