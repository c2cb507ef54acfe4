import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime
import pytest

from gsgen.sdk.passes import EndOutputsOnCompute, MultiplyMatrices

HEAD = '<ir_version: 8, opset_import: ["" : 18]> '
LEVELS = [
    onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL,
    onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL,
]


def parsed(text: str) -> onnx.ModelProto:
    model = onnx.parser.parse_model(HEAD + text)
    return onnx.shape_inference.infer_shapes(model)


def run(model: onnx.ModelProto, level: object, **inputs: np.ndarray) -> list[np.ndarray]:
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = level
    session = onnxruntime.InferenceSession(model.SerializeToString(), options)
    return session.run(None, inputs)


PRODUCTS = {
    "matrix times vector": "g (float[3,4] a, float[4] b) => (float[3] y) { y = MatMul(a, b) }",
    "vector times matrix": "g (float[4] a, float[4,3] b) => (float[3] y) { y = MatMul(a, b) }",
    "vector times vector": "g (float[4] a, float[4] b) => (float y) { y = MatMul(a, b) }",
    "stack times vector": "g (float[2,3,4] a, float[4] b) => (float[2,3] y) { y = MatMul(a, b) }",
    "vector times stack": "g (float[4] a, float[2,4,3] b) => (float[2,3] y) { y = MatMul(a, b) }",
    "matrix times matrix": "g (float[3,4] a, float[4,2] b) => (float[3,2] y) { y = MatMul(a, b) }",
}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", PRODUCTS)
def test_multiply_matrices_keeps_the_product(name: str, level: object) -> None:
    proto = parsed(PRODUCTS[name])
    result = MultiplyMatrices()(ir.serde.deserialize_model(proto))
    assert result.modified is ("vector" in name)
    rng = np.random.default_rng(0)
    shapes = [[d.dim_value for d in v.type.tensor_type.shape.dim] for v in proto.graph.input]
    a, b = (rng.normal(size=shape).astype(np.float32) for shape in shapes)
    rewritten = ir.serde.serialize_model(result.model)
    onnx.checker.check_model(rewritten, full_check=True)
    (computed,) = run(rewritten, level, a=a, b=b)
    np.testing.assert_allclose(computed, a @ b, rtol=1e-5)
    products = [node for node in result.model.graph if node.op_type == "MatMul"]
    assert all(len(value.shape) > 1 for node in products for value in node.inputs)


@pytest.mark.parametrize("level", LEVELS)
def test_a_camera_centre_is_right_at_every_level_of_optimisation(level: object) -> None:
    """Without the pass, ONNX Runtime 1.31 computes R t in place of Rᵀ t when it optimises."""
    proto = parsed(
        "g (float[3,3] r, float[3] t) => (float[3] y) "
        "{ s = Transpose<perm = [1, 0]>(r)\n p = MatMul(s, t)\n y = Neg(p) }"
    )
    rewritten = ir.serde.serialize_model(
        MultiplyMatrices()(ir.serde.deserialize_model(proto)).model
    )
    rng = np.random.default_rng(1)
    r, t = rng.normal(size=(3, 3)).astype(np.float32), rng.normal(size=3).astype(np.float32)
    (actual,) = run(rewritten, level, r=r, t=t)
    np.testing.assert_allclose(actual, -r.T @ t, rtol=1e-5)


def test_multiply_matrices_reaches_graph_outputs_and_subgraphs() -> None:
    proto = parsed(
        "g (bool c, float[3,3] a, float[3] b) => (float[3] y) {"
        " y = If (c) <then_branch = t () => (float[3] u) { u = MatMul(a, b) },"
        " else_branch = e () => (float[3] v) { v = Neg(b) }> }"
    )
    model = ir.serde.deserialize_model(proto)
    result = MultiplyMatrices()(model)
    assert result.modified
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(3, 3)).astype(np.float32), rng.normal(size=3).astype(np.float32)
    rewritten = ir.serde.serialize_model(result.model)
    for c, array in ((True, a @ b), (False, -b)):
        (computed,) = run(rewritten, LEVELS[1], c=np.array(c), a=a, b=b)
        np.testing.assert_allclose(computed, array, rtol=1e-5)


@pytest.mark.parametrize(
    ("body", "modified"),
    [
        ("y = Reshape<allowzero = 0>(x, s)", True),
        ("y = Identity(x)", True),
        ("y = Neg(x)", False),
        ("z = Reshape<allowzero = 0>(x, s)\n y = Neg(z)", False),
        ("y = Max(x)", True),
        (
            "none = Constant <value = int64[0] {}> () y = ReduceSum <noop_with_empty_axes = 1> (x, none)",
            True,
        ),
        ("y = ReduceMax <noop_with_empty_axes = 1> (x)", True),
    ],
)
def test_outputs_end_on_compute_only_where_they_did_not(body: str, modified: bool) -> None:
    text = f"g (float[2,3] x) => (float[N,M] y) <int64[2] s = {{2, 3}}> {{ {body} }}"
    result = EndOutputsOnCompute()(ir.serde.deserialize_model(parsed(text)))
    assert result.modified is modified
    proto = ir.serde.serialize_model(result.model)
    assert [output.name for output in proto.graph.output] == ["y"]
    assert proto.graph.node[-1].op_type in ("Mul", "Neg")
    x = np.array([[1, -0.0, np.inf], [3e38, 1e-45, 2]], np.float32)
    (computed,) = run(proto, LEVELS[0], x=x)
    expected = -x if "Neg" in body else x
    np.testing.assert_array_equal(computed.view(np.uint32), expected.view(np.uint32))


def test_names_that_the_pass_would_give_may_be_taken() -> None:
    text = """g (float[2,3] x) => (float[6] y, float[6] y_uncopied) <int64[1] s = {6}> {
        y = Reshape (x, s)
        y_uncopied = Neg (y) }"""
    result = EndOutputsOnCompute()(ir.serde.deserialize_model(parsed(text)))
    proto = ir.serde.serialize_model(result.model)
    x = np.arange(6, dtype=np.float32).reshape(2, 3)
    (computed, negative) = run(proto, LEVELS[0], x=x)
    np.testing.assert_array_equal(computed, x.reshape(-1))
    np.testing.assert_array_equal(negative, -x.reshape(-1))


def test_a_mask_ends_on_an_operator_of_masks() -> None:
    text = "g (bool[2,3] x) => (bool[6] y) <int64[1] s = {6}> { y = Reshape (x, s) }"
    result = EndOutputsOnCompute()(ir.serde.deserialize_model(parsed(text)))
    proto = ir.serde.serialize_model(result.model)
    onnx.checker.check_model(proto, full_check=True)
    x = np.array([[True, False, True], [False, False, True]])
    (computed,) = run(proto, LEVELS[0], x=x)
    np.testing.assert_array_equal(computed, x.reshape(-1))


def test_a_weight_and_a_tensor_twice_become_outputs_of_their_own() -> None:
    text = "g (float[2] x) => (float[2] w, float[2] y) <float[2] w = {1, 2}> { y = Neg(x) }"
    proto = parsed(text)
    model = ir.serde.deserialize_model(proto)
    model.graph.outputs.append(model.graph.outputs[1])
    assert EndOutputsOnCompute()(model).modified
    makers = [value.producer().op_type for value in model.graph.outputs]
    assert makers == ["Mul", "Neg", "Mul"]
