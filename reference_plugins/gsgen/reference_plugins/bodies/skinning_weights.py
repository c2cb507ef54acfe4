"""Computes skinning weights, rest positions and rest covariances of Gaussians.

They do not depend on the pose: they follow from tables of the body's vertices and from the
Gaussians in the training pose. A Gaussian's skinning weights take more memory than its attributes,
so a model of many Gaussians holds the tables
(:mod:`gsgen.reference_plugins.tensors.baked_constants`).
"""

__all__ = ["MIN_SKINNING_WEIGHT", "BigPoseGaussians", "SurfaceGaussians", "inverse"]

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.bodies.pose_networks import SKIP_LAYER, PoseNets
from gsgen.reference_plugins.bodies.skinning import multiply_matrices
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import planes_of, rotation_columns
from gsgen.reference_plugins.tensors.positional_encoding import POINT_OCTAVES, positional_encoding

# Added to the skinning weights before their logarithm (GauHuman, scene/gaussian_model.py).
MIN_SKINNING_WEIGHT = 1e-9
_GAUSSIAN_PARAMETERS = ("position", "scale", "rotation")


class _WeightOffsets(nn.Module):
    """GauHuman's network that returns offsets to skinning weights at a point."""

    def __init__(self, nets: PoseNets) -> None:
        super().__init__()
        self.layers = nn.ModuleList(Dense(*layer) for layer in nets.weights)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n j"]:
        first = hidden = positional_encoding(points, POINT_OCTAVES)
        *hidden_layers, output_layer = self.layers
        for index, layer in enumerate(hidden_layers):
            features = torch.cat([first, hidden], dim=1) if index == SKIP_LAYER else hidden
            hidden = torch.relu(layer(features))
        offsets: Tensor = output_layer(hidden)
        return offsets


class BigPoseGaussians(nn.Module):
    """Transforms Gaussians from the big pose of GauHuman to the rest pose."""

    near: Tensor
    vertex: Tensor
    transforms: Tensor
    position: Tensor
    scale: Tensor
    rotation: Tensor

    def __init__(
        self,
        near: Float[np.ndarray, "u j"],
        vertex: Int[Tensor, " n"],
        transforms: Float[np.ndarray, "j 3 4"],
        gaussians: tuple[Tensor, Tensor, Tensor],
        nets: PoseNets | None,
    ) -> None:
        """Store Gaussians, body vertices and networks as buffers of the module.

        ``near`` are skinning weights of the vertices in use, ``vertex`` the index of each
        Gaussian's nearest one, and ``transforms`` lead from the rest pose to the big pose.
        ``gaussians`` are positions, standard deviations and quaternions in the big pose.
        """
        super().__init__()
        # Added here and not at the logarithm: exporters remove the addition of so small a number.
        near = near if nets is None else near + MIN_SKINNING_WEIGHT
        _register_tables(self, near=near, vertex=vertex, transforms=transforms.reshape(-1, 12))
        _register_tables(self, **dict(zip(_GAUSSIAN_PARAMETERS, gaussians, strict=True)))
        self.offsets = None if nets is None else _WeightOffsets(nets)

    def forward(
        self,
    ) -> tuple[Float[Tensor, "j n"], Float[Tensor, "1 3 n"], Float[Tensor, "1 3 3 n"]]:
        """Return skinning weights, rest positions, and M of the rest covariance M Mᵀ."""
        weights = torch.index_select(self.near, 0, self.vertex)
        if self.offsets is not None:
            log_weights = torch.log(weights) + self.offsets(self.position)
            weights = torch.softmax(log_weights, dim=1)
        big_pose = (weights @ self.transforms).transpose(0, 1).reshape(1, 3, 4, -1)
        inverse_transforms = inverse(big_pose)
        relative_positions = self.position.transpose(0, 1)[None, None] - big_pose[:, :, 3][:, None]
        position = (inverse_transforms * relative_positions).sum(dim=2)
        root = multiply_matrices(inverse_transforms, _covariance_root(self.rotation, self.scale))
        return weights.transpose(0, 1), position, root


class SurfaceGaussians(nn.Module):
    """Transforms Gaussians on the surface of LHM's body to the neutral pose."""

    near: Tensor
    vertex: Tensor
    added: Tensor
    stiff: Tensor
    transforms: Tensor
    position: Tensor
    scale: Tensor
    rotation: Tensor

    def __init__(
        self,
        near: Float[np.ndarray, "u j"],
        vertex: Int[Tensor, " n"],
        added: Float[np.ndarray, "u 3"],
        stiff: Float[np.ndarray, " u"],
        transforms: Float[np.ndarray, "j 3 4"],
        gaussians: tuple[Tensor, Tensor, Tensor],
    ) -> None:
        """Store Gaussians and surface points of the body as buffers of the module.

        ``near``, ``vertex`` and ``gaussians`` are as in :class:`BigPoseGaussians`. ``added`` are
        offsets of the vertices for the person's shape; ``stiff`` is 1 for vertices whose Gaussians
        do not rotate.
        """
        super().__init__()
        _register_tables(self, near=near, vertex=vertex, added=added, stiff=stiff[:, None])
        _register_tables(self, transforms=transforms.reshape(-1, 12))
        _register_tables(self, **dict(zip(_GAUSSIAN_PARAMETERS, gaussians, strict=True)))

    def forward(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return what skinning Gaussians needs: weights, rest positions and matrices, rigidity, shape.

        The shape is rotation times scale, a square root of the covariance.
        """
        inverse_transforms = (self.near @ self.transforms).transpose(0, 1)
        inverse_transforms = torch.index_select(inverse_transforms, 1, self.vertex).reshape(
            1, 3, 4, -1
        )
        point = self.position.transpose(0, 1)[None, None]
        position = (inverse_transforms[:, :, :3] * point).sum(dim=2) + inverse_transforms[:, :, 3]
        added = torch.index_select(self.added.transpose(0, 1), 1, self.vertex)
        weights = torch.index_select(self.near.transpose(0, 1), 1, self.vertex)
        stiff = torch.index_select(self.stiff.transpose(0, 1), 1, self.vertex)
        root = _covariance_root(self.rotation, self.scale)
        return weights, position + added[None], inverse_transforms[:, :, :3], stiff, root


def _register_tables(module: nn.Module, **tables: Tensor | np.ndarray) -> None:
    """Register arrays as buffers of a torch module; NumPy arrays become float32."""
    for name, table in tables.items():
        if not isinstance(table, Tensor):
            table = torch.from_numpy(table.astype(np.float32))
        module.register_buffer(name, table)


def _covariance_root(
    rotation: Float[Tensor, "n 4"], scale: Float[Tensor, "n 3"]
) -> Float[Tensor, "1 3 3 n"]:
    """Return R S, a square root of the covariance, from quaternions and standard deviations."""
    columns = rotation_columns(planes_of(rotation))
    turn = torch.stack([torch.cat(column) for column in columns], dim=1)
    return (turn * scale.transpose(0, 1)[None])[None]


def inverse(matrix: Float[Tensor, "1 3 4 n"]) -> Float[Tensor, "1 3 3 n"]:
    """Invert the 3×3 matrix of the first three columns, by cofactors.

    With cyclic indices, C[i, j] = M[i+1, j+1] M[i+2, j+2] − M[i+1, j+2] M[i+2, j+1]; the
    inverse is Cᵀ over the determinant.
    """
    second, third_row = (
        torch.cat([matrix[:, shift:, :3], matrix[:, :shift, :3]], dim=1) for shift in (1, 2)
    )
    next_columns, second_columns = (
        [torch.cat([rows[:, :, shift:], rows[:, :, :shift]], dim=2) for shift in (1, 2)]
        for rows in (second, third_row)
    )
    cofactors = next_columns[0] * second_columns[1] - next_columns[1] * second_columns[0]
    determinant = (matrix[:, 0, :3] * cofactors[:, 0]).sum(dim=1)[:, None, None]
    return cofactors.transpose(1, 2) / determinant
