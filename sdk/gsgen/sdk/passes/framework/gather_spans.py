"""How large the numbers inside a graph can become: the contract's ranges, for passes."""

__all__ = ["fits_int32", "spans_of"]

import math
from collections.abc import Mapping

import numpy as np
import onnx_ir as ir
from onnx import TensorProto, numpy_helper

from gsgen.contract.model.graph import Graph, Tensor
from gsgen.contract.model.value_ranges import Interval, intervals
from gsgen.contract.spec.manifest import Manifest
from gsgen.sdk.passes.framework.base import MAIN_DOMAIN

# Weights of more elements are of no index arithmetic, and reading them takes time.
_LARGEST = 1 << 16
_INT32 = (-(2**31), 2**31 - 1)


def spans_of(model: ir.Model, manifest: Manifest | None) -> dict[str, Interval]:
    """Return value → smallest and largest number it can hold; what is not known is absent.

    Args:
        model: Its main graph is looked at.
        manifest: Says what range each input has.
    """
    graph = model.graph
    values = [*graph.inputs, *graph.initializers.values()]
    values += [value for node in graph for value in node.outputs]
    tensors = {value.name or "": _described(value) for value in values}
    nodes = tuple(
        ir.serde.serialize_node(node) for node in graph if node.domain in MAIN_DOMAIN
    )
    seen = Graph((), (), nodes, {}, tensors, frozenset())
    weights = [_weight(value) for value in graph.initializers.values()]
    return intervals(seen, [one for one in weights if one is not None], manifest)


def fits_int32(span: Interval | None, most: int = _INT32[1]) -> bool:
    """Say whether every number of ``span`` is an int32, of at most ``most`` either way."""
    if span is None or not all(math.isfinite(end) for end in span):
        return False
    return max(_INT32[0], -most) <= span[0] <= span[1] <= most


def _described(value: ir.Value) -> Tensor:
    dims = None
    if value.shape is not None:
        dims = tuple(d if isinstance(d, int) else d.value for d in value.shape)
    dtype = None if value.dtype is None else str(value.dtype.numpy())
    return Tensor(value.name or "", dtype, dims)


def _weight(value: ir.Value) -> TensorProto | None:
    tensor = value.const_value
    if tensor is None or value.is_graph_input() or tensor.size > _LARGEST:
        return None
    if tensor.dtype.is_string():
        return None
    # Read, not referred to: it may lie in another file.
    return numpy_helper.from_array(np.asarray(tensor.numpy()), value.name or "")


Spans = Mapping[str, Interval]
