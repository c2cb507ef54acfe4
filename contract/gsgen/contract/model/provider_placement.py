"""Predicts where a WebGPU provider runs each graph node, from tables of supported operators."""

__all__ = [
    "DATA_SIZED_OPERATORS",
    "VARIADIC",
    "VIEW_OPERATORS",
    "Cause",
    "Placement",
    "frame_nodes",
    "is_copy",
    "placements",
    "shape_arguments",
]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from onnx import ModelProto, NodeProto, TensorProto

from gsgen.contract.model.graph import Graph, names_read
from gsgen.contract.model.model_file import small_array
from gsgen.contract.spec.onnx_facts import (
    CONTROL_FLOW,
    KERNEL_TYPE_INPUT,
    MAIN_DOMAIN,
    RANDOM_OPERATORS,
)
from gsgen.contract.spec.operator_tables import GRAPH_CAPTURE, OperatorTable

# Why a node is not captured. Each has one rule, so that one node makes one finding.
Cause = Literal[
    "", "control flow", "shape", "float64", "int64", "norm", "opset", "operator", "unknown"
]

# Outputs that depend on shapes alone, and are folded once shapes are fixed.
_SHAPE_OPERATORS = frozenset({"Shape", "Size"})
# Operators whose output size depends on values.
DATA_SIZED_OPERATORS = frozenset({"Compress", "NonMaxSuppression", "NonZero", "Unique"})
# Arguments that decide the shape of the result.
_SHAPE_ARGUMENTS = {
    "ConstantOfShape": (0,),
    "Expand": (1,),
    "OneHot": (1,),
    "Pad": (1,),
    "Range": (0, 1, 2),
    "Reshape": (1,),
    "Resize": (2, 3),
    "Slice": (1, 2, 3, 4),
    "Split": (1,),
    "Squeeze": (1,),
    "Tile": (1,),
    "TopK": (1,),
    "Unsqueeze": (1,),
}
_NORM_OPERATORS = frozenset(
    {
        "BatchNormalization",
        "GroupNormalization",
        "InstanceNormalization",
        "LayerNormalization",
        "LpNormalization",
        "MeanVarianceNormalization",
        "RMSNormalization",
        "ReduceL2",
    }
)


@dataclass(frozen=True, slots=True)
class Placement:
    """The prediction whether WebGPU graph capture supports one node, with the reason if not.

    Attributes:
        node: The node.
        dtype: The dtype that selects its kernel; empty if unknown.
        cause: The reason why it is not captured; empty if it is.
        outcomes: Release → its outcome instead of capture; empty where that is irrelevant.
    """

    node: NodeProto
    dtype: str
    cause: Cause
    outcomes: dict[str, str]


def frame_nodes(graph: Graph) -> list[NodeProto]:
    """Return the graph nodes that run every frame; others are folded or dropped at loading."""
    varying_tensors = {tensor.name for tensor in graph.inputs}
    resized_tensors: set[str] = set()  # tensors whose shape follows values
    executed_nodes: list[NodeProto] = []
    for node in graph.nodes:
        names = names_read(node)
        is_random = node.op_type in RANDOM_OPERATORS and node.domain in MAIN_DOMAIN
        changing_tensors = resized_tensors if node.op_type in _SHAPE_OPERATORS else varying_tensors
        if is_random or not changing_tensors.isdisjoint(names):
            varying_tensors.update(node.output)
            executed_nodes.append(node)
            if node.op_type in DATA_SIZED_OPERATORS or not resized_tensors.isdisjoint(names):
                resized_tensors.update(node.output)
    needed_tensors: set[str] = {tensor.name for tensor in graph.outputs}
    nodes: list[NodeProto] = []
    for node in reversed(executed_nodes):
        if not needed_tensors.isdisjoint(node.output):
            needed_tensors.update(names_read(node))
            nodes.append(node)
    return nodes[::-1]


def shape_arguments(node: NodeProto) -> list[str]:
    """Return the names of a node's inputs that determine the shape of its output."""
    positions = _SHAPE_ARGUMENTS.get(node.op_type, ())
    return [node.input[k] for k in positions if k < len(node.input) and node.input[k]]


def placements(graph: Graph, proto: ModelProto, tables: Sequence[OperatorTable]) -> list[Placement]:
    """Predict for every node of a frame whether WebGPU graph capture supports the node."""
    nodes = frame_nodes(graph)
    varying_tensors = {tensor.name for tensor in graph.inputs}
    varying_tensors.update(name for node in nodes for name in node.output)
    opset = next((o.version for o in proto.opset_import if o.domain in MAIN_DOMAIN), 0)
    negative_weights = _negative_weights(proto)
    return [
        _place_node(
            graph,
            node,
            _kernel_variant(graph, node, varying_tensors, negative_weights),
            varying_tensors,
            opset,
            tables,
        )
        for node in nodes
    ]


def _place_node(
    graph: Graph,
    node: NodeProto,
    variant: str,
    varying_tensors: set[str],
    opset: int,
    tables: Sequence[OperatorTable],
) -> Placement:
    dtype = _kernel_dtype(graph, node)
    if node.op_type in CONTROL_FLOW:
        return Placement(node, dtype, "control flow", {})
    if node.op_type in DATA_SIZED_OPERATORS or not varying_tensors.isdisjoint(
        shape_arguments(node)
    ):
        return Placement(node, dtype, "shape", {})
    if "float64" in (dtype, variant.removeprefix("to ")):
        return Placement(node, dtype, "float64", {})
    domain = node.domain in MAIN_DOMAIN
    outcomes = {
        table.runtime: table.outcome(node.op_type, variant, dtype, opset) if domain else ""
        for table in tables
    }
    failures = {
        runtime: outcome for runtime, outcome in outcomes.items() if outcome != GRAPH_CAPTURE
    }
    if not failures:
        return Placement(node, dtype, "", {})
    known = {runtime: outcome for runtime, outcome in failures.items() if outcome}
    if not known:
        return Placement(node, dtype, "unknown", failures)
    return Placement(node, dtype, _placement_cause(node, variant, dtype, known, tables), known)


def _placement_cause(
    node: NodeProto,
    variant: str,
    dtype: str,
    cause_by_failing_node: dict[str, str],
    tables: Sequence[OperatorTable],
) -> Cause:
    if "int64" in (dtype, variant.removeprefix("to ")):
        return "int64"
    other_opsets = [
        table.opset_with_kernel(node.op_type, variant, dtype)
        for table in tables
        if table.runtime in cause_by_failing_node
    ]
    if all(opset is not None for opset in other_opsets):
        return "opset"
    return "norm" if node.op_type in _NORM_OPERATORS else "operator"


def _kernel_dtype(graph: Graph, node: NodeProto) -> str:
    position = KERNEL_TYPE_INPUT.get(node.op_type, 0)
    names = [*node.input[position : position + 1], *node.output[:1]]
    tensors = (graph.tensors.get(name) for name in names)
    return next((t.dtype for t in tensors if t is not None and t.dtype), "")


def _kernel_variant(
    graph: Graph, node: NodeProto, varying_tensors: set[str], negative_weights: frozenset[str]
) -> str:
    """Return a node's variant in operator support tables, e.g. ``cubic`` Resize; empty if usual."""
    ranks = [_rank(graph, name) for name in node.input]
    attributes = {attribute.name: attribute for attribute in node.attribute}
    match node.op_type:
        case "Cast":
            output = graph.tensors.get(node.output[0])
            return f"to {output.dtype}" if output is not None else ""
        case "Conv":
            return "" if "dilations" in attributes else "implicit dilations"
        case "GatherND":
            return "" if node.input[1] in varying_tensors else "constant"
        case "GridSample":
            return "5d" if ranks[0] == 5 else ""
        case "MatMul":
            return "vector" if 1 in ranks else ""
        case "Resize":
            mode = attributes.get("mode")
            return "cubic" if mode is not None and mode.s == b"cubic" else ""
        case "ScatterND" | "ScatterElements":
            return "add" if "reduction" in attributes else ""
        case "Slice":
            return "backwards" if not negative_weights.isdisjoint(node.input[4:5]) else ""
    return ""


def _rank(graph: Graph, name: str) -> int | None:
    tensor = graph.tensors.get(name)
    return None if tensor is None or tensor.dims is None else len(tensor.dims)


def _negative_weights(proto: ModelProto) -> frozenset[str]:
    """Return the names of small integer weights that contain a negative number."""
    integer_types = (TensorProto.INT32, TensorProto.INT64)
    small_weights = {
        w.name: small_array(w) for w in proto.graph.initializer if w.data_type in integer_types
    }
    return frozenset(name for name, a in small_weights.items() if a is not None and (a < 0).any())


VIEW_OPERATORS = frozenset({"Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze"})
"""Operators that return their first input in every case."""

VARIADIC = frozenset({"Max", "Min"})
"""Operators that do with a single input; Sum and Mean have no kernel."""


def is_copy(operator: str, inputs: int, *, keeps_all_axes: bool) -> bool:
    """Return whether an ONNX operator returns its first input bit for bit.

    Args:
        operator: Its type.
        inputs: The number of its inputs.
        keeps_all_axes: Whether a reduction keeps every axis: ``noop_with_empty_axes`` is 1, and no axes are given.
    """
    if operator in VIEW_OPERATORS:
        return True
    if operator.startswith("Reduce"):
        return keeps_all_axes
    return operator in VARIADIC and inputs == 1
