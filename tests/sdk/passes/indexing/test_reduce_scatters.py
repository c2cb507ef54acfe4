"""Scatters with a reduction, as a Gather and a Reduce: the values of NumPy's ufunc.at."""

import numpy as np
import onnx_ir as ir
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.passes.indexing.reduce_scatters import ReduceScatters
from support.passes import HEAD, operators, parsed, run

UFUNCS = {"add": np.add, "mul": np.multiply, "max": np.maximum, "min": np.minimum}


def scatter(
    kind: str, attributes: str, x: str, u: str, indices: np.ndarray, shape: str
) -> ir.Model:
    numbers = ", ".join(map(str, indices.reshape(-1)))
    size = ",".join(map(str, indices.shape))
    return parsed(
        f"g ({x} x, {u} u) => ({shape} y) <int64[{size}] i = {{{numbers}}}> "
        f"{{ y = {kind} <{attributes}> (x, i, u) }}",
        HEAD,
    )


@settings(max_examples=20, deadline=None)
@given(
    reduction=st.sampled_from(sorted(UFUNCS)),
    rows=st.integers(1, 6),
    updates=st.integers(1, 12),
    width=st.integers(1, 3),
    seed=st.integers(0, 1000),
)
def test_scattered_rows_are_reduced(
    reduction: str, rows: int, updates: int, width: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    indices = rng.integers(-rows, rows, (updates, 1))
    x, u = (rng.normal(size=(n, width)).astype(np.float32) for n in (rows, updates))
    model = scatter(
        "ScatterND",
        f'reduction = "{reduction}"',
        f"float[{rows},{width}]",
        f"float[{updates},{width}]",
        indices,
        f"float[{rows},{width}]",
    )
    assert ReduceScatters()(model).modified
    assert "ScatterND" not in operators(model)
    expected = x.astype(np.float64)
    UFUNCS[reduction].at(expected, indices[:, 0], u)
    np.testing.assert_allclose(run(model, x=x, u=u)[0], expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1, -1])
@pytest.mark.parametrize("reduction", UFUNCS)
def test_elements_are_reduced_along_an_axis(reduction: str, axis: int) -> None:
    indices = np.array([[2, -1, 0], [1, 1, 1]])
    model = scatter(
        "ScatterElements",
        f'axis = {axis}, reduction = "{reduction}"',
        "float[3,4]",
        "float[2,3]",
        indices,
        "float[3,4]",
    )
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=(3, 4)).astype(np.float32), rng.normal(size=(2, 3)).astype(np.float32)
    (before,) = run(model, x=x, u=u)
    assert ReduceScatters()(model).modified
    np.testing.assert_allclose(run(model, x=x, u=u)[0], before, rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("g (float[3] x, int64[1,1] i, float[1] u) => (float[3] y) ", "not known before"),
        ("g (float[N] x, float[1] u) => (float[N] y) <int64[1,1] i = {0}> ", "shape"),
    ],
)
def test_a_scatter_that_cannot_be_rewritten_says_why(text: str, reason: str) -> None:
    rewrite = ReduceScatters()
    model = parsed(text + '{ y = ScatterND <reduction = "max"> (x, i, u) }')
    assert not rewrite(model).modified
    assert reason in rewrite.refusals[0].reason


def test_groups_that_are_mostly_padding_stay() -> None:
    indices = np.zeros((400, 1), np.int64)
    model = scatter(
        "ScatterND", 'reduction = "add"', "float[400]", "float[400]", indices, "float[400]"
    )
    rewrite = ReduceScatters()
    assert not rewrite(model).modified
    assert "400 updates" in rewrite.refusals[0].reason


def test_a_scatter_that_replaces_elements_is_left_to_another_pass() -> None:
    model = scatter(
        "ScatterND", 'reduction = "none"', "float[3]", "float[1]", np.array([[1]]), "float[3]"
    )
    rewrite = ReduceScatters()
    assert not rewrite(model).modified
    assert rewrite.refusals == []
