"""Rounding without Round: the same numbers, ties included."""

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime
import pytest

from gsgen.sdk.passes import LowerRoundToFloor

TEXT = """
<ir_version: 8, opset_import: ["" : 18]>
g (DTYPE[N] x) => (DTYPE[N] y) { y = Round (x) }
"""
EDGES = [0.5, 1.5, 2.5, 0.49999997, 8388607.5, 4194304.5, 1e30, np.inf, np.nan, 0.0]


def run(model: onnx.ModelProto, x: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return session.run(None, {"x": x})[0]


@pytest.mark.parametrize(("text", "dtype"), [("float", "float32"), ("float16", "float16")])
def test_rounding_by_floor_is_rounding(text: str, dtype: str) -> None:
    proto = onnx.parser.parse_model(TEXT.replace("DTYPE", text))
    result = LowerRoundToFloor()(ir.serde.deserialize_model(proto))
    assert result.modified
    rewritten = ir.serde.serialize_model(result.model)
    onnx.checker.check_model(rewritten, full_check=True)
    assert "Round" not in {node.op_type for node in rewritten.graph.node}
    assert rewritten.graph.output[0].name == "y"
    rng = np.random.default_rng(1)
    with np.errstate(over="ignore"):
        x = np.concatenate([EDGES, np.negative(EDGES), rng.normal(0, 20, 500)]).astype(dtype)
    np.testing.assert_array_equal(run(rewritten, x), run(proto, x))


def test_a_model_that_rounds_nothing_is_left_alone() -> None:
    proto = onnx.parser.parse_model(TEXT.replace("DTYPE", "float").replace("Round", "Floor"))
    assert not LowerRoundToFloor()(ir.serde.deserialize_model(proto)).modified
