"""Idioms whose values an input reaches, and which have a form of fixed size: all are exported."""

__all__ = ["EXPORTED"]

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from sdk.exporting.idioms.scene import POINTS, Idiom, Scene


def value_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    position[position < -0.5] = 0
    return position


def row_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    position[position[:, 0] < 0] = torch.tensor([1.0, 0.5, 0.2])
    return position


def rows_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    mask = position[:, 0] < 0
    position[mask] = torch.sin(3 * position[mask])
    return position


def other_rows_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    mask = position[:, 0] < 0
    position[mask] = scene.net(scene.features[mask]) * time
    return position


def elements_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    mask = position < 0
    position[mask] = position[mask].abs().sqrt()
    return position


def not_a_number_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    ratio = scene.moved(time) / (scene.moved(time).abs() - 0.2).clamp(min=0)
    ratio[torch.isnan(ratio)] = 0
    ratio[torch.isinf(ratio)] = 1
    return ratio.clamp(-2, 2)


def add_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    position[position[:, 0] < 0] += 0.25
    return position


def multiply_a_column_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    mask = position[:, 0] < 0
    position[mask, 1] *= 0.5
    return position


def other_value_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    """As the contraction of mip-NeRF 360: points outside of the unit ball."""
    position = 1.5 * scene.moved(time)
    norm = position.norm(dim=-1)
    outside = norm > 1
    position[outside] = ((2 - 1 / norm[outside]) / norm[outside])[:, None] * position[outside]
    return position


def two_tensors_by_one_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    """As Scaffold-GS: several fields are selected by one mask, and joined."""
    position = scene.moved(time)
    mask = position[:, 0] > 0
    joined = torch.cat([position[mask], scene.features[mask]], 1)
    return scene.xyz + 0.1 * (joined[:, :3] + scene.xyz[mask]).sum(0)


def matrices_filled_by_element(scene: Scene, time: Tensor) -> Tensor:
    """As build_rotation of 3DGS: a matrix of each row."""
    angle = scene.features[:, 0] + time
    rotation = torch.zeros((POINTS, 3, 3))
    rotation[:, 0, 0], rotation[:, 0, 1] = torch.cos(angle), -torch.sin(angle)
    rotation[:, 1, 0], rotation[:, 1, 1] = torch.sin(angle), torch.cos(angle)
    rotation[:, 2, 2] = 1
    return (rotation @ scene.xyz[..., None])[..., 0]


def one_true_in_each_row(scene: Scene, time: Tensor) -> Tensor:
    """As matrix_to_quaternion of pytorch3d: the candidate whose number is largest."""
    candidates = torch.stack([scene.moved(time), scene.xyz, scene.features[:, :3]], 1)
    largest = functional.one_hot(candidates.norm(dim=-1).argmax(-1), num_classes=3) > 0.5
    return candidates[largest, :].reshape(POINTS, 3)


def mixed_clamp_bounds(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    return position.clamp(1e-6, 1) + position.clamp(min=0, max=0.2) + position.clamp_(-1, 4 * np.pi)


def clamp_by_a_numpy_number(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time).clamp_min(np.sin(np.pi / 18))


def clamp_by_a_tensor(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time).clamp(scene.bounds[0], scene.bounds[1] * time)


def extremes_of_all(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    return (position - position.amin()) / (position.amax() - position.amin())


def extremes_without_a_dimension(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    return (position - position.min()) / (position.max() - position.min())


def standard_deviation(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    return (position - position.mean(0)) / position.std(0)


def variance_of_all(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    return position / position.var()


def any_and_all(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    is_inside = (position.abs() < 1).all(-1, keepdim=True)
    return torch.where(is_inside & (position > 0).any(), position, 0.5 * position)


def mean_by_scatter(scene: Scene, time: Tensor) -> Tensor:
    index = scene.part[:, None].expand(POINTS, 3)
    mean = torch.zeros(5, 3).scatter_reduce(0, index, scene.moved(time), "mean", include_self=False)
    return mean[scene.part]


def mean_with_itself_by_scatter(scene: Scene, time: Tensor) -> Tensor:
    index = scene.part[:, None].expand(POINTS, 3)
    return torch.ones(5, 3).scatter_reduce(0, index, scene.moved(time), "mean")[scene.part]


def sum_by_scatter(scene: Scene, time: Tensor) -> Tensor:
    index = scene.part[:, None].expand(POINTS, 3)
    return torch.zeros(5, 3).scatter_add_(0, index, scene.moved(time))[scene.part]


def product_by_scatter(scene: Scene, time: Tensor) -> Tensor:
    index = scene.part[:, None].expand(POINTS, 3)
    return torch.ones(5, 3).scatter_reduce(0, index, scene.moved(time), "prod")[scene.part]


def index_reduce_of_rows(scene: Scene, time: Tensor) -> Tensor:
    result = torch.zeros(5, 3).index_reduce(0, scene.part, scene.moved(time), "amax")
    return result[scene.part]


def accumulate_by_index_put(scene: Scene, time: Tensor) -> Tensor:
    total = torch.zeros(5, 3)
    total.index_put_((scene.part,), scene.moved(time), accumulate=True)
    return total[scene.part]


def frame_by_index(scene: Scene, time: Tensor) -> Tensor:
    frame = (time * 60).long().clamp(0, 63)
    return scene.xyz + 0.1 * scene.table[frame]


def interpolated_frames(scene: Scene, time: Tensor) -> Tensor:
    moment = (time * 60).clamp(0, 62.9)
    frame = torch.floor(moment).long()
    fraction = moment - frame
    return scene.xyz + 0.1 * torch.lerp(scene.table[frame], scene.table[frame + 1], fraction)


def sampled_plane(scene: Scene, time: Tensor) -> Tensor:
    points = scene.moved(time)[:, :2].reshape(1, 1, POINTS, 2)
    return functional.grid_sample(scene.grid, points, align_corners=True)[0, :, 0].T + scene.xyz


def dropout_in_evaluation(scene: Scene, time: Tensor) -> Tensor:
    return functional.dropout(scene.dropout(scene.moved(time)), 0.5, training=scene.training)


def batch_norm_in_evaluation(scene: Scene, time: Tensor) -> Tensor:
    return scene.norm(scene.moved(time))


def normalized_vectors(scene: Scene, time: Tensor) -> Tensor:
    return functional.normalize(scene.moved(time), dim=-1) + torch.linalg.vector_norm(
        scene.xyz, dim=-1, keepdim=True
    )


def cross_products(scene: Scene, time: Tensor) -> Tensor:
    up = torch.tensor([0.0, 1, 0]).expand(POINTS, 3)
    return torch.cross(scene.moved(time), up, dim=-1) + torch.linalg.cross(
        scene.xyz, scene.moved(time)
    )


def triangular_products(scene: Scene, time: Tensor) -> Tensor:
    matrix = torch.tril(torch.eye(3) + 0.1 * time)
    return scene.xyz @ matrix + scene.xyz @ torch.diag_embed(matrix.diagonal())


def meshgrid_of_a_moving_axis(scene: Scene, time: Tensor) -> Tensor:
    axis = torch.linspace(-1, 1, 2) * time
    grid = torch.stack(torch.meshgrid(axis, axis, torch.linspace(0, 1, 6), indexing="ij"), -1)
    return grid.reshape(-1, 3)


def roll_and_flip(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time).roll(1, 0).flip(0) + torch.rot90(
        scene.xyz.reshape(6, 4, 3), 2
    ).reshape(-1, 3)


def unfold_windows(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time).unfold(0, 3, 1).mean(-1).repeat(2, 1)[:POINTS]


def logsumexp_and_softmax(scene: Scene, time: Tensor) -> Tensor:
    weights = torch.softmax(scene.features * time, -1)
    return scene.moved(time) * torch.logsumexp(weights, -1, keepdim=True)


def atan2_and_remainder(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    angle = torch.atan2(position[:, 1], position[:, 0]) % (2 * torch.pi)
    return torch.stack([angle, torch.remainder(angle, 0.7), torch.fmod(angle, 0.5)], -1)


def quaternion_by_unbind(scene: Scene, time: Tensor) -> Tensor:
    w, x, y, z = functional.normalize(scene.features[:, :4] + time, dim=-1).unbind(-1)
    return scene.xyz + torch.stack([w * x - y * z, x * y + w * z, x * z - w * y], -1)


def nan_to_num_of_a_ratio(scene: Scene, time: Tensor) -> Tensor:
    return torch.nan_to_num(scene.moved(time) / scene.canvas, 0.0, 1.0, -1.0)


def copied_by_a_list(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    position[:, [0, 2]] = position[:, [2, 0]]
    return position


def nested_functions_of_torch(scene: Scene, time: Tensor) -> Tensor:
    return torch.func.vmap(lambda row: row * torch.sin(time[0]) + row.sum())(scene.xyz)


def assertion_on_an_input(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    assert position.isfinite().all()
    return position


def number_of_an_input(scene: Scene, time: Tensor) -> Tensor:
    frame = int(time * 20)
    return scene.xyz + 0.1 * scene.table[frame]


def input_through_numpy(scene: Scene, time: Tensor) -> Tensor:
    wave = np.sin(time.numpy())
    return scene.xyz + torch.from_numpy(wave)


def tensor_of_an_input(scene: Scene, time: Tensor) -> Tensor:
    return scene.xyz + torch.tensor([time, 2 * time, 3 * time])


EXPORTED: tuple[Idiom, ...] = (
    value_by_a_moving_mask, row_by_a_moving_mask, rows_by_a_moving_mask,
    other_rows_by_a_moving_mask, elements_by_a_moving_mask, not_a_number_by_a_moving_mask,
    add_by_a_moving_mask, multiply_a_column_by_a_moving_mask, other_value_by_a_moving_mask,
    two_tensors_by_one_moving_mask, matrices_filled_by_element, one_true_in_each_row,
    mixed_clamp_bounds, clamp_by_a_numpy_number, clamp_by_a_tensor,
    extremes_of_all, extremes_without_a_dimension, standard_deviation, variance_of_all,
    any_and_all, mean_by_scatter, mean_with_itself_by_scatter, sum_by_scatter,
    product_by_scatter, index_reduce_of_rows, accumulate_by_index_put, frame_by_index,
    interpolated_frames, sampled_plane, dropout_in_evaluation, batch_norm_in_evaluation,
    normalized_vectors, cross_products, triangular_products, meshgrid_of_a_moving_axis,
    roll_and_flip, unfold_windows, logsumexp_and_softmax, atan2_and_remainder,
    quaternion_by_unbind, nan_to_num_of_a_ratio, copied_by_a_list,
    nested_functions_of_torch, assertion_on_an_input, number_of_an_input, input_through_numpy,
    tensor_of_an_input,
)  # fmt: skip
