"""Which operator sets and IR versions the installed ONNX Runtime loads, found by trying."""

__all__ = ["installed_bounds"]

from collections.abc import Callable
from functools import cache
from itertools import count

from onnx import ModelProto, NodeProto, TensorProto

# What every ONNX Runtime of the last years loads: the search goes up from there.
_OLD_OPSET, _OLD_IR = 13, 8


@cache
def installed_bounds() -> tuple[int, int]:
    """Return the highest operator set and the highest IR version that ONNX Runtime loads."""
    opset = _highest_supported_version(
        _OLD_OPSET, lambda version: _does_runtime_load(version, _OLD_IR)
    )
    return opset, _highest_supported_version(
        _OLD_IR, lambda version: _does_runtime_load(_OLD_OPSET, version)
    )


def _highest_supported_version(first: int, can_load_version: Callable[[int], bool]) -> int:
    return next(version for version in count(first) if not can_load_version(version + 1))


def _does_runtime_load(opset: int, ir_version: int) -> bool:
    """Return whether ONNX Runtime loads a model of one node, of these versions."""
    from onnxruntime import InferenceSession

    model = ModelProto(ir_version=ir_version)
    model.opset_import.add(domain="", version=opset)
    model.graph.name = "smallest"
    model.graph.node.append(NodeProto(op_type="Neg", input=["x"], output=["y"]))
    for value in (model.graph.input.add(name="x"), model.graph.output.add(name="y")):
        value.type.tensor_type.elem_type = TensorProto.FLOAT
        value.type.tensor_type.shape.dim.add(dim_value=1)
    try:
        InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    except Exception:  # its errors share no class but this one
        return False
    return True
