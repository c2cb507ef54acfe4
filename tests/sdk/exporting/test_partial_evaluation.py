"""Values that no input reaches are constants: modules index, select, branch and invert with them."""

import random
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from gsgen.sdk.exporting.tracing.folded_constants import FoldedConstants
from gsgen.sdk.exporting.tracing.partial_evaluation import ValueNeeded, fold_constants

TIMES = (torch.tensor([0.3]), torch.tensor([0.8]))


class Scene(nn.Module):
    """Points with weights, a tree of joints, and a function that an author might write of them."""

    def __init__(self, function: Callable[["Scene", Tensor], Tensor]) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(3)
        self.points = nn.Parameter(torch.rand(8, 3, generator=generator))
        self.offsets = nn.Parameter(torch.tensor([0.0, 0.2, 0.0, -0.1]))
        self.register_buffer("parents", torch.tensor([-1, 0, 1, 2]))
        self.register_buffer("canvas", torch.zeros(4, 3))
        self.function = function

    def forward(self, time: Tensor) -> Tensor:
        return self.function(self, time)


def kinematic_chain(scene: Scene, time: Tensor) -> Tensor:
    chain = [torch.eye(3) * time]
    for joint in range(1, len(scene.parents)):
        chain.append(chain[scene.parents[joint]] @ torch.eye(3))
    return torch.stack(chain)


def assertion(scene: Scene, time: Tensor) -> Tensor:
    assert scene.points.min() >= 0
    return scene.points * time


def branch_on_a_constant(scene: Scene, time: Tensor) -> Tensor:
    return time + scene.points if scene.points.sum() > 0 else time - scene.points


def constant_mask(scene: Scene, time: Tensor) -> Tensor:
    return scene.points[scene.points[:, 0] > 0.5] * time


def constant_mask_of_a_moving_tensor(scene: Scene, time: Tensor) -> Tensor:
    return (scene.points + time)[scene.points[:, 0] > 0.5]


def write_by_a_constant_mask(scene: Scene, time: Tensor) -> Tensor:
    moved = scene.points * time
    moved[scene.points[:, 0] > 0.5] = moved[scene.points[:, 0] > 0.5] + 1
    return moved


def value_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    moved = scene.points - time
    moved[moved < 0] = 0
    return moved


def row_by_a_moving_mask(scene: Scene, time: Tensor) -> Tensor:
    moved = scene.points - time
    moved[moved[:, 0] < 0] = torch.tensor([1.0, 2.0, 3.0])
    return moved


def inverse_of_a_constant(scene: Scene, time: Tensor) -> Tensor:
    return torch.inverse(torch.eye(3) * 2 + scene.points[:3]) * time


def nearest_neighbours(scene: Scene, time: Tensor) -> Tensor:
    nearest = torch.cdist(scene.points, scene.points).topk(2, largest=False).indices
    return (scene.points * time)[nearest]


def number_of_a_constant(scene: Scene, time: Tensor) -> Tensor:
    return time * scene.points.max().item() + torch.zeros(int(scene.parents.max()), 1)


def masked_mean(scene: Scene, time: Tensor) -> Tensor:
    mean = torch.masked_select(scene.offsets, scene.offsets.ne(0)).mean()
    mean[torch.isnan(mean)] = 0
    return scene.points + time * mean


def unique_rows(scene: Scene, time: Tensor) -> Tensor:
    return torch.unique(scene.parents.clamp(0)).float() * time


def module_of_its_own(scene: Scene, time: Tensor) -> Tensor:
    return nn.Softplus(beta=2)(scene.points * time)


def canvas_of_zeros(scene: Scene, time: Tensor) -> Tensor:
    canvas = torch.zeros(2, 3)
    top = canvas[0]  # a view from before the write
    canvas[0, 1:2] = time
    return canvas.sum() + top


def canvas_that_writes_another(scene: Scene, time: Tensor) -> Tensor:
    first, second = torch.zeros(2), torch.zeros(2)
    early = second[:1]
    first[0:1] = time
    second += first
    return early + second


def mixed_bounds(scene: Scene, time: Tensor) -> Tensor:
    return (scene.points * time).clamp_(1e-6, 1) + (scene.points * time).clamp(min=0, max=0.2)


def write_out_of_place(scene: Scene, time: Tensor) -> Tensor:
    return torch.zeros(4).index_put((torch.tensor([1]),), time)


def one_of_each_row(scene: Scene, time: Tensor) -> Tensor:
    candidates = torch.stack([scene.points + time, scene.points * time], 1)
    chosen = nn.functional.one_hot(candidates[..., 0].argmax(-1), num_classes=2) > 0.5
    return candidates[chosen, :].reshape(8, 3)


def matrix_by_element(scene: Scene, time: Tensor) -> Tensor:
    matrix = torch.zeros(8, 3, 3)
    matrix[:, 0, 0] = scene.points[:, 0] * time
    return matrix


def chosen_from_a_list(scene: Scene, time: Tensor) -> Tensor:
    return [time, time + 1, time + 2][int(scene.parents[2])]


IDIOMS = [
    kinematic_chain, assertion, branch_on_a_constant, constant_mask,
    constant_mask_of_a_moving_tensor, write_by_a_constant_mask, value_by_a_moving_mask,
    row_by_a_moving_mask, inverse_of_a_constant, nearest_neighbours, number_of_a_constant,
    masked_mean, unique_rows, module_of_its_own, canvas_of_zeros, canvas_that_writes_another,
    mixed_bounds, write_out_of_place, chosen_from_a_list, one_of_each_row, matrix_by_element,
]  # fmt: skip


@pytest.mark.parametrize("function", IDIOMS, ids=lambda function: function.__name__)
def test_an_idiom_with_constants_is_a_graph_that_agrees_at_other_inputs(
    function: Callable[[Scene, Tensor], Tensor],
) -> None:
    scene = Scene(function).eval()
    folding = fold_constants(scene, [TIMES[0]])
    with torch.no_grad():
        for time in TIMES:
            torch.testing.assert_close(folding.graph(time), scene(time))
    torch.export.export(folding.graph, (TIMES[0],), strict=False)


REFUSED: dict[str, tuple[Callable[[Scene, Tensor], Tensor], bool]] = {
    "branch": (lambda scene, time: time if time > 0 else -time, False),
    "number": (lambda scene, time: scene.points * time.item(), False),
    "index": (lambda scene, time: [scene.points, -scene.points][int(time)], False),
    "mask": (lambda scene, time: scene.points[scene.points[:, 0] > time], True),
    "nonzero": (lambda scene, time: torch.nonzero(scene.points > time), True),
    "unique": (lambda scene, time: torch.unique(scene.points * time), True),
    "write through a view": (
        lambda scene, time: scene.points * float(scene.canvas.view(-1)[:1].copy_(time)),
        False,
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_value_of_an_input_is_refused_with_its_line(name: str) -> None:
    function, is_shape = REFUSED[name]
    with pytest.raises(ValueNeeded) as caught:
        fold_constants(Scene(function), [TIMES[0]])
    assert caught.value.is_shape is is_shape
    assert "test_partial_evaluation.py:" in caught.value.where
    assert "scene" in caught.value.where


def test_buffers_keep_their_values_where_forward_writes_them() -> None:
    def write(scene: Scene, time: Tensor) -> Tensor:
        return scene.canvas.add_(1) * time

    scene = Scene(write)
    fold_constants(scene, [TIMES[0]])
    assert scene.canvas.eq(0).all()


def test_constants_are_counted_without_the_parameters() -> None:
    folding = fold_constants(Scene(lambda scene, time: scene.points * time), [TIMES[0]])
    assert folding.counts == FoldedConstants(0, 0)
    folding = fold_constants(Scene(lambda scene, time: scene.points.exp() * time), [TIMES[0]])
    assert folding.counts == FoldedConstants(1, 8 * 3 * 4)
    (note,) = folding.describe()
    assert note == "1 operations that no input reaches are constants of 96 B."


def test_a_large_table_is_noted_with_its_line() -> None:
    def table(scene: Scene, time: Tensor) -> Tensor:
        grid = torch.arange(5_000_000).float() * scene.points.sum()
        return grid * time

    counted, large = fold_constants(Scene(table), [TIMES[0]]).describe()
    assert counted == "5 operations that no input reaches are constants of 19.1 MiB."
    assert "(grid = torch.arange(5_000_000)" in large
    assert large.endswith("a table of 19.1 MiB is stored in the file.")


def test_a_constant_that_changes_from_run_to_run_is_noted_with_its_line() -> None:
    folding = fold_constants(
        Scene(lambda scene, time: scene.points * time * random.random()), [TIMES[0]]
    )
    assert "random.random()" in folding.describe()[-1]
    assert "gives another value in each run" in folding.describe()[-1]
