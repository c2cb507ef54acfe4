"""What Gaussians hang on, where they are at rest and how they lie there: no pose changes it.

Everything follows from tables of the body's vertices and from the Gaussians in the pose of
training. A Gaussian's share of each joint takes more room than all it is made of, so a model of
many Gaussians holds the tables (:mod:`gsgen.reference_plugins.tensors.baked_constants`).
"""

__all__ = ["LEAST_WEIGHT", "FromBigPose", "FromSurface", "inverse"]

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.bodies.pose_networks import SKIP, PoseNets
from gsgen.reference_plugins.bodies.skinning import multiplied
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import planes_of, rotation_columns
from gsgen.reference_plugins.tensors.positional_encoding import (
    POINT_OCTAVES,
    positional_encoding,
)

# Added to the skinning weights before their logarithm (GauHuman, scene/gaussian_model.py).
LEAST_WEIGHT = 1e-9


class _Offsets(nn.Module):
    """GauHuman's network that corrects skinning weights at a point; see ``weight_offsets``."""

    def __init__(self, nets: PoseNets) -> None:
        super().__init__()
        self.layers = nn.ModuleList(Dense(*layer) for layer in nets.weights)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n j"]:
        first = hidden = positional_encoding(points, POINT_OCTAVES)
        *inner, last = self.layers
        for index, layer in enumerate(inner):
            taken = torch.cat([first, hidden], dim=1) if index == SKIP else hidden
            hidden = torch.relu(layer(taken))
        made: Tensor = last(hidden)
        return made


class FromBigPose(nn.Module):
    """Gaussians in the big pose of GauHuman, brought back to rest."""

    near: Tensor
    which: Tensor
    transforms: Tensor
    position: Tensor
    scale: Tensor
    rotation: Tensor

    def __init__(
        self,
        near: Float[np.ndarray, "u j"],
        which: Int[Tensor, " n"],
        transforms: Float[np.ndarray, "j 3 4"],
        gaussians: tuple[Tensor, Tensor, Tensor],
        nets: PoseNets | None,
    ) -> None:
        """Keep the tables.

        Args:
            near: Skinning weights of the vertices in use.
            which: The nearest of them, of each Gaussian.
            transforms: Of the joints, from rest to the big pose.
            gaussians: Position, standard deviations and quaternions there.
            nets: What corrects the weights.
        """
        super().__init__()
        position, scale, rotation = gaussians
        # Here and not where the logarithm is taken: exporters drop so small a sum.
        near = near if nets is None else near + LEAST_WEIGHT
        self.register_buffer("near", torch.from_numpy(near.astype(np.float32)))
        self.register_buffer("which", which)
        flat = transforms.reshape(len(transforms), 12).astype(np.float32)
        self.register_buffer("transforms", torch.from_numpy(flat))
        self.register_buffer("position", position)
        self.register_buffer("scale", scale)
        self.register_buffer("rotation", rotation)
        self.offsets = None if nets is None else _Offsets(nets)

    def forward(
        self,
    ) -> tuple[Float[Tensor, "j n"], Float[Tensor, "1 3 n"], Float[Tensor, "1 3 3 n"]]:
        """Return weights, places at rest, and M of the covariance M Mᵀ there."""
        weights = torch.index_select(self.near, 0, self.which)
        if self.offsets is not None:
            logarithm = torch.log(weights) + self.offsets(self.position)
            weights = torch.softmax(logarithm, dim=1)
        there = (weights @ self.transforms).transpose(0, 1).reshape(1, 3, 4, -1)
        back = inverse(there)
        shifted = self.position.transpose(0, 1)[None, None] - there[:, :, 3][:, None]
        place = (back * shifted).sum(dim=2)
        root = multiplied(back, _root(self.rotation, self.scale))
        return weights.transpose(0, 1), place, root


class FromSurface(nn.Module):
    """Gaussians on the surface of LHM's body, brought to the neutral pose."""

    near: Tensor
    which: Tensor
    added: Tensor
    stiff: Tensor
    transforms: Tensor
    position: Tensor
    scale: Tensor
    rotation: Tensor

    def __init__(
        self,
        near: Float[np.ndarray, "u j"],
        which: Int[Tensor, " n"],
        added: Float[np.ndarray, "u 3"],
        stiff: Float[np.ndarray, " u"],
        transforms: Float[np.ndarray, "j 3 4"],
        gaussians: tuple[Tensor, Tensor, Tensor],
    ) -> None:
        """Keep the tables.

        Args:
            near: Skinning weights of the vertices in use.
            which: The nearest of them, of each Gaussian.
            added: What the person's shape adds to them.
            stiff: 1 for those whose Gaussians do not turn.
            transforms: Of the joints, to the neutral pose.
            gaussians: Position, standard deviations and quaternions.
        """
        super().__init__()
        position, scale, rotation = gaussians
        self.register_buffer("near", torch.from_numpy(near.astype(np.float32)))
        self.register_buffer("which", which)
        self.register_buffer("added", torch.from_numpy(added.astype(np.float32)))
        self.register_buffer("stiff", torch.from_numpy(stiff.astype(np.float32)[:, None]))
        flat = transforms.reshape(len(transforms), 12).astype(np.float32)
        self.register_buffer("transforms", torch.from_numpy(flat))
        self.register_buffer("position", position)
        self.register_buffer("scale", scale)
        self.register_buffer("rotation", rotation)

    def forward(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return weights, neutral places, neutral matrices, who is stiff, and M of M Mᵀ."""
        back = (self.near @ self.transforms).transpose(0, 1)
        back = torch.index_select(back, 1, self.which).reshape(1, 3, 4, -1)
        point = self.position.transpose(0, 1)[None, None]
        place = (back[:, :, :3] * point).sum(dim=2) + back[:, :, 3]
        added = torch.index_select(self.added.transpose(0, 1), 1, self.which)
        weights = torch.index_select(self.near.transpose(0, 1), 1, self.which)
        stiff = torch.index_select(self.stiff.transpose(0, 1), 1, self.which)
        root = _root(self.rotation, self.scale)
        return weights, place + added[None], back[:, :, :3], stiff, root


def _root(
    rotation: Float[Tensor, "n 4"], scale: Float[Tensor, "n 3"]
) -> Float[Tensor, "1 3 3 n"]:
    """Return R S of quaternions and standard deviations, as planes."""
    columns = rotation_columns(planes_of(rotation))
    turn = torch.stack([torch.cat(column) for column in columns], dim=1)
    return (turn * scale.transpose(0, 1)[None])[None]


def inverse(matrix: Float[Tensor, "1 3 4 n"]) -> Float[Tensor, "1 3 3 n"]:
    """Return the inverse of the first three columns, by cofactors.

    With rows and columns counted in a circle, C[i, j] = M[i+1, j+1] M[i+2, j+2] −
    M[i+1, j+2] M[i+2, j+1]; the inverse is Cᵀ over the determinant.
    """
    second, third = (
        torch.cat([matrix[:, shift:, :3], matrix[:, :shift, :3]], dim=1) for shift in (1, 2)
    )
    one, two = (
        [torch.cat([rows[:, :, shift:], rows[:, :, :shift]], dim=2) for shift in (1, 2)]
        for rows in (second, third)
    )
    cofactors = one[0] * two[1] - one[1] * two[0]
    determinant = (matrix[:, 0, :3] * cofactors[:, 0]).sum(dim=1)[:, None, None]
    return cofactors.transpose(1, 2) / determinant
