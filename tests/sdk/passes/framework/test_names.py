"""Names that passes give are new, whatever a model calls its own values."""

import numpy as np
import onnx_ir as ir
import pytest
from onnx_ir.passes.common import NameFixPass

from gsgen.contract.errors import GsgenError
from gsgen.sdk.float16.to_float16 import ToFloat16
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint, append_output, new_node
from gsgen.sdk.passes.repairs import RenameOutputs
from support.passes import parsed, run

X = np.array([1.5, -2.25], np.float32)


def names(model: ir.Model) -> list[str]:
    values = [*model.graph.inputs, *model.graph.initializers.values()]
    values += [value for node in model.graph for value in node.outputs]
    return [value.name or "" for value in values]


def require_new(model: ir.Model) -> None:
    assert len(set(names(model))) == len(names(model)), names(model)


def test_a_value_that_makes_way_for_another_gets_a_new_name() -> None:
    model = parsed("g (float[2] x) => (float[2] y) { y_replaced = Neg (x) y = Abs (y_replaced) }")
    write = InsertionPoint(model.graph[1])
    write.replace(write.op("Relu", model.graph[0].outputs[0]))
    require_new(model)
    np.testing.assert_array_equal(run(model, x=X)[0], np.maximum(-X, 0))


def test_an_output_that_is_computed_on_gets_a_new_name() -> None:
    model = parsed(
        "g (float[2] x) => (float[2] y) { y_before_end = Neg (x) y = Abs (y_before_end) }"
    )
    old = model.graph.outputs[0]
    end = new_node("Neg", [old], "end", dtype=old.dtype, shape=old.shape)
    append_output(model.graph, old, [end])
    require_new(model)
    np.testing.assert_array_equal(run(model, x=X)[0], -abs(X))


@pytest.mark.parametrize("outputs", [False, True])
def test_an_output_in_float16_gets_a_new_name(outputs: bool) -> None:
    model = parsed(
        "g (float[2] x) => (float[2] y) "
        "{ y_float16 = Neg (x) y_float32 = Abs (y_float16) y = Neg (y_float32) }"
    )
    ToFloat16([] if not outputs else ["y"], outputs=outputs)(model)
    require_new(model)
    np.testing.assert_array_equal(run(model, x=X)[0], -abs(X))


def test_what_is_called_like_a_renamed_output_makes_way() -> None:
    model = parsed(
        "g (float[2] x, bool c) => (float[2] y) "
        "<float[2] color = {3, 4}, float[2] color_inner = {1, 1}> "
        "{ gaussians = Add (x, color) s = If (c) "
        "<then_branch = t () => (float[2] rows) { rows = Neg (gaussians) }, "
        "else_branch = e () => (float[2] b) { b = Identity (gaussians) }> "
        "y = Mul (s, color_inner) z = Abs (s) }"
    )
    model.graph.outputs.append(model.graph[3].outputs[0])
    model.graph.outputs[1].type = model.graph.outputs[0].type
    RenameOutputs({"y": "color", "z": "rows"})(model)
    NameFixPass()(model)
    require_new(model)
    result, size = run(model, x=X, c=np.array(True))
    expected = X + np.array([3, 4], np.float32)
    np.testing.assert_array_equal(result, -expected)
    np.testing.assert_array_equal(size, abs(expected))
    assert [value.name for value in model.graph.outputs] == ["color", "rows"]


@pytest.mark.parametrize("selected", ["x", "z"])
def test_a_name_of_an_input_or_output_is_not_given_again(selected: str) -> None:
    model = parsed("g (float[2] x) => (float[2] y, float[2] z) { y = Abs (x) z = Neg (x) }")
    with pytest.raises(GsgenError) as caught:
        RenameOutputs({"y": selected})(model)
    assert str(caught.value) == f"{selected}: already exists, so output 'y' cannot be renamed to it"
