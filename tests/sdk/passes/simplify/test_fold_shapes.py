"""Shape arithmetic is folded to what ONNX Runtime computes, and guards on data are not."""

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.sdk.passes.simplify.fold_shapes import FoldShapes
from gsgen.sdk.passes.simplify.freeze_dimensions import FreezeDimensions
from support.passes import operators, parsed, run, text_of

FLATTEN = """
g (float[N,J,3] x) => (float[M,K] y)
<int64 zero = {0}, int64[1] front = {0}, int64[1] rest = {-1}> {
    s = Shape (x)
    n = Gather (s, zero)
    n1 = Unsqueeze (n, front)
    t = Concat <axis = 0> (n1, rest)
    y0 = Reshape (x, t)
    y = Neg (y0)
}
"""


def test_a_frozen_model_has_no_shape_left_to_compute() -> None:
    model = parsed(FLATTEN)
    x = np.random.default_rng(0).normal(size=(5, 4, 3)).astype(np.float32)
    (before,) = run(model, x=x)
    rewrite = FreezeDimensions({"N": 5, "J": 4})
    assert rewrite(model).modified
    assert rewrite.changed == ["x"]
    assert FoldShapes()(model).modified
    assert operators(model) == {"Reshape", "Neg"}
    assert list(model.graph.outputs[0].shape) == [5, 12]
    np.testing.assert_array_equal(run(model, x=x)[0], before)
    assert not rewrite(model).modified
    assert not FoldShapes()(model).modified


def test_known_axes_are_folded_where_others_are_not() -> None:
    text = """
    g (float[N,7] x) => (float[M] y) <int64 one = {1}, float zero = {0}> {
        s = Shape (x)
        width = Gather (s, one)
        start = Sub (width, width)
        count = Range (start, width, one)
        places = Cast <to = 1> (count)
        y = Mul (places, zero)
    }"""
    model = parsed(text)
    FoldShapes()(model)
    assert all(not n.outputs[0].uses() for n in model.graph if n.op_type == "Shape")
    assert operators(model) == {"Mul", "Shape"}


def test_names_inside_bodies_and_expressions_are_frozen() -> None:
    text = """
    g (bool c, float[N,3] x) => (float[N,3] y) {
        y = If (c) <then_branch = t () => (float[N,3] u) { u = Neg (x) },
                    else_branch = e () => (float[N,3] v) { v = Abs (x) }>
    }"""
    model = parsed(text)
    FreezeDimensions({"N": 2})(model)
    for graph in (model.graph, *model.graph.subgraphs()):
        assert [list(value.shape) for value in graph.outputs] == [[2, 3]]


def test_unknown_names_and_impossible_sizes_are_named() -> None:
    with pytest.raises(UnknownName, match="dimension 'M'"):
        FreezeDimensions({"M": 3})(parsed("g (float[N] x) => (float[N] y) { y = Neg (x) }"))
    with pytest.raises(ConfigInvalid, match="the size of N is 0, expected 1 or more"):
        FreezeDimensions({"N": 0})


GUARDS = {
    "Max with a constant": "z = Max (x, tiny)\n y = Sqrt (z)",
    "Clip": "z = Clip (x, tiny)\n y = Sqrt (z)",
    "an epsilon": "z = Add (x, tiny)\n y = Sqrt (z)",
    "Where on data": "c = Greater (x, tiny)\n y = Where (c, x, tiny)",
    "Where on a constant that data joins": "c = Equal (tiny, tiny)\n y = Where (c, x, tiny)",
    "arithmetic on real constants": "z = Mul (tiny, tiny)\n y = Add (x, z)",
}


@pytest.mark.parametrize("name", GUARDS)
def test_guards_on_data_stay(name: str) -> None:
    model = parsed(f"g (float[3] x) => (float[3] y) <float tiny = {{1e-12}}> {{ {GUARDS[name]} }}")
    before = [node.op_type for node in model.graph if node.op_type != "Equal"]
    FoldShapes()(model)
    assert [node.op_type for node in model.graph] == before


def test_a_table_that_would_be_huge_stays() -> None:
    text = """g (float[1] x) => (float[N] y) <int64 a = {0}, int64 n = {16777217}, int64 one = {1}> {
        r = Range (a, n, one)
        f = Cast <to = 1> (r)
        y = Add (f, x) }"""
    model = parsed(text)
    before = text_of(model)
    rewrite = FoldShapes()
    assert not rewrite(model).modified
    assert "16777217" in rewrite.refusals[0].reason
    assert text_of(model) == before


CASES = {
    "Add": ("Add(a, b)", 2),
    "Div": ("Div(a, b)", 2),
    "Mod": ("Mod(a, b)", 2),
    "fmod": ("Mod<fmod = 1>(a, b)", 2),
    "Max": ("Max(a, b)", 2),
    "Less": ("Less(a, b)", 2),
    "ReduceProd": ("ReduceProd<keepdims = 0>(a)", 1),
    "ReduceSum": ("ReduceSum<keepdims = 1>(a)", 1),
    "Concat": ("Concat<axis = 0>(a, b)", 2),
    "Range": ("Range(p, q, r)", 3),
    "Slice": ("Slice(a, p1, q1, zero1, r1)", 4),
    "Gather": ("Gather(a, i)", 5),
    "ConstantOfShape": ("ConstantOfShape(i)", 5),
    "Cast": ("Cast<to = 9>(a)", 1),
    "Expand": ("Expand(p, i)", 5),
}


@settings(max_examples=60, deadline=None)
@given(name=st.sampled_from(sorted(CASES)), seed=st.integers(0, 10**6))
@example(name="Slice", seed=1100)  # backwards, and from before the first element
def test_folding_computes_what_onnx_runtime_does(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.integers(-9, 9, (2, 4))
    b[b == 0] = 3
    p, q = rng.integers(-12, 12, 2)
    r = int(rng.choice([-3, -2, -1, 1, 2, 3]))
    i = rng.integers(0, 4, 3)
    weights = {"a": a, "b": b, "i": i, "p": p, "q": q, "r": r}
    weights |= {"p1": [p], "q1": [q], "r1": [r], "zero1": [0]}
    declared = ", ".join(
        f"int64{list(np.shape(v)) if np.ndim(v) else ''} {k} = "
        f"{{{', '.join(str(int(n)) for n in np.ravel(v))}}}"
        for k, v in weights.items()
    )
    text = f"g () => (float made) <{declared}> {{ z = {CASES[name][0]}\n made = Identity(z) }}"
    proto = onnx.parser.parse_model('<ir_version: 8, opset_import: ["" : 18]> ' + text)
    del proto.graph.output[:]
    proto.graph.output.add(name="z")
    del proto.graph.node[1:]
    (expected,) = onnxruntime.InferenceSession(
        onnx.shape_inference.infer_shapes(proto).SerializeToString()
    ).run(None, {})
    model = ir.serde.deserialize_model(proto)
    node = next(iter(model.graph))
    actual = FoldShapes()._value_of(node)
    assert actual is not None
    assert actual.dtype == expected.dtype
    np.testing.assert_array_equal(actual, expected)
