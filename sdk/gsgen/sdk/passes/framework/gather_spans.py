"""Ranges of values inside an ONNX graph, from gsgen's interval arithmetic."""

__all__ = ["fits_int32", "spans_of"]

import math
from collections.abc import Mapping

import numpy as np
import onnx_ir as ir
from onnx import TensorProto, numpy_helper

from gsgen.contract.model.graph import Graph, Tensor
from gsgen.contract.model.value_ranges import Interval, intervals
from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN

# Larger weights do not take part in index arithmetic, and reading them takes time.
_MAX_VALUES = 1 << 16
_INT32 = (-(2**31), 2**31 - 1)


def spans_of(model: ir.Model, manifest: Manifest | None) -> dict[str, Interval]:
    """Return the smallest and the largest possible number of each graph value, where known."""
    graph = model.graph
    values = [*graph.inputs, *graph.initializers.values()]
    values += [value for node in graph for value in node.outputs]
    tensors = {value.name or "": _describe_value(value) for value in values}
    nodes = tuple(ir.serde.serialize_node(node) for node in graph if node.domain in MAIN_DOMAIN)
    typed_graph = Graph(
        inputs=(), outputs=(), nodes=nodes, initializers={}, tensors=tensors, functions=frozenset()
    )
    weights = [_weight(value) for value in graph.initializers.values()]
    return intervals(typed_graph, [tensor for tensor in weights if tensor is not None], manifest)


def fits_int32(span: Interval | None, most: int = _INT32[1]) -> bool:
    """Return whether a value range lies within int32, and within −``most`` to ``most``."""
    if span is None or not all(math.isfinite(end) for end in span):
        return False
    return max(_INT32[0], -most) <= span[0] <= span[1] <= most


def _describe_value(value: ir.Value) -> Tensor:
    dims = None
    if value.shape is not None:
        dims = tuple(d if isinstance(d, int) else d.value for d in value.shape)
    dtype = None if value.dtype is None else str(value.dtype.numpy())
    return Tensor(value.name or "", dtype, dims)


def _weight(value: ir.Value) -> TensorProto | None:
    tensor = value.const_value
    if tensor is None or value.is_graph_input() or tensor.size > _MAX_VALUES:
        return None
    if tensor.dtype.is_string():
        return None
    # A copy, not a reference: the tensor may be stored in another file.
    return numpy_helper.from_array(np.asarray(tensor.numpy()), value.name or "")


ValueSpans = Mapping[str, Interval]
