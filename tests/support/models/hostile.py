"""Generators of a stranger that take the time or the memory of those who run them."""

__all__ = ["HOSTILE"]

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import onnx
import onnx.parser
from onnx import NodeProto, TensorProto

from gsgen.conformance.fixtures.builders.moving import drifting_model
from support.models.endless import endless

_LAYERS: Final = 40
_ROWS: Final = 200_000_000  # of 10 numbers of 4 bytes: 8 GB


def endless_loop(folder: Path) -> Path:
    """Return a generator of 2 KB whose first frame takes 10¹⁹ turns of a loop."""
    return endless(folder, after=-1.0)


def doubling_functions(folder: Path) -> Path:
    """Return a generator of 5 KB whose functions each call the next twice: 2⁴⁰ nodes in all."""
    path = folder / "doubling.onnx"
    drifting_model().write(path)
    model = onnx.load(path)
    for layer in range(_LAYERS):
        call = f"mine.f{layer + 1}" if layer < _LAYERS - 1 else "Neg"
        text = f'<domain: "mine", opset_import: ["" : 18, "mine" : 1]> f{layer} (x) => (y) '
        function = onnx.parser.parse_function(text + f"{{ m = {call} (x) y = {call} (m) }}")
        model.functions.append(function)
    model.opset_import.add(domain="mine", version=1)
    first_node = model.graph.node[0]
    call_node = NodeProto(
        op_type="f0", domain="mine", input=[first_node.input[0]], output=["doubled"]
    )
    first_node.input[0] = "doubled"
    model.graph.node.insert(0, call_node)
    path.write_bytes(model.SerializeToString())
    return path


def large_output(folder: Path) -> Path:
    """Return a generator of 2 KB with another output, of 8 GB."""
    path = folder / "large.onnx"
    drifting_model().with_weights(shape=np.array([_ROWS, 10], np.int64)).write(path)
    model = onnx.load(path)
    node = NodeProto(op_type="ConstantOfShape", input=["shape"], output=["large"])
    model.graph.node.append(node)
    tensor = model.graph.output.add(name="large").type.tensor_type
    tensor.elem_type = TensorProto.FLOAT
    for size in (_ROWS, 10):
        tensor.shape.dim.add(dim_value=size)
    path.write_bytes(model.SerializeToString())
    return path


HOSTILE: Final[dict[str, Callable[[Path], Path]]] = {
    "loop": endless_loop,
    "functions": doubling_functions,
    "output": large_output,
}
"""Name → writes the model to a folder."""
