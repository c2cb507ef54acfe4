"""Guards that were lost: zero vectors give zero again, and no other bit changes."""

import warnings

import numpy as np
import onnx_ir as ir
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.sdk.passes.portability.restore_guards import RestoreGuards
from support.passes import operators, parsed, run, text_of

HEAD = "g (float[4,3] v) => (float[4,3] y) <int64[1] last = {1}, float two = {2}, float half = {0.5}, float back = {-0.5}>"
SQUARED_SUM_TEXT = "q = Mul (v, v)\n s = ReduceSum (q, last)\n"
LENGTHS = {
    "root of a sum": SQUARED_SUM_TEXT + "n = Sqrt (s)\n y = Div (v, n)",
    "root of powers": "q = Pow (v, two)\n s = ReduceSum (q, last)\n n = Sqrt (s)\n y = Div (v, n)",
    "root of a mean": "q = Mul (v, v)\n s = ReduceMean (q, last)\n n = Sqrt (s)\n y = Div (v, n)",
    "power of a half": SQUARED_SUM_TEXT + "n = Pow (s, half)\n y = Div (v, n)",
    "ReduceL2": "n = ReduceL2 (v, last)\n y = Div (v, n)",
    "reciprocal root": SQUARED_SUM_TEXT + "n = Sqrt (s)\n r = Reciprocal (n)\n y = Mul (v, r)",
    "negative power": SQUARED_SUM_TEXT + "r = Pow (s, back)\n y = Mul (v, r)",
    "square": SQUARED_SUM_TEXT + "y = Div (v, s)",
    "sine over angle": SQUARED_SUM_TEXT
    + "n = Sqrt (s)\n z = Sin (n)\n w = Mul (v, z)\n y = Div (w, n)",
    "expanded": SQUARED_SUM_TEXT
    + "n = Sqrt (s)\n i = Shape (v)\n e = Expand (n, i)\n y = Div (v, e)",
}


@pytest.mark.parametrize("name", LENGTHS)
@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-19, 1e-6, 1.0, 1e6]))
def test_guard_changes_only_nonfinite_values(name: str, seed: int, scale: float) -> None:
    model = parsed(f"{HEAD} {{ {LENGTHS[name]} }}")
    rng = np.random.default_rng(seed)
    v = (scale * rng.normal(size=(4, 3))).astype(np.float32)
    v[rng.integers(4)] = 0
    (before,) = run(model, v=v)
    rewrite = RestoreGuards()
    assert rewrite(model).modified
    (after,) = run(model, v=v)
    broken = ~np.isfinite(before)
    assert broken.any()
    np.testing.assert_array_equal(after[~broken], before[~broken])
    np.testing.assert_array_equal(after[(v == 0).all(axis=1)], 0)
    assert not rewrite(model).modified


GUARDED_DIVISIONS = {
    "clamped under the root": SQUARED_SUM_TEXT
    + "c = Clip (s, tiny)\n n = Sqrt (c)\n y = Div (v, n)",
    "clamped after it": SQUARED_SUM_TEXT + "n = Sqrt (s)\n c = Max (n, tiny)\n y = Div (v, c)",
    "an epsilon that is left": SQUARED_SUM_TEXT
    + "t = Add (s, tiny)\n n = Sqrt (t)\n y = Div (v, n)",
    "one and an exponential": "e = Exp (v)\n d = Add (e, two)\n y = Div (v, d)",
    "chosen where it is not zero": "c = Greater (v, zero)\n d = Where (c, v, two)\n y = Div (v, d)",
    "a constant": "y = Div (v, two)",
}


@pytest.mark.parametrize("name", GUARDED_DIVISIONS)
def test_guarded_divisions_are_left_alone(name: str) -> None:
    head = HEAD.replace("float two", "float tiny = {1e-20}, float zero = {0}, float two")
    model = parsed(f"{head} {{ {GUARDED_DIVISIONS[name]} }}")
    before = text_of(model)
    rewrite = RestoreGuards()
    assert not rewrite(model).modified
    assert not rewrite.refusals
    assert text_of(model) == before


@pytest.mark.parametrize(
    "body",
    [
        "y = Div (two, v)",
        "s = Sin (v)\n y = Div (v, s)",
        "m = IsNaN (v)\n c = Where (m, two, v)\n y = Div (v, c)",
    ],
)
def test_a_divisor_that_is_no_length_is_named_and_left_alone(body: str) -> None:
    model = parsed(f"{HEAD} {{ {body} }}")
    before = text_of(model)
    rewrite = RestoreGuards()
    assert not rewrite(model).modified
    assert "may be zero" in rewrite.refusals[0].reason
    assert text_of(model) == before


@pytest.mark.parametrize("guard", ["Clip (n, tiny)", "Max (n, tiny)", "Add (n, tiny)"])
def test_a_guard_that_float16_makes_zero_is_put_back(guard: str) -> None:
    model = parsed(
        "g (float16[2,3] v) => (float16[2,3] y) <int64[1] last = {1}, float16 tiny = {0}>"
        f" {{ {SQUARED_SUM_TEXT} n = Sqrt (s)\n c = {guard}\n y = Div (v, c) }}"
    )
    tiny_guard = model.graph.initializers["tiny"]
    tiny_guard.const_value = ir.tensor(np.asarray(1e-12, np.float16), name="tiny")
    v = np.array([[0, 0, 0], [3, 4, 0]], np.float16)
    assert np.isnan(run(model, v=v)[0][0]).all()
    assert RestoreGuards()(model).modified
    np.testing.assert_allclose(run(model, v=v)[0], [[0, 0, 0], [0.6, 0.8, 0]], atol=1e-3)


class Unit(torch.nn.Module):
    def forward(self, v: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        angle = torch.sqrt((v * v).sum(dim=1, keepdim=True) + 1e-12)
        return v / (v.norm(dim=1, keepdim=True) + 1e-8), torch.sin(angle) * v / angle


def test_folded_guards_are_restored() -> None:
    v = torch.tensor([[0.0, 0, 0], [1, -2, 0.5]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(Unit(), (v,), dynamo=True, opset_version=18, verbose=False)
    model = program.model
    assert "Add" not in operators(model)  # or else the exporter has learnt to keep it
    assert np.isnan(run(model, v=v.numpy())[0][0]).all()
    assert RestoreGuards()(model).modified
    for actual, expected in zip(run(model, v=v.numpy()), Unit()(v), strict=True):
        np.testing.assert_allclose(actual, expected.numpy(), atol=1e-6)
