"""Tables in 16 bits a number: never farther off than float16, and read back by the graph's own sums."""

import tracemalloc

import hypothesis.extra.numpy as hnp
import numpy as np
import onnx
import onnx_ir as ir
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.float16.to_float16 import ToFloat16
from gsgen.sdk.float16.weight_tables import MIN_TABLE_ELEMENTS, half_table
from support.models.small_models import model, weight
from support.passes import run

ROWS = MIN_TABLE_ELEMENTS


def drawn(columns: int, spread: float, far: float, tail: bool) -> np.ndarray:
    rng = np.random.default_rng(columns)
    numbers = rng.standard_t(2, (ROWS, columns)) if tail else rng.normal(size=(ROWS, columns))
    table = far * (1 + np.arange(columns)) + spread * numbers
    return np.clip(table, -65504, 65504).astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(
    columns=st.integers(1, 5),
    spread=st.sampled_from([0.0, 1e-6, 1e-2, 1.0, 300.0]),
    far=st.sampled_from([0.0, -0.3, 7.0, 9000.0]),
    tail=st.booleans(),
)
def test_a_table_is_as_close_as_the_closer_of_two_forms(
    columns: int, spread: float, far: float, tail: bool
) -> None:
    array = drawn(columns, spread, far, tail)
    result = half_table(array)
    assert result.numbers.nbytes == array.nbytes // 2
    assert result.decoded.dtype == np.float32
    exact = array.astype(np.float64)
    off = np.abs(result.decoded - exact)
    half = np.square(array.astype(np.float16) - exact).mean()
    assert np.square(off).mean() <= half
    if result.step is not None:
        width = exact.max(axis=0) - exact.min(axis=0)
        # Half a step, and what float32 rounds in finding the step, scaling and moving.
        allowed = width / 65535 * 0.51 + 2.0**-22 * (np.abs(exact).max(axis=0) + width)
        assert (off <= allowed).all()


@settings(max_examples=100, deadline=None)
@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=6),
        elements=st.floats(-65504, 65504, width=32),
    )
)
def test_a_small_table_is_float16(array: np.ndarray) -> None:
    result = half_table(array)
    assert result.step is None
    np.testing.assert_array_equal(result.numbers, array.astype(np.float16))


@pytest.mark.parametrize("number", [0.0, 0.1, -1234.567])
def test_a_column_of_one_number_keeps_it(number: float) -> None:
    array = np.stack([np.full(ROWS, number), np.linspace(-3, 40, ROWS)], axis=1)
    result = half_table(array.astype(np.float32))
    np.testing.assert_array_equal(result.decoded[:, 0], np.float32(number))


def test_whole_numbers_stay_whole() -> None:
    levels = np.random.default_rng(1).integers(0, 12, (ROWS, 1)).astype(np.float32)
    np.testing.assert_array_equal(half_table(levels).decoded, levels)


def test_each_column_has_steps_of_its_own() -> None:
    rng = np.random.default_rng(2)
    array = rng.uniform(0, 1, (ROWS, 2)).astype(np.float32) * np.float32([1e-3, 1e3])
    off = np.abs(half_table(array).decoded - array).max(axis=0)
    assert off[0] <= 1e-3 / 131070 * 1.01
    assert off[1] <= 1e3 / 131070 * 1.01


@pytest.mark.parametrize("shape", [(8, 1024), (2, 8, 40, 30), (1, 8, 5, 300_000)])
def test_channels_have_steps_of_their_own(shape: tuple[int, ...]) -> None:
    """A plane's channels lie behind one another, wherever their axis is."""
    rng = np.random.default_rng(4)
    axis = shape.index(8)
    reach = np.logspace(-4, 3, 8).reshape([8 if k == axis else 1 for k in range(len(shape))])
    array = (rng.uniform(0, 1, shape) * reach).astype(np.float32)
    result = half_table(array)
    assert result.numbers.shape == shape
    assert result.step is not None
    assert result.step.shape == reach.shape[axis:]
    off = np.abs(result.decoded - array.astype(np.float64))
    # Half a step, and what float32 rounds.
    assert (off <= reach * (0.51 / 65535 + 2.0**-22)).all()


def test_subnormal_steps_are_not_used() -> None:
    """A step below 2⁻¹²⁶ is zero on some of them, and not on others."""
    array = np.random.default_rng(5).uniform(0, 1e-36, (ROWS, 2)).astype(np.float32)
    result = half_table(array)
    assert result.step is None or not ((result.step > 0) & (result.step < 2.0**-126)).any()


@pytest.mark.parametrize("far", [0.0, 1e4])
def test_a_large_table_takes_little_memory_besides(far: float) -> None:
    """In either form: 2 bytes a number, while float64 copies would take 8 each."""
    array = np.random.default_rng(6).standard_normal((1 << 20, 4), np.float32)
    array[0] = far
    tracemalloc.start()
    result = half_table(array)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (result.step is None) == (far > 0)
    assert peak < 4.5 * array.size


GRAPH = """
read (float[1] x) => (float[4096,3] y, float[4096,3] z) {
    y = Mul (table, x)
    z = Add (table, x)
}
"""


@pytest.mark.parametrize("kept_outputs", [("y", "z"), ("z",), ()])
def test_a_graph_reads_what_the_table_says(kept_outputs: tuple[str, ...]) -> None:
    """Readers in float32 get the numbers to the bit; one in float16 gets them rounded."""
    table = np.random.default_rng(3).normal(5, 1, (ROWS, 3)).astype(np.float32)
    proto = onnx.shape_inference.infer_shapes(model(GRAPH, weight("table", table)))
    graph = ir.serde.deserialize_model(proto)
    ToFloat16(kept_outputs, stored=["table"], outputs=False)(graph)
    kind = ir.DataType.UINT16 if kept_outputs else ir.DataType.FLOAT16
    assert graph.graph.initializers["table"].dtype == kind
    x = np.array([0.7], np.float32)
    y, z = run(graph, optimise=True, x=x)
    decoded = half_table(table).decoded
    for name, actual, expected in (("y", y, decoded * x), ("z", z, decoded + x)):
        if name in kept_outputs:
            np.testing.assert_array_equal(actual, expected)
        else:
            np.testing.assert_allclose(actual, expected, rtol=2e-3)
