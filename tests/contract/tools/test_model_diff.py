"""Differences of two models' outputs: the largest of all probes is reported."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gsgen.contract.tools.model_diff import _output_differences


def execution(outputs: list[np.ndarray]) -> Any:
    """Return runs of a model, one with each output."""
    return SimpleNamespace(
        runs=[SimpleNamespace(sample=index) for index in range(len(outputs))],
        samples=[SimpleNamespace(outputs={"g": array}) for array in outputs],
    )


@pytest.mark.parametrize(
    ("differences", "label", "rows"),
    [([0.5, 2, 1], "probe 1", 1), ([3, 2, 1], "probe 0", 1), ([0, 0, 0], "", 0)],
)
def test_the_probe_of_the_largest_difference_is_named(
    differences: list[float], label: str, rows: int
) -> None:
    subject = cast(
        Any,
        SimpleNamespace(
            declared_gaussians=SimpleNamespace(name="g"),
            declared_appearance=None,
            declared_count=None,
            declared_cells=None,
        ),
    )
    first = [np.zeros((4, 10), np.float32) for _ in differences]
    second = [array.copy() for array in first]
    for array, difference in zip(second, differences, strict=True):
        array[2, 5] = difference
    labels = [f"probe {index}" for index in range(len(differences))]
    runs = [execution(first), execution(second)]
    (worst_difference,) = _output_differences(subject, subject, runs, labels)
    assert (worst_difference.largest, worst_difference.rows) == (max(differences), rows)
    assert worst_difference == type(worst_difference)("gaussians", max(differences), rows, label)
