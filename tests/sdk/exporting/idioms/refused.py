"""Idioms that cannot be exported, each with what its hint says, and the idiom after that change."""

__all__ = ["REFUSED", "Refusal"]

import random
import time as clocks
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gsgen.sdk import math
from sdk.exporting.idioms.scene import POINTS, Idiom, Scene


def branch_on_an_input(scene: Scene, time: Tensor) -> Tensor:
    if time > 0.5:  # guilty
        return scene.moved(time)
    return scene.xyz


def where_on_an_input(scene: Scene, time: Tensor) -> Tensor:
    return torch.where(time > 0.5, scene.moved(time), scene.xyz)


def no_assertion(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time)


def list_indexed_by_an_input(scene: Scene, time: Tensor) -> Tensor:
    rows = [scene.xyz, -scene.xyz]
    return rows[(time > 0.5).long()]  # guilty


def stack_indexed_by_an_input(scene: Scene, time: Tensor) -> Tensor:
    rows = torch.stack([scene.xyz, -scene.xyz])
    return rows[(time > 0.5).long()][0]


def interpolation_of_numpy(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    heights = np.interp(position[:, 0].detach().cpu().numpy(), [-1, 1], [0, 2])  # guilty
    return position + torch.tensor(heights, dtype=torch.float32)[:, None]


def interpolation_of_torch(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    return position + (position[:, :1].clamp(-1, 1) + 1)


def rows_of_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    inside = position[position[:, 0] > 0]  # guilty
    return position - inside.median(0).values


def weights_of_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    inside = (position[:, :1] > 0).float()
    return position - (position * inside).sum(0) / inside.sum(0).clamp(min=1)


def unique_of_moving_values(scene: Scene, time: Tensor) -> Tensor:
    cells = torch.unique((scene.moved(time) * 2).long(), dim=0)  # guilty
    return scene.xyz + cells.float().mean(0)


def cells_without_unique(scene: Scene, time: Tensor) -> Tensor:
    cells = (scene.moved(time) * 2).long()
    return scene.xyz + cells.float().mean(0)


def nonzero_of_moving_values(scene: Scene, time: Tensor) -> Tensor:
    rows = torch.nonzero(scene.moved(time)[:, 0] > 0)  # guilty
    return scene.xyz + rows.float().std()


def mask_of_moving_values(scene: Scene, time: Tensor) -> Tensor:
    return scene.xyz + (scene.moved(time)[:, :1] > 0).float()


def inverse_of_an_input(scene: Scene, time: Tensor) -> Tensor:
    return scene.xyz @ torch.inverse(torch.eye(3) + 0.1 * scene.xyz[:3] * time)  # guilty


def inverse_of_the_sdk(scene: Scene, time: Tensor) -> Tensor:
    return scene.xyz @ math.inverse_3x3(torch.eye(3) + 0.1 * scene.xyz[:3] * time)


def decomposition_of_an_input(scene: Scene, time: Tensor) -> Tensor:
    left, _, right = torch.linalg.svd(scene.xyz[:3] + time)  # guilty
    return scene.xyz @ (left @ right)


def decomposition_in_init(scene: Scene, time: Tensor) -> Tensor:
    left, _, right = torch.linalg.svd(scene.xyz[:3])
    return scene.xyz @ (left @ right) + time


def dropout_by_default(scene: Scene, time: Tensor) -> Tensor:
    return functional.dropout(scene.moved(time), 0.2)  # guilty


def dropout_off(scene: Scene, time: Tensor) -> Tensor:
    return functional.dropout(scene.moved(time), 0.2, training=False)


def dropout_module_in_forward(scene: Scene, time: Tensor) -> Tensor:
    return torch.nn.Dropout(0.2)(scene.moved(time))  # guilty


def dropout_module_in_evaluation(scene: Scene, time: Tensor) -> Tensor:
    return torch.nn.Dropout(0.2).eval()(scene.moved(time))


def batch_norm_in_training(scene: Scene, time: Tensor) -> Tensor:
    scene.norm.train()  # guilty
    return scene.norm(scene.moved(time))


def batch_norm_kept(scene: Scene, time: Tensor) -> Tensor:
    return scene.norm(scene.moved(time))


def batch_statistics(scene: Scene, time: Tensor) -> Tensor:
    return functional.batch_norm(  # guilty
        scene.moved(time), scene.norm.running_mean, scene.norm.running_var, training=True
    )


def running_statistics(scene: Scene, time: Tensor) -> Tensor:
    return functional.batch_norm(scene.moved(time), scene.norm.running_mean, scene.norm.running_var)


def noise_in_forward(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) + 0.1 * torch.randn(POINTS, 3)  # guilty


def noise_kept(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) + 0.1 * scene.features[:, :3]


def noise_of_python(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) + random.random()  # guilty


def noise_of_numpy(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) + torch.from_numpy(np.random.rand(3)).float()  # noqa: NPY002  # guilty


def clock_in_forward(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) + (clocks.perf_counter() % 1)  # guilty


def running_maximum(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time).cummax(0).values  # guilty


def masked_maximum(scene: Scene, time: Tensor) -> Tensor:
    mask = torch.ones(POINTS, POINTS).tril()[..., None] > 0
    return torch.where(mask, scene.moved(time)[None], -torch.inf).amax(1)


def median_of_rows(scene: Scene, time: Tensor) -> Tensor:
    return scene.moved(time) - scene.moved(time).median(0).values  # guilty


def middle_of_sorted_rows(scene: Scene, time: Tensor) -> Tensor:
    ordered = torch.sort(scene.moved(time), 0).values
    return scene.moved(time) - ordered[(POINTS - 1) // 2]


def state_between_frames(scene: Scene, time: Tensor) -> Tensor:
    scene.canvas += 0.01 * time  # guilty
    return scene.xyz + scene.canvas


def no_state(scene: Scene, time: Tensor) -> Tensor:
    return scene.xyz + 0.01 * time


def loop_until_an_input(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    while position.norm() > 1:  # guilty
        position = position * 0.5
    return position


def loop_of_fixed_length(scene: Scene, time: Tensor) -> Tensor:
    position = scene.moved(time)
    for _ in range(6):
        position = torch.where(position.norm() > 1, position * 0.5, position)
    return position


def formatted_input(scene: Scene, time: Tensor) -> Tensor:
    name = f"frame {time.item():.2f}"  # guilty
    return scene.xyz * len(name)


@dataclass(frozen=True, slots=True)
class Refusal:
    """An idiom that is not exported, a part of its hint, and the idiom mended by the hint."""

    function: Idiom
    hint: str
    mended: Idiom


REFUSED = (
    Refusal(branch_on_an_input, "torch.where(condition, a, b)", where_on_an_input),
    Refusal(list_indexed_by_an_input, "tensor indices gather", stack_indexed_by_an_input),
    Refusal(interpolation_of_numpy, "torch function of the same name", interpolation_of_torch),
    Refusal(rows_of_a_moving_mask, "Multiply by the mask", weights_of_a_moving_mask),
    Refusal(unique_of_moving_values, "Multiply by the mask", cells_without_unique),
    Refusal(nonzero_of_moving_values, "Multiply by the mask", mask_of_moving_values),
    Refusal(inverse_of_an_input, "math.inverse_3x3", inverse_of_the_sdk),
    Refusal(decomposition_of_an_input, "once, in __init__", decomposition_in_init),
    Refusal(dropout_by_default, "training=False", dropout_off),
    Refusal(dropout_module_in_forward, "eval()", dropout_module_in_evaluation),
    Refusal(batch_norm_in_training, ".eval()", batch_norm_kept),
    Refusal(batch_statistics, "training=False", running_statistics),
    Refusal(noise_in_forward, "register_buffer", noise_kept),
    Refusal(noise_of_python, "once, in __init__", noise_kept),
    Refusal(noise_of_numpy, "once, in __init__", noise_kept),
    Refusal(clock_in_forward, "once, in __init__", noise_kept),
    Refusal(running_maximum, "lower triangular", masked_maximum),
    Refusal(median_of_rows, "torch.sort", middle_of_sorted_rows),
    Refusal(state_between_frames, "from the inputs", no_state),
    Refusal(loop_until_an_input, "torch.where(condition, a, b)", loop_of_fixed_length),
    Refusal(formatted_input, "Keep it a tensor", no_assertion),
)  # fmt: skip
