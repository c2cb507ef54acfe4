"""What a deformation field samples: fixed points once, and lines that move as a whole by products."""

import numpy as np
import onnx_ir as ir
import pytest
from onnx_ir.passes.common import ShapeInferencePass

from gsgen.sdk.passes.lowering.pick_parts import LowerSplitsToSlices
from gsgen.sdk.passes.lowering.sample_by_product import SampleByProduct
from gsgen.sdk.passes.simplify.merge_transposes import MergeTransposes
from support.passes import operators, parsed, run


def with_weight(model: ir.Model, name: str, array: np.ndarray) -> ir.Model:
    """Give the graph a weight that text would be too long for."""
    uses = [
        (n, k)
        for n in model.graph.all_nodes()
        for k, v in enumerate(n.inputs)
        if v and v.name == name
    ]
    tensor = ir.tensor(array, name=name)
    value = ir.Value(
        name=name, const_value=tensor, type=ir.TensorType(tensor.dtype), shape=ir.Shape(array.shape)
    )
    model.graph.register_initializer(value)
    for node, use in uses:
        node.replace_input_with(use, value)
    ShapeInferencePass(strict_mode=False)(model)
    return model


RNG = np.random.default_rng(4)
PLANE = RNG.normal(size=(1, 3, 5, 7)).astype(np.float32)
# On cells, between them, on the border, and beyond it.
SAMPLE_POINTS = np.linspace(-1.4, 1.4, 29, dtype=np.float32)[:, None]
TIMES = [-1.7, -1.0, -0.31, 0.0, 0.5, 1.0, 1.13]


def field(order: str, attributes: str) -> ir.Model:
    text = (
        "g (float[1] t) => (float[1,3,29,1] y) <int64[2] tall = {29, 1}, int64[4] grid = {1, 29, 1, 2}> {"
        " s = Unsqueeze (t, zero) e = Expand (s, tall)"
        f" j = Concat <axis = 1> ({order}) g = Reshape (j, grid) y = GridSample <{attributes}> (plane, g) }}"
    ).replace("<int64[2]", "<int64[1] zero = {0}, int64[2]")
    return with_weight(with_weight(parsed(text), "plane", PLANE), "p", SAMPLE_POINTS)


@pytest.mark.parametrize("align", [0, 1])
@pytest.mark.parametrize("padding", ["zeros", "border"])
@pytest.mark.parametrize("order", ["p, e", "e, p"])
def test_a_line_that_moves_as_a_whole_is_sampled_by_products(
    order: str, padding: str, align: int
) -> None:
    attributes = f'align_corners = {align}, padding_mode = "{padding}"'
    model = field(order, attributes)
    before = [run(model, t=np.array([t], np.float32))[0] for t in TIMES]
    assert SampleByProduct()(model).modified
    assert "GridSample" not in operators(model)
    for t, expected in zip(TIMES, before, strict=True):
        (actual,) = run(model, t=np.array([t], np.float32))
        np.testing.assert_allclose(actual, expected, atol=2e-6)
    assert not SampleByProduct()(model).modified


@pytest.mark.parametrize(
    ("attributes", "reason"),
    [
        ('mode = "nearest"', "mode is nearest"),
        ('padding_mode = "reflection"', "padding is reflection"),
    ],
)
def test_samples_that_do_not_factor_are_left_alone(attributes: str, reason: str) -> None:
    rewrite = SampleByProduct()
    assert not rewrite(field("p, e", attributes)).modified
    assert reason in rewrite.refusals[0].reason


@pytest.mark.parametrize("inputs", ["float[29,1] e", "float[29,1] p, float[1] t"])
def test_points_that_move_on_their_own_are_left_alone(inputs: str) -> None:
    expand = "e = Expand (s, tall)" if "t" in inputs.split() else ""
    start = "s = Reshape (t, ones)" if expand else ""
    text = (
        f"g ({inputs}) => (float[1,3,29,1] y) <int64[2] tall = {{29, 1}}, int64[2] ones = {{1, 1}}, "
        f"int64[4] grid = {{1, 29, 1, 2}}> {{ {start} {expand} j = Concat <axis = 1> (p, e) "
        "g = Reshape (j, grid) y = GridSample (plane, g) }"
    )
    model = with_weight(parsed(text), "plane", PLANE)
    if "p" not in inputs.replace(",", " ").split():
        model = with_weight(model, "p", SAMPLE_POINTS)
    assert not SampleByProduct()(model).modified


# ---- Parts -----------------------------------------------------------------------------------

PICKS = {
    "one piece": ("Concat <axis = 1> (a, b)", "0, 2", {"Gather"}),
    "a whole piece": ("Concat <axis = 1> (a, b)", "3", set()),
    "of both": ("Concat <axis = 1> (a, b)", "1, -1", {"Gather", "Concat"}),
    "turned": ("Transpose <perm = [1, 0]> (a)", "2, 0, 2", {"Gather", "Transpose"}),
}


@pytest.mark.parametrize("name", PICKS)
def test_parts_are_taken_before_they_are_joined(name: str) -> None:
    body, places, left = PICKS[name]
    axis = 0 if name == "turned" else 1
    count = len(places.split(","))
    text = (
        f"g (float[4,3] x, float[4,1] z) => (float[A,B] y) <int64[{count}] i = {{{places}}}> "
        f"{{ a = Neg (x) b = Abs (z) j = {body} p = Gather <axis = {axis}> (j, i) y = Exp (p) }}"
    )
    model = parsed(text)
    x, z = (RNG.normal(size=(4, size)).astype(np.float32) for size in (3, 1))
    (before,) = run(model, x=x, z=z)
    assert LowerSplitsToSlices()(model).modified
    (last,) = (node for node in model.graph if node.op_type == "Exp")
    result, kinds = last.inputs[0].producer(), set()
    while result.op_type in ("Gather", "Concat", "Transpose"):
        kinds.add(result.op_type)
        result = result.inputs[0].producer()
    assert kinds == left
    np.testing.assert_array_equal(run(model, x=x, z=z)[0], before)
    assert not LowerSplitsToSlices()(model).modified


@pytest.mark.parametrize(
    "text",
    [
        "g (float[4,N] x) => (float[4,1] y) <int64[1] i = {0}> { j = Concat <axis = 1> (x, x) y = Gather <axis = 1> (j, i) }",
        "g (float[4,2] x) => (float[2,2] y) <int64[2] i = {0, 5}> { j = Concat <axis = 0> (x, x) k = Neg (j) y = Gather (k, i) }",
        "g (float[4,2] x) => (float[8,1] y) <int64[1] i = {0}> { j = Concat <axis = 0> (x, x) y = Gather <axis = 1> (j, i) }",
    ],
)
def test_slices_of_unknown_shape_stay(text: str) -> None:
    assert not LowerSplitsToSlices()(parsed(text)).modified


@pytest.mark.parametrize(
    ("first", "second", "left"),
    [("[1, 0, 2]", "[1, 0, 2]", 0), ("[1, 2, 0]", "[0, 2, 1]", 1), ("[1, 2, 0]", "[1, 2, 0]", 1)],
)
def test_transposes_are_merged(first: str, second: str, left: int) -> None:
    text = (
        "g (float[2,3,4] x) => (float[A,B,C] y) "
        f"{{ a = Transpose <perm = {first}> (x) b = Transpose <perm = {second}> (a) y = Neg (b) }}"
    )
    model, x = parsed(text), RNG.normal(size=(2, 3, 4)).astype(np.float32)
    (before,) = run(model, x=x)
    assert MergeTransposes()(model).modified
    (last,) = (node for node in model.graph if node.op_type == "Neg")
    chain = last.inputs[0].producer()
    assert (chain is not None) == bool(left)
    assert chain is None or chain.inputs[0].name == "x"
    np.testing.assert_array_equal(run(model, x=x)[0], before)
