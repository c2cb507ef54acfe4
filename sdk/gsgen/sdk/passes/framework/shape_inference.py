"""Infers the types and shapes of a graph's values, those of sequences and optionals included."""

__all__ = ["infer_shapes"]

from collections.abc import Iterator

import onnx
import onnx_ir as ir
from onnx_ir.passes.common import ShapeInferencePass

_CONTAINER_TYPE_PREFIXES = ("seq(", "optional(", "map(")


def infer_shapes(model: ir.Model) -> None:
    """Infer the types and shapes of a model's values, in place.

    Without data propagation: for tables of a million rows it takes minutes, and the pass
    ``fold-shapes`` finds the same facts. Nothing is inferred if all types and sizes are known, as
    they are after most passes: a large graph takes seconds each time.
    """
    if all(_is_known(value) for node in model.graph.all_nodes() for value in node.outputs):
        return
    containers = _container_types(model)
    ShapeInferencePass(check_type=False, strict_mode=False, data_prop=False)(model)
    # onnx-ir gives a sequence or an optional without a type that of a tensor.
    for value, container_type in containers.items():
        value.type, value.shape = container_type, None


def _is_known(value: ir.Value) -> bool:
    """Return whether a value is a tensor of a known type, of which all sizes are numbers."""
    shape = value.shape
    return value.dtype is not None and shape is not None and shape.is_static()


def _container_types(model: ir.Model) -> dict[ir.Value, ir.TypeProtocol | None]:
    """Return the values that are sequences or optionals, with their types.

    Such a value comes from an input, from an operator that makes nothing else, or from one that
    passes values on (Identity, If, Loop, Scan), which is why the whole graph is inferred.
    """
    if not (_has_container_input(model) or any(map(_makes_container, model.graph.all_nodes()))):
        return {}
    inferred = ir.from_proto(
        onnx.shape_inference.infer_shapes(ir.to_proto(model), check_type=False, strict_mode=False)
    )
    types: dict[ir.Value, ir.TypeProtocol | None] = {}
    for graph, inferred_graph in zip(model.graphs(), inferred.graphs(), strict=True):
        by_name = {value.name: value for value in _values(inferred_graph)}
        for value in _values(graph):
            known = by_name.get(value.name)
            merged_type = value.type if known is None or known.type is None else known.type
            if isinstance(merged_type, ir.SequenceType | ir.OptionalType):
                types[value] = merged_type
    return types


def _values(graph: ir.Graph) -> Iterator[ir.Value]:
    """Yield the inputs of a graph and the outputs of its own nodes."""
    yield from graph.inputs
    for node in graph:
        yield from node.outputs


def _has_container_input(model: ir.Model) -> bool:
    return any(
        isinstance(value.type, ir.SequenceType | ir.OptionalType)
        for graph in model.graphs()
        for value in graph.inputs
    )


def _makes_container(node: ir.Node) -> bool:
    """Return whether an output of a node's operator can only be a sequence, optional or map."""
    try:
        schema = onnx.defs.get_schema(node.op_type, node.domain)
    except onnx.defs.SchemaError:
        return False
    return any(
        formal_parameter.types
        and all(name.startswith(_CONTAINER_TYPE_PREFIXES) for name in formal_parameter.types)
        for formal_parameter in schema.outputs
    )
