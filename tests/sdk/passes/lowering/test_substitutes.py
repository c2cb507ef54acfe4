"""Operators written with others give what ONNX Runtime gives, at ordinary and at odd numbers."""

import numpy as np
import pytest

from gsgen.contract.spec.targets import load_target
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.passes.lowering.select_extremes import SelectExtremes
from gsgen.sdk.passes.lowering.write_out_activations import WriteOutActivations
from gsgen.sdk.passes.lowering.write_out_modulo import WriteOutModulo
from gsgen.sdk.passes.lowering.write_out_signs import WriteOutSigns
from support.passes import HEAD, operators, parsed, run

NUMPY = {"float": "float32", "double": "float64"}
SPECIAL_VALUES = [0.0, -0.0, np.inf, -np.inf, np.nan, 1e-30, -1e-30, 88.0, -200.0, 3.4e38]


def floats(dtype: str, seed: int = 0, odd: bool = True, rows: int = 40) -> np.ndarray:
    rng = np.random.default_rng(seed)
    result = rng.normal(0, 3, (rows, 4))
    if odd:
        result.reshape(-1)[rng.permutation(result.size)[: len(SPECIAL_VALUES)]] = SPECIAL_VALUES
    with np.errstate(over="ignore"):
        return result.astype(NUMPY.get(dtype, dtype))


def assert_same_numbers(a: np.ndarray, b: np.ndarray) -> None:
    """The same numbers: NaN is NaN, and zero is zero."""
    assert a.dtype == b.dtype
    np.testing.assert_array_equal(a, b)


# ONNX text gives float16 by its bits: 1, −1 and 2.
HALVES = (0x3C00, 0xBC00, 0x4000)

# ---- Max, Min and Clip -----------------------------------------------------------------------

EXTREMES = {
    "two": "Max (x, z)",
    "three": "Min (x, z, x)",
    "broadcast": "Max (x, row)",
    "bound": "Max (x, one)",
    "bound first": "Min (one, x)",
    "bound of rank one": "Max (x, ones)",
    "one": "Max (x)",
    "clip": "Clip (x, minus, one)",
    "clip from below": "Clip (x, minus)",
    "clip from above": "Clip (x, , one)",
}


@pytest.mark.parametrize("dtype", ["float", "float16", "int32", "int64", "double"])
@pytest.mark.parametrize("name", EXTREMES)
def test_minimum_and_maximum_become_selections(name: str, dtype: str) -> None:
    entry, minus, two = HALVES if dtype == "float16" else (1, -1, 2)
    weights = (
        f"<{dtype} one = {{{entry}}}, {dtype} minus = {{{minus}}}, {dtype}[1] ones = {{{two}}}>"
    )
    text = (
        f"g ({dtype}[40,4] x, {dtype}[40,4] z, {dtype}[4] row) => ({dtype}[40,4] y) "
        f"{weights} {{ y = {EXTREMES[name]} }}"
    )
    model = parsed(text)
    whole = dtype.startswith("int")
    inputs = {
        "x": floats(dtype, 0, not whole),
        "z": floats(dtype, 1, not whole),
        "row": floats(dtype, 2, odd=False)[0],
    }
    (before,) = run(model, **inputs)
    assert SelectExtremes()(model).modified
    assert not {"Max", "Min"} & operators(model)
    (after,) = run(model, **inputs)
    if not whole:  # a Clip with one bound takes the largest number for the other
        largest = np.finfo(after.dtype).max
        before, after = (np.clip(array, -largest, largest) for array in (before, after))
    assert_same_numbers(after, before)


def test_only_releases_without_a_kernel_want_the_selection() -> None:
    text = "g (float[2] a, float[2] b) => (float[2] y) { y = Max (a, b) }"
    old, new = (
        SelectExtremes.for_target(RewriteTarget.of(load_target(t))) for t in ("visionary", "webgpu")
    )
    assert not new(parsed(text)).modified
    assert old(parsed(text)).modified
    assert SelectExtremes.for_target(RewriteTarget(target=load_target("core"))) is None


# ---- Activations -----------------------------------------------------------------------------

ACTIVATIONS = {
    "celu": (18, "Celu <alpha = 0.7> (x)"),
    "elu": (18, "Elu <alpha = 0.7> (x)"),
    "gelu": (20, "Gelu (x)"),
    "gelu by tanh": (20, 'Gelu <approximate = "tanh"> (x)'),
    "hard sigmoid": (18, "HardSigmoid <alpha = 0.3, beta = 0.4> (x)"),
    "hard swish": (18, "HardSwish (x)"),
    "log softmax": (18, "LogSoftmax <axis = 0> (x)"),
    "log softmax 13": (13, "LogSoftmax (x)"),
    "mish": (18, "Mish (x)"),
    "prelu": (18, "PRelu (x, s)"),
    "selu": (18, "Selu (x)"),
    "shrink": (18, "Shrink <lambd = 1.5, bias = 0.5> (x)"),
    "softplus": (18, "Softplus (x)"),
    "softsign": (18, "Softsign (x)"),
    "thresholded": (18, "ThresholdedRelu <alpha = 0.6> (x)"),
}


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_an_activation_keeps_its_value(name: str) -> None:
    opset, body = ACTIVATIONS[name]
    text = f"g (float[40,4] x, float[4] s) => (float[40,4] y) {{ y = {body} }}"
    model = parsed(text, HEAD.replace("18", str(opset)))
    x = floats("float", odd=False)
    x[:, 0] *= 30  # where e to it overflows
    inputs = {"x": x, "s": floats("float", 1, odd=False)[0]}
    (before,) = run(model, **inputs)
    assert WriteOutActivations()(model).modified
    assert body.split()[0] not in operators(model)
    np.testing.assert_allclose(run(model, **inputs)[0], before, rtol=2e-5, atol=1e-6)


def test_swish_of_operator_set_24_is_x_times_a_gate() -> None:
    """ONNX Runtime 1.31 has no kernel for it: here is the formula."""
    text = "g (float[40,4] x) => (float[40,4] y) { y = Swish <alpha = 1.5> (x) }"
    model, x = parsed(text, HEAD.replace("18", "24")), floats("float", odd=False)
    assert WriteOutActivations()(model).modified
    double_precision = x.astype(np.float64)
    np.testing.assert_allclose(
        run(model, x=x)[0], double_precision / (1 + np.exp(-1.5 * double_precision)), atol=2e-6
    )


def test_activations_of_a_softmax_that_flattens_are_left_alone() -> None:
    text = "g (float[2,3] x) => (float[2,3] y) { y = LogSoftmax (x) }"
    assert not WriteOutActivations()(parsed(text, HEAD.replace("18", "11"))).modified


# ---- Signs -----------------------------------------------------------------------------------

SIGNS = [
    ("Sign (x)", "float", "float"),
    ("Sign (x)", "float16", "float16"),
    ("Sign (x)", "int32", "int32"),
    ("Sign (x)", "uint8", "uint8"),
    ("Abs (x)", "int32", "int32"),
    ("Neg (x)", "int32", "int32"),
    ("Neg (x)", "int64", "int64"),
    ("Relu (x)", "int32", "int32"),
    ("IsNaN (x)", "float", "bool"),
    ("IsNaN (x)", "float16", "bool"),
    ("IsInf (x)", "float", "bool"),
    ("IsInf <detect_negative = 0> (x)", "float", "bool"),
    ("IsInf <detect_positive = 0> (x)", "double", "bool"),
    ("IsInf <detect_positive = 0, detect_negative = 0> (x)", "float", "bool"),
]


@pytest.mark.parametrize(("body", "dtype", "result"), SIGNS)
def test_a_sign_keeps_its_value(body: str, dtype: str, result: str) -> None:
    model = parsed(f"g ({dtype}[40,4] x) => ({result}[40,4] y) {{ y = {body} }}")
    x = (
        np.abs(floats(dtype, odd=False))
        if dtype[0] == "u"
        else floats(dtype, odd=dtype[0] not in "iu")
    )
    if body == "Sign (x)" and dtype == "float16":
        x = np.nan_to_num(x)  # the CPU's kernel gives NaN a sign in this dtype alone
    (before,) = run(model, x=x)
    assert WriteOutSigns()(model).modified
    assert body.split()[0] not in operators(model) | {"Abs", "Neg"} - {body.split()[0]}
    assert_same_numbers(run(model, x=x)[0], before)


@pytest.mark.parametrize("kind", ["Abs", "Neg", "Relu"])
def test_signs_of_floats_have_kernels_and_stay(kind: str) -> None:
    text = f"g (float[2] x) => (float[2] y) {{ y = {kind} (x) }}"
    assert not WriteOutSigns()(parsed(text)).modified


# ---- Remainders ------------------------------------------------------------------------------


@pytest.mark.parametrize("fmod", [0, 1])
@pytest.mark.parametrize("dtype", ["int32", "int64"])
def test_a_remainder_of_integers_is_exact(dtype: str, fmod: int) -> None:
    text = (
        f"g ({dtype}[60] a, {dtype}[60] b) => ({dtype}[60] y) {{ y = Mod <fmod = {fmod}> (a, b) }}"
    )
    model, rng = parsed(text), np.random.default_rng(3)
    a, b = rng.integers(-50, 50, 60), rng.integers(1, 9, 60) * rng.choice([-1, 1], 60)
    a[:3], b[:3] = 2**31 - 1, [1, 2, -7]
    inputs = {"a": a.astype(dtype), "b": b.astype(dtype)}
    (before,) = run(model, **inputs)
    assert WriteOutModulo()(model).modified
    assert_same_numbers(run(model, **inputs)[0], before)


@pytest.mark.parametrize("dtype", ["float", "double"])
def test_a_remainder_of_floats_has_the_sign_of_the_dividend(dtype: str) -> None:
    text = (
        f"g ({dtype}[40,4] a, {dtype}[40,4] b) => ({dtype}[40,4] y) {{ y = Mod <fmod = 1> (a, b) }}"
    )
    model = parsed(text)
    a, b = floats(dtype, 0, odd=False), floats(dtype, 1, odd=False)
    a[0], b[0] = [6, -6, 5.999999, 0], [3, 3, 3, 2]
    (before,) = run(model, a=a, b=b)
    assert WriteOutModulo()(model).modified
    actual = run(model, a=a, b=b)[0]
    apart = np.abs(actual - before)
    # One step off counts as near: the remainder goes round.
    near = np.minimum(apart, np.abs(np.abs(b) - apart))
    assert (near <= 1e-5 * np.maximum(np.abs(a), np.abs(b))).all()
    assert (np.abs(actual) <= np.abs(b)).all()
    assert ((actual == 0) | (np.sign(actual) == np.sign(a))).all()


def test_a_remainder_of_floats_by_the_sign_of_the_divisor_is_no_onnx() -> None:
    text = "g (float[2] a, float[2] b) => (float[2] y) { y = Mod (a, b) }"
    assert not WriteOutModulo()(parsed(text)).modified
