"""Defaults that are said, and mean the same."""

import numpy as np
import pytest

from gsgen.contract.spec.targets import load_target
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.passes.simplify.explicit_defaults import MakeDefaultsExplicit
from support.passes import parsed, run

RNG = np.random.default_rng(8)


@pytest.mark.parametrize("space", [1, 2, 3])
def test_a_conv_says_that_it_is_not_dilated(space: int) -> None:
    sizes = ",".join(["6"] * space)
    kernel = ",".join(["3"] * space)
    dims = ",".join("ABCDE"[: space + 2])
    text = f"g (float[1,2,{sizes}] x, float[4,2,{kernel}] w) => (float[{dims}] y) {{ y = Conv (x, w) }}"
    model = parsed(text)
    x = RNG.normal(size=(1, 2, *[6] * space)).astype(np.float32)
    w = RNG.normal(size=(4, 2, *[3] * space)).astype(np.float32)
    (before,) = run(model, x=x, w=w)
    assert MakeDefaultsExplicit()(model).modified
    (node,) = model.graph
    assert list(node.attributes["dilations"].as_ints()) == [1] * space
    np.testing.assert_array_equal(run(model, x=x, w=w)[0], before)
    assert not MakeDefaultsExplicit()(model).modified


@pytest.mark.parametrize("arguments", ["x, b, e", "x, b, e, , s"])
def test_a_slice_says_which_axes_it_cuts(arguments: str) -> None:
    text = (
        "g (float[4,5,2] x) => (float[A,B,C] y) <int64[2] b = {1, -3}, int64[2] e = {4, 5}, "
        f"int64[2] s = {{2, 1}}> {{ y = Slice ({arguments}) }}"
    )
    model, x = parsed(text), RNG.normal(size=(4, 5, 2)).astype(np.float32)
    (before,) = run(model, x=x)
    assert MakeDefaultsExplicit()(model).modified
    (node,) = model.graph
    assert node.inputs[3].const_value.numpy().tolist() == [0, 1]
    np.testing.assert_array_equal(run(model, x=x)[0], before)
    assert not MakeDefaultsExplicit()(model).modified


@pytest.mark.parametrize(
    "text",
    [
        "g (float[1,2,6] x, float[4,2,2] w) => (float[1,4,4] y) { y = Conv <dilations = [2]> (x, w) }",
        "g (float[4] x, int64[1] b) => (float[N] y) <int64[1] e = {4}> { y = Slice (x, b, e) }",
    ],
)
def test_explicit_or_unknown_attributes_stay(text: str) -> None:
    assert not MakeDefaultsExplicit()(parsed(text)).modified


def test_defaults_in_branches_are_written_if_the_target_has_tables() -> None:
    text = (
        "g (bool c, float[4] x) => (float[N] y) <int64[1] b = {1}, int64[1] e = {3}> { y = If (c) <"
        "then_branch = t () => (float[N] a) { a = Slice (x, b, e) }, "
        "else_branch = f () => (float[N] d) { d = Neg (x) }> }"
    )
    model = parsed(text)
    assert MakeDefaultsExplicit()(model).modified
    x = np.arange(4, dtype=np.float32)
    assert run(model, c=np.array(True), x=x)[0].tolist() == [1, 2]
    assert MakeDefaultsExplicit.for_target(RewriteTarget(target=load_target("core"))) is None
