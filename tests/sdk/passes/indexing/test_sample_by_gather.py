"""Sampling by Gather: the same values as ONNX Runtime's GridSample, and as torch's in float64."""

import numpy as np
import onnx_ir as ir
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.passes.indexing.sample_by_gather import SampleByGather
from support.passes import HEAD, operators, parsed, run, text_of


def sampling(
    shape: tuple[int, ...],
    points: tuple[int, int],
    *,
    align: bool = False,
    padding: str = "zeros",
    mode: str = "bilinear",
    dtype: str = "float",
    head: str = HEAD,
) -> ir.Model:
    n, c, h, w = shape
    p, q = points
    return parsed(
        f"g ({dtype}[{n},{c},{h},{w}] x, {dtype}[{n},{p},{q},2] grid) => ({dtype}[{n},{c},{p},{q}] y)"
        f'{{ y = GridSample <align_corners = {int(align)}, mode = "{mode}",'
        f' padding_mode = "{padding}"> (x, grid) }}',
        head,
    )


def oracle(x: np.ndarray, grid: np.ndarray, align: bool, padding: str) -> np.ndarray:
    sampled = torch.nn.functional.grid_sample(
        torch.tensor(x, dtype=torch.float64),
        torch.tensor(grid, dtype=torch.float64),
        mode="bilinear",
        padding_mode=padding,
        align_corners=align,
    )
    return sampled.numpy()


@settings(max_examples=25, deadline=None)
@given(
    shape=st.tuples(*[st.integers(1, 3)] * 2, *[st.integers(1, 7)] * 2),
    points=st.tuples(st.integers(1, 4), st.integers(1, 5)),
    align=st.booleans(),
    padding=st.sampled_from(["zeros", "border"]),
    seed=st.integers(0, 1000),
)
def test_sampling_by_gather_is_sampling(
    shape: tuple[int, ...], points: tuple[int, int], align: bool, padding: str, seed: int
) -> None:
    model = sampling(shape, points, align=align, padding=padding)
    rng = np.random.default_rng(seed)
    x = rng.normal(size=shape).astype(np.float32)
    grid = rng.uniform(-1.6, 1.6, (shape[0], *points, 2)).astype(np.float32)
    edges = rng.choice([-1, 1, 0, -1 + 1 / shape[3], 1 - 1 / shape[3]], grid.shape)
    grid = np.where(rng.random(grid.shape) < 0.3, edges, grid).astype(np.float32)
    (before,) = run(model, x=x, grid=grid)
    assert SampleByGather()(model).modified
    assert "GridSample" not in operators(model)
    (after,) = run(model, x=x, grid=grid)
    np.testing.assert_allclose(after, before, atol=4e-6)
    np.testing.assert_allclose(after, oracle(x, grid, align, padding), atol=2e-5)


@pytest.mark.parametrize("padding", ["zeros", "border"])
def test_far_infinite_and_nan_coordinates_neither_fail_nor_spread(padding: str) -> None:
    model = sampling((1, 2, 3, 4), (1, 6), padding=padding)
    x = np.random.default_rng(0).normal(size=(1, 2, 3, 4)).astype(np.float32)
    odd = [(1e30, 0), (-1e30, 0), (np.inf, 0), (0, -np.inf), (np.nan, 0), (0.25, -0.5)]
    grid = np.array(odd, np.float32)[None, None]
    SampleByGather()(model)
    (actual,) = run(model, x=x, grid=grid)
    assert np.isfinite(actual).all()
    finite_grid = np.where(np.isfinite(grid), grid, np.sign(np.nan_to_num(grid)) * 1e6)
    if padding == "border":
        finite_grid[0, 0, 4] = (-1e6, 0)  # NaN goes to the first pixel, as in torch
    else:
        finite_grid[0, 0, 4] = (1e6, 0)
    np.testing.assert_allclose(actual, oracle(x, finite_grid, False, padding), atol=1e-6)


def test_a_weight_of_float16_is_a_table_and_places_are_numbered_in_float32() -> None:
    """float16 cannot tell pixel 2049 from 2048."""
    shape = (1, 2, 60, 70)
    model = sampling(shape, (1, 50), dtype="float16", padding="border")
    rng = np.random.default_rng(3)
    x = rng.normal(size=shape).astype(np.float16)
    grid = rng.uniform(-1, 1, (1, 1, 50, 2)).astype(np.float16)
    SampleByGather()(model)
    (actual,) = run(model, x=x, grid=grid)
    assert actual.dtype == np.float16
    np.testing.assert_allclose(actual, oracle(x, grid, False, "border"), atol=2e-3)


def test_a_plane_that_is_a_weight_becomes_a_table_of_rows() -> None:
    model = sampling((1, 3, 4, 5), (1, 7), padding="border", align=True)
    x = np.random.default_rng(5).normal(size=(1, 3, 4, 5)).astype(np.float32)
    plane = model.graph.inputs[0]
    plane.const_value = ir.tensor(x, name="x")
    model.graph.inputs.remove(plane)
    model.graph.register_initializer(plane)
    grid = np.random.default_rng(6).uniform(-1, 1, (1, 1, 7, 2)).astype(np.float32)
    (before,) = run(model, grid=grid)
    SampleByGather()(model)
    np.testing.assert_allclose(run(model, grid=grid)[0], before, atol=1e-6)
    transposed = [node for node in model.graph if node.op_type == "Transpose"]
    assert len(transposed) == 1  # that of the result: the plane was turned beforehand


def test_the_mode_has_another_name_since_operator_set_20() -> None:
    head = '<ir_version: 9, opset_import: ["" : 20]> '
    model = sampling((1, 1, 3, 3), (2, 2), mode="linear", head=head)
    assert SampleByGather()(model).modified


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mode": "nearest"}, "nearest"),
        ({"mode": "bicubic"}, "bicubic"),
        ({"padding": "reflection"}, "reflection"),
        ({"shape": (1, 1, "H", 4)}, "not known"),
        ({"shape": (1, 1, 4097, 4096)}, "pixels"),
    ],
)
def test_other_sampling_modes_are_left_alone(change: dict, reason: str) -> None:
    model = sampling(**{"shape": (1, 1, 3, 4), "points": (2, 2)} | change)
    before = text_of(model)
    rewrite = SampleByGather()
    assert not rewrite(model).modified
    assert reason in rewrite.refusals[0].reason
    assert text_of(model) == before


@settings(max_examples=15, deadline=None)
@given(
    shape=st.tuples(*[st.integers(1, 2)] * 2, *[st.integers(1, 5)] * 3),
    points=st.tuples(st.integers(1, 2), st.integers(1, 3), st.integers(1, 4)),
    align=st.booleans(),
    padding=st.sampled_from(["zeros", "border"]),
    seed=st.integers(0, 1000),
)
def test_volumes_are_sampled_as_torch_samples_them(
    shape: tuple[int, ...], points: tuple[int, ...], align: bool, padding: str, seed: int
) -> None:
    n, channels, *sizes = shape
    dims = ",".join(map(str, points))
    model = parsed(
        f"g (float[{','.join(map(str, shape))}] x, float[{n},{dims},3] grid) => "
        f"(float[{n},{channels},{dims}] y) {{ y = GridSample <align_corners = {int(align)}, "
        f'mode = "linear", padding_mode = "{padding}"> (x, grid) }}',
        HEAD.replace("18", "20"),
    )
    rng = np.random.default_rng(seed)
    x = rng.normal(size=shape).astype(np.float32)
    grid = rng.uniform(-1.6, 1.6, (n, *points, 3)).astype(np.float32)
    edges = rng.choice([-1, 1, 0, -1 + 1 / sizes[-1], 1 - 1 / sizes[0]], grid.shape)
    grid = np.where(rng.random(grid.shape) < 0.3, edges, grid).astype(np.float32)
    assert SampleByGather()(model).modified
    assert "GridSample" not in operators(model)
    np.testing.assert_allclose(
        run(model, x=x, grid=grid)[0], oracle(x, grid, align, padding), atol=2e-5
    )
