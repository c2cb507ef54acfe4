"""Idioms that use values which no input reaches: they are constants, and all are exported."""

__all__ = ["EXPORTED"]

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from sdk.exporting.idioms.scene import POINTS, Idiom, Scene


def joint_of_a_buffer(scene: Scene, time: Tensor) -> Tensor:
    """As smplx's kinematic chain: a Python list indexed by elements of a buffer."""
    chain = [torch.eye(3) * (1 + 0.1 * time)]
    for joint in range(1, len(scene.parents)):
        chain.append(chain[scene.parents[joint]] @ torch.eye(3) * (1 - 0.1 * time))
    return (torch.stack(chain)[scene.part] @ scene.xyz[..., None])[..., 0]


def assertion_on_parameters(scene: Scene, time: Tensor) -> Tensor:
    assert scene.xyz.max() <= 1
    assert scene.xyz.min() >= -1
    return scene.moved(time)


def assertion_on_a_constant_matrix(scene: Scene, time: Tensor) -> Tensor:
    matrix = torch.eye(4)
    assert torch.allclose(matrix[3], torch.tensor([0.0, 0, 0, 1]))
    return scene.moved(time)


def branch_on_a_buffer(scene: Scene, time: Tensor) -> Tensor:
    if scene.is_moving.any():
        return scene.moved(time)
    return scene.xyz * time


def mean_of_selected_offsets(scene: Scene, time: Tensor) -> Tensor:
    """As E-D3DGS: the mean of the offsets that are not 0."""
    offset = torch.masked_select(scene.offsets, scene.offsets.ne(0)).mean()
    offset[torch.isnan(offset)] = 0
    return scene.moved(time + offset)


def rows_by_a_constant_mask(scene: Scene, time: Tensor) -> Tensor:
    moving = scene.moved(time)[scene.is_moving]
    return torch.cat([moving, scene.xyz[~scene.is_moving]])


def write_by_a_constant_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.xyz.clone()
    position[scene.is_moving] = scene.moved(time)[scene.is_moving]
    return position


def add_by_a_constant_mask(scene: Scene, time: Tensor) -> Tensor:
    """As Gaussian-Head: ``+=`` with a constant mask."""
    position = scene.moved(time)
    position[scene.is_moving] += 0.1 * scene.features[scene.is_moving, :3]
    return position


def write_by_the_indices_of_a_mask(scene: Scene, time: Tensor) -> Tensor:
    rows = torch.nonzero(scene.is_moving, as_tuple=True)[0]
    position = scene.xyz.clone()
    position[rows] = scene.moved(time)[rows]
    return position


def write_a_column_by_a_constant_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    position[scene.is_moving, 2] = 0.5 * time
    return position


def scatter_by_a_constant_mask(scene: Scene, time: Tensor) -> Tensor:
    mask = scene.is_moving[:, None].expand(POINTS, 3)
    return scene.xyz.masked_scatter(mask, scene.moved(time)[scene.is_moving])


def where_of_one_argument(scene: Scene, time: Tensor) -> Tensor:
    (rows,) = torch.where(scene.is_moving)
    return scene.xyz.index_add(0, rows, 0.1 * torch.sin(time).expand(len(rows), 3))


def inverse_of_a_constant(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) @ torch.inverse(torch.eye(3) * 2 + 0.1 * scene.xyz[:3])


def solution_of_a_constant_system(scene: Scene, time: Tensor) -> Tensor:
    matrix = torch.eye(3) * 2 + 0.1 * scene.xyz[:3]
    return scene.moved(time) + torch.linalg.solve(matrix, scene.xyz[3])


def decomposition_of_a_constant(scene: Scene, time: Tensor) -> Tensor:
    left, _, right = torch.linalg.svd(scene.xyz[:3])
    return scene.moved(time) @ (left @ right)


def determinant_of_a_constant(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) * torch.linalg.det(torch.eye(3) + 0.1 * scene.xyz[:3])


def eigenvectors_of_a_constant(scene: Scene, time: Tensor) -> Tensor:
    covariance = scene.xyz.T @ scene.xyz
    _, vectors = torch.linalg.eigh(covariance)
    return scene.moved(time) @ vectors.abs()


def neighbours_of_parameters(scene: Scene, time: Tensor) -> Tensor:
    neighbours = torch.cdist(scene.xyz, scene.xyz).topk(3, largest=False).indices
    return scene.moved(time)[neighbours].mean(1)


def number_of_a_parameter(scene: Scene, time: Tensor) -> Tensor:
    radius = scene.xyz.norm(dim=-1).max().item()
    return scene.moved(time) / radius


def size_of_a_buffer(scene: Scene, time: Tensor) -> Tensor:
    parts = int(scene.part.max()) + 1
    total = torch.zeros(parts, 3).index_add(0, scene.part, scene.moved(time))
    return total[scene.part] / POINTS


def parameters_through_numpy(scene: Scene, time: Tensor) -> Tensor:
    centre = np.mean(scene.xyz.detach().cpu().numpy(), axis=0)
    return scene.moved(time) - torch.from_numpy(centre)


def parents_as_a_list(scene: Scene, time: Tensor) -> Tensor:
    joints = [scene.xyz[0] * time]
    for parent in scene.parents[1:].tolist():
        joints.append(joints[parent] + 0.1 * scene.xyz[parent])
    return scene.xyz + torch.stack(joints)[scene.part]


def unique_of_a_buffer(scene: Scene, time: Tensor) -> Tensor:
    labels, counts = torch.unique(scene.part, return_counts=True)
    return scene.moved(time) + 0.01 * (labels * counts)[scene.part][:, None]


def counts_of_a_buffer(scene: Scene, time: Tensor) -> Tensor:
    counts = torch.bincount(scene.part).float()
    return scene.moved(time) / counts[scene.part][:, None]


def repeated_rows(scene: Scene, time: Tensor) -> Tensor:
    repeats = torch.bincount(scene.part)
    rows = torch.repeat_interleave(torch.arange(5), repeats)
    return scene.moved(time) + 0.1 * scene.table[rows]


def sequence_of_segments(scene: Scene, time: Tensor) -> Tensor:
    parts = [scene.moved(time)[scene.part == part].mean(0) for part in scene.part.unique()]
    return scene.xyz + 0.1 * torch.stack(parts)[scene.part]


def table_filled_in_a_loop(scene: Scene, time: Tensor) -> Tensor:
    position = torch.zeros(POINTS, 3)
    for row in range(POINTS):
        position[row] = scene.xyz[row] + 0.1 * torch.sin(time + row)
    return position


def matrix_filled_by_element(scene: Scene, time: Tensor) -> Tensor:
    rotation = torch.zeros(3, 3)
    angle = time[0]
    rotation[0, 0], rotation[0, 1] = torch.cos(angle), -torch.sin(angle)
    rotation[1, 0], rotation[1, 1] = torch.sin(angle), torch.cos(angle)
    rotation[2, 2] = 1
    return scene.xyz @ rotation.T


def buffer_used_as_a_workspace(scene: Scene, time: Tensor) -> Tensor:
    scene.canvas[:] = 0
    scene.canvas[:, 0] = time
    return scene.xyz + 0.1 * scene.canvas


def module_made_in_forward(scene: Scene, time: Tensor) -> Tensor:
    """As unimatch: a small module without state is made in every frame."""
    return nn.Softplus(beta=2)(scene.moved(time))


def parameter_made_in_forward(scene: Scene, time: Tensor) -> Tensor:
    weight = nn.Parameter(scene.features[:3, :3], requires_grad=False)
    return scene.moved(time) @ weight


def frequencies_as_numpy(scene: Scene, time: Tensor) -> Tensor:
    bands = 2.0 ** np.linspace(0, 3, 4)
    encoded = torch.cat([torch.sin(band * math.pi * time) for band in bands])
    return scene.xyz + 0.1 * encoded.sum()


def bounds_as_floats(scene: Scene, time: Tensor) -> Tensor:
    low, high = float(scene.bounds[0, 0]), float(scene.bounds[1, 0])
    return (scene.moved(time) - low) / (high - low)


def shape_from_a_tensor(scene: Scene, time: Tensor) -> Tensor:
    size = torch.tensor(scene.xyz.shape)
    return scene.moved(time).reshape(size[1], size[0]).T


def arange_of_a_buffer(scene: Scene, time: Tensor) -> Tensor:
    levels = torch.arange(0, scene.part.max() + 1)
    return scene.moved(time) + 0.1 * levels[scene.part][:, None]


def try_and_fall_back(scene: Scene, time: Tensor) -> Tensor:
    try:
        factor = torch.linalg.cholesky(scene.xyz[:3] @ scene.xyz[:3].T + torch.eye(3))
    except RuntimeError:
        factor = torch.eye(3)
    return scene.moved(time) @ factor


@dataclass
class _Camera:
    centre: Tensor
    extent: float


def dataclass_of_tensors(scene: Scene, time: Tensor) -> Tensor:
    camera = _Camera(scene.xyz.mean(0), scene.xyz.norm(dim=-1).max().item())
    return (scene.moved(time) - camera.centre) / camera.extent


def quantile_of_parameters(scene: Scene, time: Tensor) -> Tensor:
    threshold = torch.quantile(scene.xyz[:, 0], 0.3)
    return torch.where(scene.xyz[:, :1] > threshold, scene.moved(time), scene.xyz)


def random_with_a_seed(scene: Scene, time: Tensor) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return scene.moved(time) + 0.1 * torch.rand(POINTS, 3, generator=generator)


def sparse_adjacency(scene: Scene, time: Tensor) -> Tensor:
    adjacency = torch.zeros(POINTS, POINTS)
    adjacency[torch.arange(POINTS), scene.part] = 1
    edges = adjacency.nonzero()
    return scene.xyz.index_add(0, edges[:, 0], 0.1 * scene.moved(time)[edges[:, 1]])


def farthest_points(scene: Scene, time: Tensor) -> Tensor:
    chosen = [0]
    distance = torch.full((POINTS,), torch.inf)
    for _ in range(4):
        distance = torch.minimum(distance, (scene.xyz - scene.xyz[chosen[-1]]).norm(dim=-1))
        chosen.append(int(distance.argmax()))
    return scene.moved(time) + 0.1 * scene.moved(time)[chosen].mean(0)


EXPORTED: tuple[Idiom, ...] = (
    joint_of_a_buffer, assertion_on_parameters, assertion_on_a_constant_matrix,
    branch_on_a_buffer, mean_of_selected_offsets, rows_by_a_constant_mask,
    write_by_a_constant_mask, add_by_a_constant_mask, write_by_the_indices_of_a_mask,
    write_a_column_by_a_constant_mask, scatter_by_a_constant_mask, where_of_one_argument,
    inverse_of_a_constant, solution_of_a_constant_system, decomposition_of_a_constant,
    determinant_of_a_constant, eigenvectors_of_a_constant, neighbours_of_parameters,
    number_of_a_parameter, size_of_a_buffer, parameters_through_numpy, parents_as_a_list,
    unique_of_a_buffer, counts_of_a_buffer, repeated_rows, sequence_of_segments,
    table_filled_in_a_loop, matrix_filled_by_element, buffer_used_as_a_workspace,
    module_made_in_forward, parameter_made_in_forward, frequencies_as_numpy, bounds_as_floats,
    shape_from_a_tensor, arange_of_a_buffer, try_and_fall_back, dataclass_of_tensors,
    quantile_of_parameters, random_with_a_seed, sparse_adjacency, farthest_points,
)  # fmt: skip
