"""Rows of a few numbers computed as columns: the same numbers, whatever is done to the rows."""

import numpy as np
import onnx_ir as ir
import pytest

from gsgen.sdk.passes.rows import work_in_columns
from gsgen.sdk.passes.rows.work_in_columns import RewriteRowsToColumns
from support.passes import operators, parsed, run, text_of

WEIGHTS = (
    "<float two = {2}, float[3] three = {1, -2, 0.5}, float[1,3] row = {3, 0.25, -1}, "
    "int64[1] last = {-1}, int64[1] one = {1}, int64[1] mid = {2}, int64[2] both = {1, 2}, "
    "int64[2] wide = {70000, 3}, int64[3] cube = {70000, 3, 3}, int64[2] flat = {70000, 9}, "
    "int64[1] zero = {0}, int64[1] far = {3}, int64[2] sizes = {1, 2}, int64[2] picked = {2, 0}, "
    "int64 second = {1}, float low = {-0.5}, float high = {0.5}>"
)
# Of x and z [70000, 3] and c [70000, 1] to y [70000, …].
ROWS = {
    "sums of products": ("m = Mul (x, z) y = ReduceSum <keepdims = 0> (m, last)", "N"),
    "kept sums": ("m = Mul (x, z) y = ReduceSum <keepdims = 1> (m, last)", "N,A"),
    "length": ("l = ReduceL2 <keepdims = 1> (x, last) y = Div (x, l)", "N,A"),
    "largest": (
        "a = ReduceMax <keepdims = 1> (x, last) b = ReduceMin <keepdims = 1> (x, one) y = Sub (a, b)",
        "N,A",
    ),
    "spread": ("e = Expand (c, wide) y = Mul (x, e)", "N,A"),
    "spread by itself": ("y = Add (x, c)", "N,A"),
    "numbers": (
        "a = Mul (x, two) b = Add (a, three) d = Sub (row, b) e = Mul (d, t) y = Mul (e, c)",
        "N,A",
    ),
    "joined and cut": (
        "j = Concat <axis = 1> (x, c, z) s = Slice (j, one, far, one) y = Mul (s, c)",
        "N,A",
    ),
    "picked": ("g = Gather <axis = 1> (x, picked) y = Mul (g, c)", "N,A"),
    "one picked": (
        "g = Gather <axis = 1> (x, second) h = Mul (g, g) y = Unsqueeze (h, one)",
        "N,A",
    ),
    "one number for a column": (
        "s = ReduceSum <keepdims = 0> (x, last) u = Mul (s, t) y = Mul (u, two)",
        "N",
    ),
    "split": ("a, b = Split <axis = -1> (x, sizes) d = Mul (b, a) y = Mul (d, c)", "N,A"),
    "selected": ("b = Less (x, z) n = Not (b) w = Where (n, x, c) y = Mul (w, c)", "N,A"),
    "bounded": ("k = Clip (x, low, high) m = Max (k, z, c) o = Min (m, two) y = Mul (o, c)", "N,A"),
    "each": (
        "e = Exp (x) s = Sigmoid (e) q = Sqrt (s) r = Reciprocal (q) n = Neg (r) y = Mul (n, c)",
        "N,A",
    ),
    "matrices": (
        "j = Concat <axis = 1> (x, z, x) m = Reshape (j, cube) u = Unsqueeze (z, one) p = Mul (m, u) "
        "q = Transpose <perm = [0, 2, 1]> (p) r = Mul (q, m) y = ReduceSum <keepdims = 0> (r, both)",
        "N",
    ),
    "cast": ("b = Greater (x, z) f = Cast <to = 1> (b) y = Mul (f, c)", "N,A"),
    "read twice": (
        "m = Mul (x, c) s = ReduceSum <keepdims = 1> (m, last) o = Exp (m) y = Mul (o, s)",
        "N,A",
    ),
}


def model_of(body: str, dims: str) -> ir.Model:
    return parsed(
        "g (float[70000,3] x, float[70000,3] z, float[70000,1] c, float[1] t) => "
        f"(float[{dims}] y) {WEIGHTS} {{ {body} }}"
    )


def inputs() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    result = {"x": (70000, 3), "z": (70000, 3), "c": (70000, 1), "t": (1,)}
    return {name: rng.normal(size=size).astype(np.float32) for name, size in result.items()}


@pytest.mark.parametrize("name", ROWS)
def test_column_form_equals_row_form(name: str, monkeypatch) -> None:
    monkeypatch.setattr(work_in_columns, "_MAX_COST_RATIO", np.inf)
    model, values = model_of(*ROWS[name]), inputs()
    (before,) = run(model, **values)
    assert RewriteRowsToColumns()(model).modified
    kinds = {"Expand", "Gather", "Slice", "Transpose", "ReduceSum", "ReduceL2", "ReduceMax"}
    assert not kinds & operators(model)
    assert model.graph.outputs[0].name == "y"
    (after,) = run(model, **values)
    np.testing.assert_allclose(after, before, rtol=2e-5, atol=1e-6)


def test_pass_is_idempotent() -> None:
    model = model_of(*ROWS["matrices"])
    assert RewriteRowsToColumns()(model).modified
    assert not RewriteRowsToColumns()(model).modified


@pytest.mark.parametrize(
    "body",
    [
        "y = Mul (x, z)",  # as fast as it is
        "a = Slice (x, zero, mid, one) y = Exp (a)",
        "y = Concat <axis = 1> (x, c)",
    ],
)
def test_rows_that_are_fast_enough_stay(body: str) -> None:
    model = model_of(body, "N,A")
    before = text_of(model)
    assert not RewriteRowsToColumns()(model).modified
    assert text_of(model) == before


def test_few_rows_stay_for_a_launch_costs_more() -> None:
    body, dims = ROWS["matrices"]
    text = (
        "g (float[700,3] x, float[700,3] z, float[700,1] c, float[1] t) => "
        f"(float[{dims}] y) {WEIGHTS} {{ {body} }}"
    ).replace("70000", "700")
    assert not RewriteRowsToColumns()(parsed(text)).modified


def test_wide_rows_and_rows_of_another_length_stay(monkeypatch) -> None:
    monkeypatch.setattr(work_in_columns, "_MAX_COST_RATIO", np.inf)
    text = (
        "g (float[70000,40] x, float[70000] z) => (float[70000,40] y, float[1,70000] w) <int64[1] zero = {0}> "
        "{ y = Exp (x) w = Unsqueeze (z, zero) }"
    )
    assert not RewriteRowsToColumns()(parsed(text)).modified


def test_shared_results_are_reassembled_into_rows(monkeypatch) -> None:
    monkeypatch.setattr(work_in_columns, "_MAX_COST_RATIO", np.inf)
    text = (
        "g (float[70000,3] x, float[70000,1] c, float[3,20] k) => (float[70000,20] y, float[70000,3] w) "
        "{ e = Exp (c) w = Mul (x, e) y = MatMul (w, k) }"
    )
    model, rng = parsed(text), np.random.default_rng(6)
    inputs = {
        k: rng.normal(size=s).astype(np.float32)
        for k, s in (("x", (70000, 3)), ("c", (70000, 1)), ("k", (3, 20)))
    }
    before = run(model, **inputs)
    assert RewriteRowsToColumns()(model).modified
    for expected, actual in zip(before, run(model, **inputs), strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-5)
