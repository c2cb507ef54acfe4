"""What returns its argument goes; what only looks so stays."""

import numpy as np
import pytest

from gsgen.sdk.passes.simplify.merge_casts import MergeCasts
from gsgen.sdk.passes.simplify.merge_reshapes import MergeReshapes
from gsgen.sdk.passes.simplify.remove_no_ops import RemoveNoOps
from support.passes import HEAD, operators, parsed, run

NO_OP_BODIES = {
    "identity": "a = Identity (n)",
    "concat of one": "a = Concat <axis = 0> (n)",
    "max of one": "a = Max (n)",
    "sum of one": "a = Sum (n)",
    "cast": "a = Cast <to = 1> (n)",
    "idle sum": "a = ReduceSum <noop_with_empty_axes = 1> (n)",
    "idle maximum": "a = ReduceMax <noop_with_empty_axes = 1> (n, none)",
    "times one": "a = Mul (n, one)",
    "one times": "a = Mul (ones, n)",
    "over one": "a = Div (n, one)",
    "less nothing": "a = Sub (n, zero)",
    "same shape": "a = Reshape (n, shape)",
    "same size": "a = Expand (n, shape)",
    "whole": "a = Slice (n, begin, shape)",
    "tiled once": "a = Tile (n, twice_one)",
    "order": "a = Transpose <perm = [0, 1]> (n)",
    "no padding": "a = Pad (n, pads)",
    "dropout": "a = Dropout (n)",
}
EFFECTIVE_BODIES = {
    "sum of all": "a = ReduceSum <keepdims = 1> (n)",
    "one over": "a = Div (one, n)",
    "nothing less": "a = Sub (zero, n)",
    "reversed": "a = Slice (n, last, before, axes, back)",
    "turned": "a = Transpose (n)",
    "shifted": "a = Pad (n, shift)",
    "cast down": "h = Cast <to = 10> (n) a = Cast <to = 1> (h)",
    "plus zero": "a = Add (n, zero)",
    "larger by ones": "a = Mul (n, stack)",
}
WEIGHTS = """
<float one = {1}, float zero = {0}, float[2,2] ones = {1, 1, 1, 1}, int64[2] shape = {2, 2},
 int64[2] begin = {0, 0}, int64[2] twice_one = {1, 1}, int64[4] pads = {0, 0, 0, 0},
 int64[4] shift = {1, 0, -1, 0}, int64[2] last = {-1, -1}, int64[2] before = {-9, -9},
 int64[2] axes = {0, 1}, int64[2] back = {-1, -1}, int64[0] none = {},
 float[1,2,2] stack = {1, 1, 1, 1}>
"""
X = np.array([[1, -0.0], [np.nan, 3e38]], np.float32)


def model_of(body: str, rank: str = "A,B"):
    return parsed(
        f"g (float[2,2] x) => (float[{rank}] y) {WEIGHTS} {{ n = Neg (x) {body} y = Abs (a) }}"
    )


@pytest.mark.parametrize("name", NO_OP_BODIES)
def test_idle_operators_go_and_every_bit_stays(name: str) -> None:
    model = model_of(NO_OP_BODIES[name])
    (before,) = run(model, x=X)
    assert RemoveNoOps()(model).modified
    assert operators(model) == {"Neg", "Abs"}
    assert run(model, x=X)[0].tobytes() == before.tobytes()


@pytest.mark.parametrize("name", EFFECTIVE_BODIES)
def test_operators_that_do_something_stay(name: str) -> None:
    rank = {"larger by ones": "A,B,C", "sum of all": "A,B"}.get(name, "A,B")
    assert not RemoveNoOps()(model_of(EFFECTIVE_BODIES[name], rank)).modified


def test_an_idle_operator_in_front_of_an_output_leaves_the_name_of_the_output() -> None:
    model = parsed("g (float[2] x) => (float[2] y) { n = Neg (x) y = Max (n) }")
    assert RemoveNoOps()(model).modified
    assert [node.op_type for node in model.graph] == ["Neg"]
    assert model.graph.outputs[0].name == "y"
    assert run(model, x=np.array([1, 2], np.float32))[0].tolist() == [-1, -2]


@pytest.mark.parametrize(
    "text",
    [
        "g (float[2] x) => (float[2] y) { y = Identity (x) }",
        "g (float[2] x) => (float[2] z, float[2] y) { z = Neg (x) y = Identity (z) }",
        "g (float[2] x) => (float[2] y) <float one = {1}> { n = Neg (x) y = Mul (n, one) }",
        "g (float[N] x) => (float[N] y) <float[1] s = {1}> { n = Neg (x) m = Mul (n, s) y = Neg (m) }",
    ],
)
def test_identity_between_outputs_stays(text: str) -> None:
    assert not RemoveNoOps()(parsed(text)).modified


def test_an_idle_operator_in_a_branch_goes_but_not_the_only_node_of_it() -> None:
    model = parsed(
        "g (bool c, float[2] x) => (float[2] y) { y = If (c) <"
        "then_branch = t () => (float[2] b) { n = Neg (x) a = Max (n) b = Abs (a) }, "
        "else_branch = e () => (float[2] d) { d = Identity (x) }> }"
    )
    assert RemoveNoOps()(model).modified
    assert operators(model) == {"If", "Neg", "Abs", "Identity"}
    x = np.array([1, -2], np.float32)
    assert run(model, c=np.array(True), x=x)[0].tolist() == [1, 2]
    assert run(model, c=np.array(False), x=x)[0].tolist() == [1, -2]


CODES = {"float": 1, "float16": 10, "double": 11, "int32": 6, "int64": 7, "int8": 3, "bool": 9}


@pytest.mark.parametrize(
    ("first", "middle_nodes", "last", "merged"),
    [
        ("int32", "int64", "int32", True),
        ("bool", "int64", "float", True),
        ("bool", "float", "bool", True),
        ("float16", "float", "float16", True),
        ("int8", "float", "int32", True),
        ("int64", "int32", "int64", False),
        ("float", "float16", "float", False),
        ("float", "int32", "float", False),
        ("int64", "float", "int64", False),
        ("float", "bool", "float", False),
        ("float16", "double", "int32", False),
        ("int32", "int64", "int8", True),
    ],
)
def test_a_cast_that_lost_nothing_is_left_out(
    first: str, middle_nodes: str, last: str, merged: bool
) -> None:
    text = (
        f"g ({first}[6] x) => ({last}[6] y) {{ a = Cast <to = {CODES[middle_nodes]}> (x) "
        f"b = Cast <to = {CODES[last]}> (a) y = Reshape (b, s) }}"
    ).replace("{ a", "<int64[1] s = {6}> { a")
    model = parsed(text)
    names = {"float": "float32", "double": "float64"}
    x = np.array([0, 1, 1, 0, 70, 100]).astype(names.get(first, first))
    (before,) = run(model, x=x)
    assert MergeCasts()(model).modified is merged
    (after,) = run(model, x=x)
    assert after.dtype == before.dtype
    assert after.tobytes() == before.tobytes()


def test_shapes_given_one_after_the_other_become_the_last() -> None:
    text = (
        "g (float[2,6] x) => (float[A,B,C] y) <int64[2] s = {4, 3}, int64[1] one = {1}, int64[1] two = {2}> "
        "{ a = Reshape (x, s) b = Unsqueeze (a, one) c = Flatten <axis = 2> (b) d = Squeeze (c) "
        "e = Unsqueeze (c, two) y = Neg (e) }"
    )
    model = parsed(text)
    x = np.arange(12, dtype=np.float32).reshape(2, 6)
    (before,) = run(model, x=x)
    assert MergeReshapes()(model).modified
    chain = next(node for node in model.graph if node.outputs[0].name == "y").inputs[0].producer()
    assert chain.op_type == "Reshape"
    assert chain.inputs[0].name == "x"
    np.testing.assert_array_equal(run(model, x=x)[0], before)
    assert not MergeReshapes()(model).modified


def test_shapes_that_are_open_are_not_merged() -> None:
    text = "g (float[N,6] x) => (float[N,6] y) <int64[1] one = {1}> { a = Unsqueeze (x, one) b = Squeeze (a, one) y = Neg (b) }"
    assert not MergeReshapes()(parsed(text, HEAD)).modified
