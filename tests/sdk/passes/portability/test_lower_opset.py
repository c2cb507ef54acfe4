"""A lower operator set, where every node has an equal in it."""

import numpy as np
import pytest

from gsgen.contract.spec.targets import load_target
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.passes.portability.lower_opset import LowerOpset
from support.passes import HEAD, operators, parsed, run, text_of

HEADS = {opset: HEAD.replace("18", str(opset)) for opset in range(13, 25)}
X = np.random.default_rng(2).normal(size=(2, 4, 6, 6)).astype(np.float32)
GRID_POINTS = np.random.default_rng(3).uniform(-1.2, 1.2, (2, 3, 5, 2)).astype(np.float32)

MODELS = {
    "sine": (22, "s = Sin (x) y = Cos (s)"),
    "shapes": (21, "t = Transpose <perm = [0, 1, 3, 2]> (x) y = Identity (t)"),
    "cast": (19, "h = Cast <to = 10, saturate = 1> (x) y = Cast <to = 1> (h)"),
    "gelu": (20, "y = Gelu (x)"),
    "root mean square": (23, "y = RMSNormalization (x, scale)"),
    "groups": (21, "y = GroupNormalization <num_groups = 2> (x, channels, channels)"),
    "instances": (22, "y = InstanceNormalization (x, channels, channels)"),
    "maximum": (20, "m = ReduceMax <keepdims = 1> (x, last) y = Add (x, m)"),
    "pool": (22, "p = AveragePool <kernel_shape = [1, 1], dilations = [1, 1]> (x) y = Neg (p)"),
    "pad": (21, "p = Pad (x, pads) y = Slice (p, begin, end, last)"),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_newer_operator_set_becomes_18(name: str) -> None:
    opset, body = MODELS[name]
    text = (
        "g (float[2,4,6,6] x) => (float[A,B,C,D] y) <float[6] scale = {1, 2, 3, 4, 5, 6}, "
        "float[4] channels = {1, 2, 3, 4}, int64[1] last = {-1}, int64[1] begin = {0}, int64[1] end = {6}, "
        f"int64[8] pads = {{0, 0, 0, 0, 0, 0, 0, 1}}> {{ {body} }}"
    )
    model = parsed(text, HEADS[opset])
    (before,) = run(model, x=X)
    result = LowerOpset()(model)
    assert result.modified
    assert model.opset_imports[""] == 18
    np.testing.assert_allclose(run(model, x=X)[0], before, rtol=1e-5, atol=1e-5)
    assert not LowerOpset()(model).modified


@pytest.mark.parametrize("mode", ["linear", "nearest", "cubic"])
def test_samples_of_a_grid_keep_their_mode_under_its_old_name(mode: str) -> None:
    text = (
        "g (float[2,4,6,6] x, float[2,3,5,2] p) => (float[2,4,3,5] y) "
        f'{{ y = GridSample <mode = "{mode}", align_corners = 1> (x, p) }}'
    )
    model = parsed(text, HEADS[22])
    (before,) = run(model, x=X, p=GRID_POINTS)
    assert LowerOpset()(model).modified
    np.testing.assert_allclose(run(model, x=X, p=GRID_POINTS)[0], before, atol=1e-6)


def test_operator_set_13_takes_axes_and_sizes_another_way() -> None:
    text = (
        "g (float[2,4,6,6] x) => (float[2,4,6,1] y, float[A,B,C,D] z) <int64[1] last = {-1}> "
        "{ y = ReduceMean <keepdims = 1> (x, last) z, w = Split <axis = 1, num_outputs = 2> (x) }"
    )
    model = parsed(text, HEADS[18])
    before = run(model, x=X)
    assert LowerOpset(13)(model).modified
    assert model.opset_imports[""] == 13
    for expected, actual in zip(before, run(model, x=X), strict=True):
        np.testing.assert_array_equal(actual, expected)


OBSTACLES = {
    "five axes": (
        22,
        "g (float[1,1,2,2,2] x, float[1,2,2,2,3] p) => (float[1,1,2,2,2] y) { y = GridSample (x, p) }",
        "four axes",
    ),
    "dtype": (
        20,
        "g (bool[3] x) => (bool[1] y) { y = ReduceMax <keepdims = 1> (x) }",
        "tensor(bool)",
    ),
    "mode": (
        19,
        'g (float[4] x) => (float[6] y) <int64[2] p = {1, 1}> { y = Pad <mode = "wrap"> (x, p) }',
        "'wrap'",
    ),
    "attribute": (
        22,
        "g (float[1,1,9] x) => (float[1,1,7] y) { y = AveragePool <kernel_shape = [2], dilations = [2]> (x) }",
        "'dilations'",
    ),
    "new operator": (
        20,
        "g (float[3,2,3] x, int64[4] s) => (float[A,B,C,D] y) { y = AffineGrid (x, s) }",
        "no AffineGrid",
    ),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_node_without_an_equal_keeps_the_whole_model_as_it_is(name: str) -> None:
    opset, text, reason = OBSTACLES[name]
    model, rewrite = parsed(text, HEADS[opset]), LowerOpset()
    before = text_of(model)
    assert not rewrite(model).modified
    assert text_of(model) == before
    assert reason in rewrite.refusals[0].reason


def test_flattening_softmax_is_not_lowered_below_its_set() -> None:
    model = parsed("g (float[2,2,2] x) => (float[2,2,2] y) { y = Softmax <axis = 1> (x) }")
    rewrite = LowerOpset(12)
    assert not rewrite(model).modified
    assert "flattened before operator set 13" in rewrite.refusals[0].reason


def test_bodies_of_branches_are_of_the_same_set() -> None:
    text = (
        "g (bool c, float[2] x) => (float[2] y) { y = If (c) <"
        "then_branch = t () => (float[2] a) { a = Gelu (x) }, else_branch = e () => (float[2] b) { b = Sin (x) }> }"
    )
    model, x = parsed(text, HEADS[22]), np.array([0.3, -1], np.float32)
    before = [run(model, c=np.array(c), x=x)[0] for c in (True, False)]
    assert LowerOpset()(model).modified
    assert "Gelu" not in operators(model)
    for c, expected in zip((True, False), before, strict=True):
        np.testing.assert_allclose(run(model, c=np.array(c), x=x)[0], expected, atol=1e-6)


def test_target_chooses_the_operator_set() -> None:
    assert LowerOpset.for_target(RewriteTarget(target=load_target("core"))) is None
    assert LowerOpset.for_target(RewriteTarget.of(load_target("webgpu"))).target_opset == 18
    assert (
        LowerOpset.for_target(RewriteTarget.of(load_target("webgpu"), opset=20)).target_opset == 20
    )


def test_older_target_gets_the_older_ir_version() -> None:
    model = parsed("g (float[2] x) => (float[2] y) { y = Neg (x) }")
    model.ir_version = 12
    assert LowerOpset.for_target(RewriteTarget.of(load_target("visionary")))(model).modified
    assert model.ir_version == load_target("visionary").ir
