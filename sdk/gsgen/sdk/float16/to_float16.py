"""Converts an ONNX graph to float16, except for given nodes."""

__all__ = [
    "FLOAT", "FLOAT16", "Boundary", "ToFloat16", "can_compute_in_float16", "convertible_indices",
    "node_key",
]  # fmt: skip

from collections.abc import Collection, Iterator

import numpy as np
import onnx
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.sdk.float16.weight_tables import HalfTable, half_table
from gsgen.sdk.passes.framework.base import ErrorBudget, RewriteTarget, is_op, opset_of
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import new_node, unused_name, weight
from gsgen.sdk.rewriting.constant_subgraph import constant_nodes

FLOAT, FLOAT16 = ir.DataType.FLOAT, ir.DataType.FLOAT16
_FLOAT16_TYPE = "tensor(float16)"
# Operators that read shapes, not numbers, so that they need no Cast.
_SHAPE_OPERATORS = ("Shape", "Size")


class ToFloat16(SkippableRewrite):
    """Compute in float16, except for nodes in ``keep`` and operators without float16 kernels.

    Weights and tensors are half as large, and many devices compute twice as fast. Inputs of a frame
    stay float32. Between a float16 and a float32 node stands one Cast, shared by all readers. A
    table in ``stored`` is held in 16 bits a number for readers of either dtype: as float16, or as
    uint16 in even steps where that is closer (:mod:`gsgen.sdk.float16.weight_tables`), with a Cast,
    a Mul and an Add that runtimes compute once. A table that is in ``unstepped``, too, is held as
    float16. Another weight with readers of both dtypes is held twice::

        x → Mul → Add → y    →    x → Cast → Mul → Add → y float16

    :mod:`gsgen.sdk.float16.convert_model` measures which nodes to keep in float32. Alone, this pass
    rounds values to float16, and overflows beyond 65,504. Bodies of If, Loop and Scan stay float32,
    as do nodes that depend on weights alone, which are computed once.
    """

    name = "to-float16"
    exactness = ErrorBudget(relative=1e-2)
    wanted_by = "the user alone: `gsgen float16`"

    def __init__(
        self,
        keep: Collection[str] = (),
        *,
        outputs: bool = True,
        stored: Collection[str] = (),
        unstepped: Collection[str] = (),
    ) -> None:
        super().__init__()
        self.keep, self.outputs = frozenset(keep), outputs
        self.stored, self.unstepped = frozenset(stored), frozenset(unstepped)

    @classmethod
    def for_target(cls, target: RewriteTarget) -> None:
        """Return None: no target runtime needs float16, so targets never select this rewrite."""
        return

    def rewrite(self, model: ir.Model) -> None:
        """Convert nodes, weights and outputs to float16, and insert Casts at float32 nodes."""
        graph, opset = model.graph, opset_of(model)
        constant_node_set = set(constant_nodes(graph))
        selected = [
            node
            for node in graph
            if node not in constant_node_set
            and node_key(node) not in self.keep
            and can_compute_in_float16(node, opset)
        ]
        half_inputs = {
            (node, index) for node in selected for index in convertible_indices(node, opset)[0]
        }
        native_float16_values = {
            node.outputs[index]
            for node in selected
            for index in convertible_indices(node, opset)[1]
        }
        ends = {value for value in graph.outputs if self.outputs and _is_float32(value)}
        for node in selected:
            self.note(node)
            if is_op(node, "Cast") and node.outputs[0] in native_float16_values:
                node.attributes["to"] = ir.AttrInt64("to", FLOAT16.value)
        for value in list(_values(graph)):
            if not _is_float32(value):
                continue
            if value in native_float16_values:
                value.type = ir.TensorType(FLOAT16)
            if value.is_initializer() and not value.is_graph_input():
                stored, rounds_in_steps = (
                    value.name in self.stored,
                    value.name not in self.unstepped,
                )
                _convert_weight(
                    graph, value, half_inputs, stored=stored, rounds_in_steps=rounds_in_steps
                )
            else:
                _convert_value(graph, value, half_inputs, is_half=value in native_float16_values)
        for index, value in enumerate(list(graph.outputs)):
            if value.is_graph_input() and value in ends:
                self.refuse(value, "it is an input, too, and inputs stay float32")
            elif value in ends or value in native_float16_values:
                _convert_output(graph, index, value, is_half=value in ends)


def node_key(node: ir.Node) -> str:
    """Return the key that identifies a node in lists: the name of its first output."""
    return next((value.name for value in node.outputs if value.name), node.name or "")


def can_compute_in_float16(node: ir.Node, opset: int) -> bool:
    """Return whether a node that computes in float32 can compute in float16."""
    inputs, outputs = convertible_indices(node, opset)
    return bool(inputs or outputs)


def _adds_float32_constants(schema: onnx.defs.OpSchema) -> bool:
    """Return whether an operator is defined by nodes that add float32 constants to its inputs.

    A runtime without a kernel for it takes these nodes, whose types differ in float16.
    """
    if not schema.has_function:  # type: ignore[attr-defined]  # missing in the types of onnx
        return False
    nodes = schema.function_body.node
    constants = {
        name
        for node in nodes
        if node.op_type == "Constant"
        for attribute in node.attribute
        if attribute.name == "value_float" or attribute.t.data_type == onnx.TensorProto.FLOAT
        for name in node.output
    }
    return any(node.op_type == "Add" and constants & set(node.input) for node in nodes)


def convertible_indices(node: ir.Node, opset: int) -> tuple[list[int], list[int]]:
    """Return the indices of the float32 inputs and outputs of a node that can become float16.

    Inputs and outputs with the same type variable change together; if one of them cannot become
    float16, none of them does.
    """
    schema = _schema(node, opset)
    if schema is None or is_op(node, *_SHAPE_OPERATORS) or _has_containers(node):
        return [], []
    if _adds_float32_constants(schema):
        return [], []
    typed_inputs = _floats(node.inputs, schema.inputs)
    typed_outputs = _floats(node.outputs, schema.outputs)
    # An attribute decides the type of an output whose type variable no input has.
    free_types = {formal_parameter.type_str for _, formal_parameter in typed_outputs} - {
        formal_parameter.type_str for _, formal_parameter in typed_inputs
    }
    if free_types and not is_op(node, "Cast"):
        return [], []
    fixed_types = {
        formal_parameter.type_str
        for _, formal_parameter in (*typed_inputs, *typed_outputs)
        if _FLOAT16_TYPE not in formal_parameter.types
    }
    variables = {constraint.type_param_str for constraint in schema.type_constraints}
    if fixed_types & variables:
        return [], []
    return tuple(  # type: ignore[return-value]
        [index for index, formal_parameter in part if formal_parameter.type_str not in fixed_types]
        for part in (typed_inputs, typed_outputs)
    )


def _is_float32(value: ir.Value) -> bool:
    """Return whether a value is a tensor in float32, not a sequence or an optional of them."""
    is_container_type = isinstance(value.type, ir.SequenceType | ir.OptionalType)
    return value.dtype == FLOAT and not is_container_type


def _has_containers(node: ir.Node) -> bool:
    """Return whether an input or output is a sequence or an optional: no Cast converts it."""
    values = (value for value in (*node.inputs, *node.outputs) if value is not None)
    return any(isinstance(value.type, ir.SequenceType | ir.OptionalType) for value in values)


def _schema(node: ir.Node, opset: int) -> onnx.defs.OpSchema | None:
    bodies = any(
        a.type in (ir.AttributeType.GRAPH, ir.AttributeType.GRAPHS)
        for a in node.attributes.values()
    )
    # An attribute names the type of the result: BitCast would read other bits.
    names_type = "dtype" in node.attributes or ("to" in node.attributes and not is_op(node, "Cast"))
    if node.domain not in MAIN_DOMAIN or bodies or names_type:
        return None
    try:
        return onnx.defs.get_schema(node.op_type, opset)
    except onnx.defs.SchemaError:
        return None


def _floats(
    values: Collection[ir.Value | None],
    formal_parameters: Collection["onnx.defs.OpSchema.FormalParameter"],
) -> list[tuple[int, "onnx.defs.OpSchema.FormalParameter"]]:
    formal_parameter_list = list(formal_parameters)  # the last one may be variadic
    return [
        (index, formal_parameter_list[min(index, len(formal_parameter_list) - 1)])
        for index, value in enumerate(values)
        if value is not None and _is_float32(value)
    ]


def _values(graph: ir.Graph) -> Iterator[ir.Value]:
    yield from graph.inputs
    yield from (value for value in graph.initializers.values() if not value.is_graph_input())
    yield from (value for node in graph for value in node.outputs)


HalfInputs = set[tuple[ir.Node, int]]


def _readers(value: ir.Value) -> list[tuple[ir.Node, int]]:
    return [(node, index) for node, index in value.uses() if not is_op(node, *_SHAPE_OPERATORS)]


def _convert_weight(
    graph: ir.Graph,
    value: ir.Value,
    half_inputs: HalfInputs,
    *,
    stored: bool,
    rounds_in_steps: bool,
) -> None:
    readers = _readers(value)
    half = [use for use in readers if use in half_inputs]
    if not (half or stored) or value.const_value is None:
        return
    array = value.const_value.numpy()
    float32_uses = [use for use in readers if use not in half_inputs]
    if float32_uses and stored and not value.is_graph_output():
        _store_table(graph, value, half_table(array, rounds_in_steps=rounds_in_steps), half_inputs)
        return
    with np.errstate(over="ignore"):
        array = array.astype(np.float16)
    if value.is_graph_output() or float32_uses:
        copy = weight(graph, f"{value.name}_float16", array)
        for node, index in half:
            node.replace_input_with(index, copy)
        return
    value.const_value = ir.tensor(array, name=value.name)
    value.type = ir.TensorType(FLOAT16)


def _store_table(
    graph: ir.Graph, value: ir.Value, table: HalfTable, half_inputs: HalfInputs
) -> None:
    """Store a graph weight in 16 bits, followed by nodes that decode the weight for its readers."""
    value.const_value = ir.tensor(table.numbers, name=value.name)
    value.type = ir.TensorType(value.const_value.dtype)
    if table.step is None or table.start is None:
        _convert_value(graph, value, half_inputs, is_half=True)
        return
    readers = _readers(value)
    numbers = _new_cast_node(value, FLOAT)
    name = f"{value.name}_scaled"
    step = weight(graph, f"{value.name}_step", table.step)
    start = weight(graph, f"{value.name}_start", table.start)
    scaled = new_node("Mul", [numbers.outputs[0], step], name, dtype=FLOAT, shape=value.shape)
    name = f"{value.name}_moved"
    shifted_table = new_node(
        "Add", [scaled.outputs[0], start], name, dtype=FLOAT, shape=value.shape
    )
    for node in (shifted_table, scaled, numbers):
        _insert_node_after(graph, value, node)
    for node, index in readers:
        node.replace_input_with(index, shifted_table.outputs[0])
    _convert_value(graph, shifted_table.outputs[0], half_inputs, is_half=False)


def _convert_value(
    graph: ir.Graph, value: ir.Value, half_inputs: HalfInputs, *, is_half: bool
) -> None:
    """Cast a value between float16 and float32 for readers that need the other dtype."""
    mismatched_uses = [use for use in _readers(value) if (use in half_inputs) is not is_half]
    if not mismatched_uses:
        return
    cast_operation = _new_cast_node(value, FLOAT if is_half else FLOAT16)
    _insert_node_after(graph, value, cast_operation)
    for node, index in mismatched_uses:
        node.replace_input_with(index, cast_operation.outputs[0])


def _convert_output(graph: ir.Graph, index: int, value: ir.Value, *, is_half: bool) -> None:
    """Cast a graph output to float16 or float32, and keep its name."""
    dtype = FLOAT16 if is_half else FLOAT
    if value.dtype == dtype:
        return
    name = value.name
    weight = graph.initializers.pop(name or "", None)
    value.name = unused_name(graph, f"{name}_{'float32' if is_half else 'float16'}")
    if weight is not None:
        graph.register_initializer(weight)
    cast_operation = _new_cast_node(value, dtype)
    cast_operation.outputs[0].name = name
    graph.append(cast_operation)
    graph.outputs[index] = cast_operation.outputs[0]


def _new_cast_node(value: ir.Value, dtype: ir.DataType) -> ir.Node:
    name = f"{value.name}_to_{'float16' if dtype == FLOAT16 else 'float32'}"
    node = ir.node("Cast", [value], attributes={"to": dtype.value}, name=name)
    output = node.outputs[0]
    output.name, output.type, output.shape = name, ir.TensorType(dtype), value.shape
    return node


def _insert_node_after(graph: ir.Graph, value: ir.Value, node: ir.Node) -> None:
    source_node = value.producer()
    if source_node is not None:
        graph.insert_after(source_node, node)
        return
    first = next(iter(graph), None)
    if first is None:
        graph.append(node)
    else:
        graph.insert_before(first, node)


class Boundary:
    """Counts the Casts between float16 and float32 nodes that a conversion would insert."""

    def __init__(self, graph: ir.Graph, opset: int) -> None:
        self._graph = graph
        constant = set(constant_nodes(graph))
        # Results of constant nodes are cast once, when a model is loaded.
        self._constants = {value for node in constant for value in node.outputs}
        self._scatter_positions = {
            node: convertible_indices(node, opset) for node in graph if node not in constant
        }

    def casts(self, keep: Collection[str]) -> int:
        """Return the number of Casts between float16 and float32 nodes, outputs not counted."""
        return sum(self._needs_float16(value, keep) for value in _values(self._graph))

    def saved_casts(self, node: ir.Node, keep: Collection[str]) -> int:
        """Return how many Casts are saved if a node is kept in float32."""
        neighbour_values = {v for v in (*node.inputs, *node.outputs) if v is not None}
        before = sum(self._needs_float16(value, keep) for value in neighbour_values)
        return before - sum(
            self._needs_float16(value, {*keep, node_key(node)}) for value in neighbour_values
        )

    def _needs_float16(self, value: ir.Value, keep: Collection[str]) -> bool:
        if not _is_float32(value) or value in self._constants:
            return False
        if value.is_initializer() and not value.is_graph_input():
            return False
        source_node, output = value.producer(), value.index()
        is_native_float16 = (
            source_node is not None and output in self._float16_indices(source_node, keep)[1]
        )
        reader_halves = {
            index in self._float16_indices(node, keep)[0] for node, index in _readers(value)
        }
        return (not is_native_float16) in reader_halves

    def _float16_indices(self, node: ir.Node, keep: Collection[str]) -> tuple[list[int], list[int]]:
        return ([], []) if node_key(node) in keep else self._scatter_positions.get(node, ([], []))
