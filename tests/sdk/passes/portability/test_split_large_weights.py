"""Weights that are too large to bind are split, and looked up or multiplied part by part."""

import numpy as np
import onnx_ir as ir
import pytest

from gsgen.sdk.passes.portability.split_large_weights import SplitLargeWeights
from support.passes import parsed, run, text_of


def with_weight(text: str, array: np.ndarray, **more: np.ndarray) -> ir.Model:
    model = parsed(text)
    for name, inputs in {"w": array, **more}.items():
        value = next(value for value in model.graph.inputs if value.name == name)
        model.graph.inputs.remove(value)
        value.const_value = ir.tensor(inputs, name=name)
        model.graph.register_initializer(value)
    return model


def sizes(model: ir.Model) -> list[int]:
    return [value.const_value.nbytes for value in model.graph.initializers.values()]


RNG = np.random.default_rng(0)


@pytest.mark.parametrize("kind", ["int64", "int32"])
@pytest.mark.parametrize("rows", [5, 6, 12, 13])
def test_a_table_is_looked_up_part_by_part(kind: str, rows: int) -> None:
    """Three rows of 24 bytes fit into 80; places may be counted from the end."""
    table = RNG.normal(size=(rows, 3, 2)).astype(np.float32)
    text = f"g (float[{rows},3,2] w, {kind}[2,4] i) => (float[2,4,3,2] y) {{ y = Gather (w, i) }}"
    model = with_weight(text, table)
    i = RNG.integers(-rows, rows, (2, 4)).astype(kind)
    i[0] = [0, -1, 2, 3]
    (before,) = run(model, i=i)
    rewrite = SplitLargeWeights(80)
    assert rewrite(model).modified
    assert rewrite.changed == ["w"]
    assert max(sizes(model)) <= 80
    np.testing.assert_array_equal(run(model, i=i)[0], before)
    assert not rewrite(model).modified


def test_a_table_is_split_along_the_axis_that_is_looked_up() -> None:
    table = RNG.normal(size=(2, 10)).astype(np.float32)
    model = with_weight(
        "g (float[2,10] w, int64[3] i) => (float[2,3] y) { y = Gather <axis = 1> (w, i) }", table
    )
    SplitLargeWeights(30)(model)
    (actual,) = run(model, i=np.array([9, 0, 4]))
    np.testing.assert_array_equal(actual, table[:, [9, 0, 4]])


PRODUCTS = {
    "columns": "g (float[4,6] w, float[5,4] x) => (float[5,6] y) { y = MatMul (x, w) }",
    "columns of a stack": "g (float[4,6] w, float[2,5,4] x) => (float[2,5,6] y) { y = MatMul (x, w) }",
    "rows": "g (float[4,6] w, float[6,5] x) => (float[4,5] y) { y = MatMul (w, x) }",
    "Gemm": "g (float[4,6] w, float[5,4] x, float[6] b) => (float[5,6] y) { y = Gemm <alpha = 0.5, beta = 2.0> (x, w, b) }",
    "Gemm, transposed": "g (float[4,6] w, float[5,6] x) => (float[5,4] y) { y = Gemm <transB = 1> (x, w) }",
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_a_factor_is_split_where_its_product_is_joined(name: str) -> None:
    more = {"b": RNG.normal(size=6).astype(np.float32)} if "b)" in PRODUCTS[name] else {}
    model = with_weight(PRODUCTS[name], RNG.normal(size=(4, 6)).astype(np.float32), **more)
    shape = list(model.graph.inputs[0].shape)
    x = RNG.normal(size=shape).astype(np.float32)
    (before,) = run(model, x=x)
    assert SplitLargeWeights(40)(model).modified
    assert max(sizes(model)) <= 40
    np.testing.assert_allclose(run(model, x=x)[0], before, rtol=1e-6, atol=1e-6)


UNSPLITTABLE_MODELS = {
    "reads it whole": "g (float[9,3] w, float[3] x) => (float[9,3] y) { y = Mul (w, x) }",
    "parts along axis": "g (float[9,3] w, int64[2] i) => (float[2,3] y) { y = Gather (w, i) }",
}


@pytest.mark.parametrize("reason", UNSPLITTABLE_MODELS)
def test_unsplittable_weights_are_left_alone(reason: str) -> None:
    model = with_weight(UNSPLITTABLE_MODELS[reason], RNG.normal(size=(9, 3)).astype(np.float32))
    before = text_of(model)
    rewrite = SplitLargeWeights(100 if "whole" in reason else 10)
    assert not rewrite(model).modified
    assert reason in rewrite.refusals[0].reason
    assert text_of(model) == before


def test_a_weight_that_one_operator_reads_twice_is_left_alone() -> None:
    text = "g (float[3,3] w, float[3,3] x) => (float[3,3] y) { p = MatMul (w, w) y = Add (p, x) }"
    model = with_weight(text, RNG.normal(size=(3, 3)).astype(np.float32))
    before = text_of(model)
    rewrite = SplitLargeWeights(16)
    assert not rewrite(model).modified
    assert "reads it twice" in rewrite.refusals[0].reason
    assert text_of(model) == before


def test_a_large_output_is_named_with_the_rows_that_fit() -> None:
    model = parsed("g (float[100,10] x) => (float[100,10] gaussians) { gaussians = Neg (x) }")
    rewrite = SplitLargeWeights(2000)
    assert not rewrite(model).modified
    assert rewrite.refusals[0].where == "gaussians"
    assert "50 rows fit" in rewrite.refusals[0].reason
