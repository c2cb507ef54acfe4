"""Integers narrowed where they provably fit, and masks as numbers: not a bit changes."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.targets import load_target
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.passes.lowering.arithmetic_masks import ArithmeticMasks
from gsgen.sdk.passes.portability.clip_before_cast import ClipBeforeCast
from gsgen.sdk.passes.portability.narrow_integers import NarrowIntegers
from gsgen.sdk.passes.simplify.merge_casts import MergeCasts
from support.models.small_models import manifest_of
from support.passes import operators, parsed, run

TIME = replace(manifest_of(1), inputs=(Input(name="x", role="time", range=(-3.0, 90.0)),))
OLD_TARGET = RewriteTarget.of(load_target("visionary"), TIME)
X = np.array([-3, -0.5, 0, 1.7, 55.2, 90], np.float32)
CODES = {"int32": 6, "int64": 7, "float": 1, "bool": 9}


def wide_values(model) -> list[str]:
    """The names of values that some node computes in int64."""
    nodes = [n for n in model.graph if n.op_type not in ("Cast", "Gather", "Reshape")]
    values = [v for n in nodes for v in (*n.inputs, *n.outputs) if v is not None]
    return [v.name for v in values if v.dtype is not None and v.dtype.name == "INT64"]


INTEGER_BODIES = {
    "sum": ("r = Add (i, three)", "int64"),
    "difference and product": ("d = Sub (i, three) r = Mul (d, i)", "int64"),
    "quotient": ("r = Div (i, three)", "int64"),
    "remainder": ("r = Mod (i, three)", "int64"),
    "bounds": ("r = Clip (i, none, three)", "int64"),
    "extremes": ("m = Max (i, none) r = Min (m, three)", "int64"),
    "sign and size": ("s = Sign (i) a = Abs (i) n = Neg (a) r = Mul (s, n)", "int64"),
    "comparison": ("r = Less (i, three)", "bool"),
    "selection": ("b = Greater (i, three) r = Where (b, i, three)", "int64"),
    "joined": ("r = Concat <axis = 0> (i, list, i)", "int64"),
    "turned": ("t = Unsqueeze (i, axis) u = Transpose (t) r = Squeeze (u)", "int64"),
    "power": ("r = Pow (x, three)", "float"),
    "largest": ("r = ReduceMax <keepdims = 1> (i)", "int64"),
}


@pytest.mark.parametrize("goal", [None, OLD_TARGET])
@pytest.mark.parametrize("name", INTEGER_BODIES)
def test_integers_that_fit_are_narrowed(name: str, goal: RewriteTarget | None) -> None:
    body, result = INTEGER_BODIES[name]
    text = (
        f"g (float[6] x) => ({result}[N] y) <int64 three = {{3}}, int64 none = {{0}}, "
        "int64[1] axis = {0}, int64[2] list = {5, -6}> "
        f"{{ i = Cast <to = 7> (x) {body} y = Identity (r) }}"
    )
    model = parsed(text)
    (before,) = run(model, x=X)
    rewrite = NarrowIntegers(
        goal or RewriteTarget(target=load_target("core"), tables=OLD_TARGET.tables, manifest=TIME)
    )
    assert rewrite(model).modified
    MergeCasts()(model)
    left = {name for name in wide_values(model) if name not in ("axis", "r", "y")}
    assert not left
    (after,) = run(model, x=X)
    np.testing.assert_array_equal(after, before)
    assert after.dtype == before.dtype


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("i = Cast <to = 7> (free) y = Add (i, three)", "i may leave"),
        ("i = Cast <to = 7> (x) y = Mul (i, large)", "y may leave"),
        ("i = Cast <to = 7> (x) y = Add (i, huge)", "huge may leave"),
        ("i = Cast <to = 7> (x) y = Div (three, i)", "y may leave"),
    ],
)
def test_integers_that_may_not_fit_stay_and_the_pass_says_why(body: str, reason: str) -> None:
    text = (
        "g (float[6] x, float[6] free) => (int64[6] y) <int64 three = {3}, int64 large = {100000000}, "
        f"int64 huge = {{8589934592}}> {{ {body} }}"
    )
    model, rewrite = parsed(text), NarrowIntegers(OLD_TARGET)
    before = run(model, x=X + 5, free=X * 1e12)
    rewrite(model)
    assert any(reason in refusal.reason for refusal in rewrite.refusals)
    np.testing.assert_array_equal(run(model, x=X + 5, free=X * 1e12)[0], before[0])


def test_without_a_manifest_nobody_knows_what_an_input_holds() -> None:
    text = "g (float[6] x) => (int64[6] y) { i = Cast <to = 7> (x) y = Neg (i) }"
    rewrite = NarrowIntegers(RewriteTarget.of(load_target("visionary")))
    assert not rewrite(parsed(text)).modified
    assert rewrite.refusals


def test_releases_that_capture_int64_leave_it() -> None:
    text = "g (float[6] x) => (int64[6] y) <int64 three = {3}> { i = Cast <to = 7> (x) y = Add (i, three) }"
    new = NarrowIntegers(RewriteTarget.of(load_target("webgpu"), TIME))
    assert not new(parsed(text)).modified


def test_a_count_of_a_mask_is_a_sum_of_floats_at_last() -> None:
    text = (
        "g (float[6] x) => (int32[1] y) <float five = {5}, int64[1] one = {1}> { b = Greater (x, five) "
        "c = Cast <to = 7> (b) s = ReduceSum <keepdims = 0> (c) t = Reshape (s, one) y = Cast <to = 6> (t) }"
    )
    model = parsed(text)
    for _ in range(4):
        NarrowIntegers(OLD_TARGET)(model)
        MergeCasts()(model)
    (total,) = (node for node in model.graph if node.op_type == "ReduceSum")
    assert total.inputs[0].dtype.name == "FLOAT"
    (actual,) = run(model, x=X)
    assert actual.tolist() == [2]


def test_index_operators_take_int32() -> None:
    text = (
        "g (float[6] x) => (float[6] y) <float[4] table = {1, 2, 3, 4}, int64 none = {0}, int64 last = {3}> "
        "{ i = Cast <to = 7> (x) j = Clip (i, none, last) y = Gather (table, j) }"
    )
    model = parsed(text)
    (before,) = run(model, x=X)
    for _ in range(3):
        ClipBeforeCast()(model)
        NarrowIntegers(OLD_TARGET)(model)
        MergeCasts()(model)
    (gather_node,) = (node for node in model.graph if node.op_type == "Gather")
    assert gather_node.inputs[1].dtype.name == "INT32"
    np.testing.assert_array_equal(run(model, x=X)[0], before)


# ---- Clips -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "body",
    [
        "y = Clip (i, low, high)",
        "y = Clip (i, low)",
        "y = Clip (i, , high)",
        "y = Max (i, low)",
        "y = Min (i, high)",
    ],
)
@pytest.mark.parametrize("dtype", ["int32", "int64"])
def test_whole_bounds_commute_with_cutting_the_fraction_off(body: str, dtype: str) -> None:
    text = (
        f"g (float[9] x) => ({dtype}[9] y) <{dtype} low = {{-2}}, {dtype} high = {{3}}> "
        f"{{ i = Cast <to = {CODES[dtype]}> (x) {body} }}"
    )
    model = parsed(text)
    x = np.array([-2.5, -2, -1.99, -0.5, -0.0, 2.999, 3, 3.5, 1e6], np.float32)
    (before,) = run(model, x=x)
    assert ClipBeforeCast()(model).modified
    assert [node.op_type for node in model.graph][-1] == "Cast"
    np.testing.assert_array_equal(run(model, x=x)[0], before)


@pytest.mark.parametrize(
    "text",
    [
        "g (float[2] x) => (int64[2] y) <int64 high = {16777217}> { i = Cast <to = 7> (x) y = Min (i, high) }",
        "g (float[2] x) => (int64[2] y) <int64[2] high = {1, 2}> { i = Cast <to = 7> (x) y = Min (i, high) }",
        "g (int32[2] x) => (int64[2] y) <int64 high = {1}> { i = Cast <to = 7> (x) y = Min (i, high) }",
        "g (float[2] x, int64 high) => (int64[2] y) { i = Cast <to = 7> (x) y = Min (i, high) }",
    ],
)
def test_bounds_that_floats_do_not_hold_stay_behind_the_cast(text: str) -> None:
    assert not ClipBeforeCast()(parsed(text)).modified


@pytest.mark.parametrize("kind", ["int64", "uint64"])
def test_a_double_does_not_hold_every_integer_of_64_bits(kind: str) -> None:
    code = {"int64": 7, "uint64": 13}[kind]
    text = (
        f"g ({kind}[3] x) => ({kind}[3] y) {{ d = Cast <to = 11> (x) y = Cast <to = {code}> (d) }}"
    )
    assert not MergeCasts()(parsed(text)).modified


# ---- Masks -----------------------------------------------------------------------------------

MASKS = {
    "and": "r = And (a, b)",
    "or": "r = Or (a, b)",
    "xor": "r = Xor (a, b)",
    "equal": "r = Equal (a, b)",
    "chain": "o = Or (a, b) n = Not (o) r = And (n, fixed)",
    "axis": "r = Unsqueeze (a, first)",
    "joined": "r = Concat <axis = 0> (a, b, fixed)",
    "reshaped": "h = Reshape (a, shape) r = Transpose (h)",
    "repeated": "h = Reshape (a, shape) r = Tile (h, twice)",
    "spread": "r = Expand (a, shape6)",
    "part": "r = Slice (a, first, two)",
    "chosen": "r = Gather (a, two)",
}


@pytest.mark.parametrize("name", MASKS)
def test_masks_are_numbers_between_comparison_and_use(name: str) -> None:
    text = (
        "g (float[6] x, float[6] z) => (float[N] y, bool[M] m) <float zero = {0}, float five = {5}, "
        "bool[6] fixed = {1, 0, 1, 1, 0, 0}, int64[1] first = {0}, int64[1] two = {2}, int64[2] shape = {2, 3}, "
        "int64[2] twice = {2, 1}, int64[2] shape6 = {3, 6}, int64[1] flat = {-1}> "
        f"{{ a = Greater (x, zero) b = Less (z, five) {MASKS[name]} "
        "m = Reshape (r, flat) f = Cast <to = 1> (r) s = Reshape (f, flat) y = Mul (s, five) }"
    )
    model = parsed(text)
    z = np.array([1, 9, 4, -3, 70, 5], np.float32)
    before = run(model, x=X, z=z)
    assert ArithmeticMasks()(model).modified
    while ArithmeticMasks()(model).modified:
        pass
    for expected, actual in zip(before, run(model, x=X, z=z), strict=True):
        assert actual.dtype == expected.dtype
        np.testing.assert_array_equal(actual, expected)
    computed = [n for n in model.graph if n.op_type not in ("Cast", "Not", "Reshape")]
    kinds = {v.dtype.name for n in computed for v in n.inputs if v is not None and v.name != "c"}
    assert "BOOL" not in kinds


def test_a_choice_between_masks_is_made_of_numbers_and_by_a_mask() -> None:
    text = (
        "g (float[6] x, float[6] z) => (float[6] y) <float zero = {0}, bool[1] on = {1}> "
        "{ a = Greater (x, zero) b = Less (z, zero) r = Where (a, b, on) y = Cast <to = 1> (r) }"
    )
    model = parsed(text)
    z = np.array([1, 9, -4, -3, 70, -5], np.float32)
    assert ArithmeticMasks()(model).modified
    (actual,) = run(model, x=X, z=z)  # ONNX Runtime cannot choose between booleans
    np.testing.assert_array_equal(actual, np.where(X > 0, z < 0, True))


@pytest.mark.parametrize("goal", [None, OLD_TARGET])
def test_a_choice_between_numbers_keeps_its_mask(goal: RewriteTarget | None) -> None:
    text = "g (bool[2] b, int64[2] x) => (int64[2] y) <int64 one = {1}> { y = Where (b, x, one) }"
    assert not ArithmeticMasks(goal)(parsed(text)).modified


def test_numbers_are_kept_between_two_operators_of_a_chain() -> None:
    text = (
        "g (float[6] x) => (float[1,6] y) <float zero = {0}, float five = {5}, int64[1] first = {0}> "
        "{ a = Greater (x, zero) b = Less (x, five) c = And (a, b) d = Unsqueeze (c, first) y = Cast <to = 1> (d) }"
    )
    model = parsed(text)
    (before,) = run(model, x=X)
    ArithmeticMasks()(model)
    casts = [node for node in model.graph if node.op_type == "Cast" and node.outputs[0].uses()]
    assert len(casts) <= 2 + 1
    assert "And" not in operators(model)
    np.testing.assert_array_equal(run(model, x=X)[0], before)


def test_masks_that_a_release_captures_stay() -> None:
    text = "g (float[6] x) => (bool[6,1] y) <int64[1] axis = {1}> { b = Greater (x, x) y = Unsqueeze (b, axis) }"
    new = ArithmeticMasks.for_target(RewriteTarget.of(load_target("webgpu")))
    assert not new(parsed(text)).modified
    assert ArithmeticMasks(OLD_TARGET)(parsed(text)).modified
