"""The first operation whose result changes between two equal runs of a module, with its line."""

import random
import time as clocks
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gsgen.sdk.exporting.tracing.repeatability import find_unrepeatable


class Calls(nn.Module):
    """A module that calls a function of its buffer and its input."""

    def __init__(self, function: Callable[[Tensor, Tensor], Tensor]) -> None:
        super().__init__()
        self.register_buffer("rest", torch.rand(4, 3))
        self.function = function

    def forward(self, time: Tensor) -> Tensor:
        return 2 * self.function(self.rest, time) + 1


CHANGING: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "torch": lambda rest, time: rest + torch.rand(3) * time,
    "dropout": lambda rest, time: nn.functional.dropout(rest * time),
    "python": lambda rest, time: rest * time * random.random(),
    "numpy": lambda rest, time: rest * torch.from_numpy(np.random.default_rng().random(3)),
    "clock": lambda rest, time: rest * time + clocks.perf_counter(),
    "state": lambda rest, time: rest.add_(time),
}


@pytest.mark.parametrize("name", CHANGING)
def test_a_value_that_changes_is_found_with_its_line(name: str) -> None:
    result = find_unrepeatable(Calls(CHANGING[name]), [torch.full((1,), 0.5)])
    assert result is not None
    assert "test_repeatability.py" in result.where
    assert "lambda rest, time" in result.where
    assert result.is_random is (name in ("torch", "dropout"))


def matrix_by_element(rest: Tensor, time: Tensor) -> Tensor:
    matrix = torch.empty(4, 3, 3)
    matrix[...] = 0
    matrix[:, 0, 0] = rest[:, 0] * time
    return matrix.transpose(1, 2)


UNCHANGING: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "strided writes": matrix_by_element,
    "numbers that are NaN": lambda rest, time: rest * time * float("nan"),
    "seeded": lambda rest, time: (
        rest * torch.rand(3, generator=torch.Generator().manual_seed(1)) * time
    ),
    "integers and booleans": lambda rest, time: (rest > time).long().sum(0).float(),
}


@pytest.mark.parametrize("name", UNCHANGING)
def test_a_module_that_repeats_itself_has_no_such_line(name: str) -> None:
    assert find_unrepeatable(Calls(UNCHANGING[name]), [torch.full((1,), 0.5)]) is None
