"""Rules that compare one declared or drawn quantity with a limit: just within it, and beyond."""

import math
from types import MethodType, SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import Rows
from gsgen.contract.rules.interface.avatar_inputs import blend_weights_in_unit_range
from gsgen.contract.rules.interface.input_declarations import frames_fit_range, input_range_ordered
from gsgen.contract.rules.targets.visionary_drawing import visionary_fades_small
from gsgen.contract.spec.manifest import Bounds, Input


@pytest.mark.parametrize(
    ("range", "count"),
    [((0, 1), 0), ((0.5, 0.5), 0), ((0.8, 0.2), 1), ((-0.01, 1), 1), ((0, 1.01), 1)],
)
def test_blend_weights_of_arkit_lie_between_0_and_1(range: tuple[float, float], count: int) -> None:
    entries = [
        Input(name="face", role="expression", range=range, convention=convention)
        for convention in ("arkit-52", "flame")
    ]
    violations = list(blend_weights_in_unit_range.check(_declaring(*entries)))
    assert len(violations) == count


@pytest.mark.parametrize(
    ("sigma", "fades"), [(0.2, True), (0.31, True), (0.32, False), (5.0, False)]
)
def test_gaussians_below_a_third_of_a_pixel_fade(sigma: float, fades: bool) -> None:
    """The filter adds 0.1 px² to the variance: half of the opacity is left at that variance."""
    diagonal, focal = math.sqrt(12), 1304.0
    pixel = 2.2 * diagonal / 2 / focal  # in scene units, where all of the bounds are seen
    max_variance = np.full(8, np.float32((sigma * pixel) ** 2))
    generator = SimpleNamespace(bounds=Bounds((-1, -1, -1), (1, 1, 1)), antialias=None)
    emission = SimpleNamespace(subject=SimpleNamespace(generator=generator), rows_label="output g")
    rows = SimpleNamespace(
        emission=emission, max_variance=max_variance, drawn=np.ones(8, bool), drawn_count=8, start=0
    )
    (violation,) = visionary_fades_small.check(cast(Rows, rows))
    assert violation.invalid_rows is not None
    assert violation.invalid_rows.tolist() == [fades] * 8


@pytest.mark.parametrize(
    ("dtype", "range", "count"),
    [
        ("int32", (-(2.0**31), 2.0**31 - 1), 0),
        ("int32", (0.0, 2.0**31), 1),
        ("int32", (-(2.0**31) - 1, 0.0), 1),
        ("int32", (0.0, 7.5), 1),
        ("float32", (0.0, 7.5), 0),
        ("float32", (-3.4e38, 3.4e38), 0),
        ("float32", (0.0, 3.5e38), 1),
    ],
)
def test_ranges_are_numbers_of_the_inputs_type(
    dtype: str, range: tuple[float, float], count: int
) -> None:
    entry = Input(name="tokens", role="condition", range=range)
    graph = SimpleNamespace(input=lambda name: SimpleNamespace(dtype=dtype))
    assert len(list(input_range_ordered.check(_declaring(entry, graph=graph)))) == count


@pytest.mark.parametrize(
    ("range", "frames", "count"),
    [
        ((0.0, 0.0), 1, 0),
        ((5.0, 5.0), 1, 0),
        ((5.0, 5.0), 2, 1),
        ((1.7e9, 1.7e9 + 100), 1, 0),
        ((1.7e9, 1.7e9 + 512), 2, 0),
        ((1.7e9, 1.7e9 + 512), 3, 1),
        ((0.0, 1.0), 2**23, 0),
        ((-1.0, 0.0), 2**23 + 1, 1),
    ],
)
def test_frames_of_a_time_begin_at_different_numbers(
    range: tuple[float, float], frames: int, count: int
) -> None:
    entry = Input(name="time", role="time", range=range, frames=frames)
    assert len(list(frames_fit_range.check(_declaring(entry)))) == count


def _declaring(*inputs: Input, **facts: object) -> InspectedModel:
    """An inspected model whose manifest declares these inputs."""
    subject = SimpleNamespace(manifest=SimpleNamespace(inputs=inputs), **facts)
    subject.path_of = MethodType(InspectedModel.path_of, subject)
    return cast(InspectedModel, subject)
