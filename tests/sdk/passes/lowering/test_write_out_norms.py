"""Norms and reductions written out: the same numbers as ONNX Runtime's own, and as numpy's."""

import numpy as np
import pytest

from gsgen.sdk.passes.lowering.write_out_norms import WriteOutNorms
from gsgen.sdk.passes.lowering.write_out_reductions import WriteOutReductions
from support.passes import HEAD, operators, parsed, run

TOLERANCE = {"float": 2e-5, "float16": 4e-3, "double": 1e-12}
DTYPES = {"float": np.float32, "float16": np.float16, "double": np.float64}
HEADS = {opset: HEAD.replace("18", str(opset)) for opset in (13, 17, 18, 21, 23)}


def numbers(shape: tuple[int, ...], dtype: str, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.5, 2, shape).astype(DTYPES[dtype])


NORMS = {
    "last axis": (17, "LayerNormalization <axis = -1> (x, s, b)", [5]),
    "no bias": (17, "LayerNormalization <axis = -1, epsilon = 0.1> (x, s)", [5]),
    "two axes": (17, "LayerNormalization <axis = 2> (x, s, b)", [4, 5]),
    "all axes": (18, "LayerNormalization <axis = 0> (x, s, b)", [2, 6, 4, 5]),
    "instances": (17, "InstanceNormalization (x, s, b)", [6]),
    "instances 18": (18, "InstanceNormalization <epsilon = 0.5> (x, s, b)", [6]),
    "groups 21": (21, "GroupNormalization <num_groups = 3> (x, s, b)", [6]),
    "root mean square": (23, "RMSNormalization <axis = -1> (x, s)", [5]),
    "root, two axes": (23, "RMSNormalization <axis = -2, epsilon = 0.1> (x, s)", [4, 5]),
    "length": (18, "LpNormalization <axis = 1> (x)", [5]),
    "length of one": (17, "LpNormalization <axis = -1, p = 1> (x)", [5]),
    "mean and variance": (18, "MeanVarianceNormalization <axes = [0, 2, 3]> (x)", [5]),
}


# ONNX Runtime's CPU has no kernel for these, so there is nothing to compare with.
UNSUPPORTED_NORMS = {
    ("length", "float16"),
    ("length of one", "float16"),
    ("mean and variance", "float16"),
    ("mean and variance", "double"),
    ("instances", "double"),
    ("instances 18", "double"),
}
CASES = [
    (name, dtype) for name in NORMS for dtype in DTYPES if (name, dtype) not in UNSUPPORTED_NORMS
]


@pytest.mark.parametrize(("name", "dtype"), CASES)
def test_a_norm_keeps_its_value(name: str, dtype: str) -> None:
    opset, body, sizes = NORMS[name]
    kind = body.split()[0]
    size = ",".join(map(str, sizes))
    text = f"g ({dtype}[2,6,4,5] x, {dtype}[{size}] s, {dtype}[{size}] b) => ({dtype}[2,6,4,5] y) {{ y = {body} }}"
    model = parsed(text, HEADS[opset])
    inputs = {"x": numbers((2, 6, 4, 5), dtype), "s": numbers(tuple(sizes), dtype, 1)}
    inputs["b"] = numbers(tuple(sizes), dtype, 2)
    (before,) = run(model, **inputs)
    assert WriteOutNorms()(model).modified
    assert kind not in operators(model)
    (after,) = run(model, **inputs)
    assert after.dtype == before.dtype
    scale = np.abs(before.astype(np.float64)).max()
    # The standard lets a GroupNormalization of doubles be computed in float32.
    allowed = TOLERANCE["float" if kind == "GroupNormalization" else dtype]
    allowed = max(allowed, TOLERANCE[dtype])
    np.testing.assert_allclose(after, before, rtol=0, atol=scale * allowed)
    assert not WriteOutNorms()(model).modified


def test_groups_of_operator_set_18_are_scaled_as_the_formula_says() -> None:
    """ONNX Runtime's CPU computes it by the function of the standard; here is the formula."""
    text = "g (float[2,6,4] x, float[3] s, float[3] b) => (float[2,6,4] y) {y = GroupNormalization <num_groups = 3> (x, s, b) }"
    model = parsed(text)
    x, s, b = (numbers(shape, "float", k) for k, shape in enumerate([(2, 6, 4), (3,), (3,)]))
    assert WriteOutNorms()(model).modified
    (actual,) = run(model, x=x, s=s, b=b)
    grouped = x.astype(np.float64).reshape(2, 3, -1)
    centered_groups = grouped - grouped.mean(axis=2, keepdims=True)
    centered_groups /= np.sqrt(grouped.var(axis=2, keepdims=True) + 1e-5)
    expected = (centered_groups * s[:, None] + b[:, None]).reshape(2, 6, 4)
    np.testing.assert_allclose(actual, expected, atol=2e-5)


def test_all_three_results_of_a_layer_norm_are_written_out() -> None:
    text = (
        "g (float[3,4] x, float[4] s) => (float[3,4] y, float[3,1] m, float[3,1] i) "
        "{ y, m, i = LayerNormalization (x, s) }"
    )
    model, x, s = parsed(text), numbers((3, 4), "float"), numbers((4,), "float", 1)
    before = run(model, x=x, s=s)
    assert WriteOutNorms()(model).modified
    for expected, actual in zip(before, run(model, x=x, s=s), strict=True):
        np.testing.assert_allclose(actual, expected, atol=1e-5)


def test_a_length_of_zero_gives_what_onnx_runtime_gives() -> None:
    model = parsed("g (float[2,3] x) => (float[2,3] y) { y = LpNormalization (x) }")
    x = np.array([[0, 0, 0], [3, 0, 4]], np.float32)
    (before,) = run(model, x=x)
    WriteOutNorms()(model)
    np.testing.assert_array_equal(run(model, x=x)[0], before)


def test_a_norm_inside_a_branch_and_of_symbolic_size_is_written_out() -> None:
    text = (
        "g (bool c, float[N,4,M] x, float[2] s) => (float[N,4,M] y) { y = If (c) <"
        "then_branch = t () => (float[N,4,M] a) { a = GroupNormalization <num_groups = 2> (x, s, s) }, "
        "else_branch = e () => (float[N,4,M] b) { b = Neg (x) }> }"
    )
    model, x = parsed(text), numbers((2, 4, 3), "float")
    inputs = {"c": np.array(True), "x": x, "s": numbers((2,), "float", 1)}
    assert WriteOutNorms()(model).modified
    assert "GroupNormalization" not in operators(model)
    assert run(model, **inputs)[0].shape == x.shape


# ---- Reductions ------------------------------------------------------------------------------

REDUCTIONS = ["ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceSumSquare"]
AXES = {
    "one": (18, "<keepdims = 0>", "a", [1]),
    "kept": (18, "<keepdims = 1>", "a", [0, -1]),
    "all": (18, "<keepdims = 1>", "", None),
    "attribute": (13, "<axes = [1], keepdims = 0>", "", None),
    "old": (11, "<axes = [-1]>", "", None),
    "empty": (18, "", "a", []),
}


@pytest.mark.parametrize("dtype", ["float", "double"])
@pytest.mark.parametrize("where", AXES)
@pytest.mark.parametrize("kind", REDUCTIONS)
def test_a_reduction_keeps_its_value(kind: str, where: str, dtype: str) -> None:
    opset, attributes, argument, axes = AXES[where]
    weight = "" if axes is None else f"<int64[{len(axes)}] a = {{{', '.join(map(str, axes))}}}>"
    arguments = f"x, {argument}" if argument else "x"
    open_dims = "I,K" if where in ("one", "attribute") else "I,J,K"
    text = f"g ({dtype}[3,4,5] x) => ({dtype}[{open_dims}] y) {weight} {{ y = {kind} {attributes} ({arguments}) }}"
    model = parsed(text, HEAD.replace("18", str(opset)))
    x = np.abs(numbers((3, 4, 5), dtype)) + 0.1
    (before,) = run(model, x=x)
    assert WriteOutReductions()(model).modified
    assert kind not in operators(model)
    np.testing.assert_allclose(run(model, x=x)[0], before, rtol=1e-5)


def test_sums_of_large_powers_neither_overflow_nor_lose_infinity() -> None:
    text = "g (float[4,2] x) => (float[4] y) <int64[1] a = {1}> { y = ReduceLogSumExp <keepdims = 0> (x, a) }"
    model = parsed(text)
    WriteOutReductions()(model)
    x = np.array([[1000, 1000], [-1000, -1001], [np.inf, 1], [-np.inf, -np.inf]], np.float32)
    expected = [1000 + np.log(2), -1000 + np.log(1 + np.exp(-1)), np.inf, -np.inf]
    np.testing.assert_allclose(run(model, x=x)[0], expected, rtol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "g (int32[3] x) => (int32[N] y) { y = ReduceL1 (x) }",
        "g (float[3] x) => (float[3] y) { y = ReduceL2 <noop_with_empty_axes = 1> (x) }",
        "g (float[3] x) => (float[3] y) <int64[0] none = {}> "
        "{ y = ReduceL2 <noop_with_empty_axes = 1> (x, none) }",
    ],
)
def test_reductions_of_integers_and_idle_ones_are_left_alone(text: str) -> None:
    assert not WriteOutReductions()(parsed(text)).modified
