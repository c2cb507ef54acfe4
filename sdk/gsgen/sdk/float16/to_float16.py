"""Computing in float16, but for nodes that must not."""

__all__ = ["FLOAT", "HALF", "Boundary", "ToFloat16", "halves", "key_of", "places_of"]

from collections.abc import Collection, Iterator
from typing import ClassVar

import numpy as np
import onnx
import onnx_ir as ir

from gsgen.sdk.float16.weight_tables import HalfTable, half_table
from gsgen.sdk.passes.framework.base import (
    MAIN_DOMAIN,
    ErrorBudget,
    RewriteTarget,
    is_op,
    opset_of,
)
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import free_name, new_node, weight
from gsgen.sdk.rewriting.constant_subgraph import constant_nodes

FLOAT, HALF = ir.DataType.FLOAT, ir.DataType.FLOAT16
_ALLOWED = "tensor(float16)"
# These read no numbers, so no Cast need stand before them.
_INDIFFERENT = ("Shape", "Size")


class ToFloat16(CautiousRewrite):
    """Compute in float16 wherever the operator allows it and ``keep`` does not name it.

    Weights and tensors are half as large, and many devices compute twice as fast. Inputs of a frame
    stay float32. Where a float16 node meets a float32 one, one Cast stands, shared by all that read
    it. A table that ``stored`` names is held in 16 bits a number whatever reads it: as float16, or as
    uint16 in even steps where that is closer (:mod:`gsgen.sdk.float16.weight_tables`), with a Cast, a Mul and an
    Add that runtimes compute once; as float16 in any case where ``plain`` names it, too. Another weight that both read is held twice::

        x → Mul → Add → y    →    x → Cast → Mul → Add → y float16

    Which nodes are kept is measured by :mod:`gsgen.sdk.float16.convert_model`; run alone, this pass changes
    values as far as float16 rounds, and overflows beyond 65,504. Bodies of If, Loop and Scan stay
    float32, as do operators that know no float16, and what follows from weights alone, which is
    computed once.
    """

    name: ClassVar[str] = "to-float16"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=1e-2)
    wanted_by: ClassVar[str] = "whoever asks for it: `gsgen float16`"

    def __init__(
        self,
        keep: Collection[str] = (),
        *,
        outputs: bool = True,
        stored: Collection[str] = (),
        plain: Collection[str] = (),
    ) -> None:
        super().__init__()
        self.keep, self.outputs = frozenset(keep), outputs
        self.stored, self.plain = frozenset(stored), frozenset(plain)

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> None:
        """Return nothing: no target asks for it, and which nodes to keep is to be measured."""
        return

    def rewrite(self, model: ir.Model) -> None:
        """Convert nodes, weights and outputs, and put Casts between."""
        graph, opset = model.graph, opset_of(model)
        once = set(constant_nodes(graph))
        chosen = [
            node
            for node in graph
            if node not in once and key_of(node) not in self.keep and halves(node, opset)
        ]
        wants = {(node, place) for node in chosen for place in places_of(node, opset)[0]}
        native = {
            node.outputs[place] for node in chosen for place in places_of(node, opset)[1]
        }
        ends = {value for value in graph.outputs if self.outputs and value.dtype == FLOAT}
        for node in chosen:
            self.note(node)
            if is_op(node, "Cast") and node.outputs[0] in native:
                node.attributes["to"] = ir.AttrInt64("to", HALF.value)
        for value in list(_values(graph)):
            if value.dtype != FLOAT:
                continue
            if value in native:
                value.type = ir.TensorType(HALF)
            if value.is_initializer() and not value.is_graph_input():
                stored, in_steps = value.name in self.stored, value.name not in self.plain
                _convert_weight(graph, value, wants, stored=stored, in_steps=in_steps)
            else:
                _convert_value(graph, value, wants, is_half=value in native)
        for index, value in enumerate(list(graph.outputs)):
            if value.is_graph_input() and value in ends:
                self.refuse(value, "it is an input, too, and inputs stay float32")
            elif value in ends or value in native:
                _convert_output(graph, index, value, is_half=value in ends)


def key_of(node: ir.Node) -> str:
    """Return what a list of nodes to keep calls ``node``: the name of its first result."""
    return next((value.name for value in node.outputs if value.name), node.name or "")


def halves(node: ir.Node, opset: int) -> bool:
    """Say whether ``node`` can compute in float16 where it computes in float32 now."""
    inputs, outputs = places_of(node, opset)
    return bool(inputs or outputs)


def places_of(node: ir.Node, opset: int) -> tuple[list[int], list[int]]:
    """Return which inputs and outputs of ``node`` may turn from float32 to float16.

    None may, if one that must turn along does not allow it.
    """
    schema = _schema(node, opset)
    if schema is None or is_op(node, *_INDIFFERENT):
        return [], []
    given = _floats(node.inputs, schema.inputs)
    made = _floats(node.outputs, schema.outputs)
    # An output of a type of its own, which no input decides, is decided by an attribute.
    free = {formal.type_str for _, formal in made} - {
        formal.type_str for _, formal in given
    }
    if free and not is_op(node, "Cast"):
        return [], []
    stiff = {
        formal.type_str for _, formal in (*given, *made) if _ALLOWED not in formal.types
    }
    variables = {constraint.type_param_str for constraint in schema.type_constraints}
    if stiff & variables:
        return [], []
    return tuple(  # type: ignore[return-value]
        [place for place, formal in part if formal.type_str not in stiff]
        for part in (given, made)
    )


def _schema(node: ir.Node, opset: int) -> onnx.defs.OpSchema | None:
    bodies = any(
        a.type in (ir.AttributeType.GRAPH, ir.AttributeType.GRAPHS)
        for a in node.attributes.values()
    )
    if node.domain not in MAIN_DOMAIN or bodies or "dtype" in node.attributes:
        return None
    try:
        return onnx.defs.get_schema(node.op_type, opset)
    except onnx.defs.SchemaError:
        return None


def _floats(
    values: Collection[ir.Value | None],
    formals: Collection["onnx.defs.OpSchema.FormalParameter"],
) -> list[tuple[int, "onnx.defs.OpSchema.FormalParameter"]]:
    listed = list(formals)  # the last one may stand for many
    return [
        (place, listed[min(place, len(listed) - 1)])
        for place, value in enumerate(values)
        if value is not None and value.dtype == FLOAT
    ]


def _values(graph: ir.Graph) -> Iterator[ir.Value]:
    yield from graph.inputs
    yield from (
        value for value in graph.initializers.values() if not value.is_graph_input()
    )
    yield from (value for node in graph for value in node.outputs)


Wants = set[tuple[ir.Node, int]]


def _readers(value: ir.Value) -> list[tuple[ir.Node, int]]:
    return [(node, place) for node, place in value.uses() if not is_op(node, *_INDIFFERENT)]


def _convert_weight(
    graph: ir.Graph, value: ir.Value, wants: Wants, *, stored: bool, in_steps: bool
) -> None:
    readers = _readers(value)
    half = [use for use in readers if use in wants]
    if not (half or stored) or value.const_value is None:
        return
    array = value.const_value.numpy()
    full = [use for use in readers if use not in wants]
    if full and stored and not value.is_graph_output():
        _store(graph, value, half_table(array, in_steps=in_steps), wants)
        return
    with np.errstate(over="ignore"):
        array = array.astype(np.float16)
    if value.is_graph_output() or full:
        copy = weight(graph, f"{value.name}_float16", array)
        for node, place in half:
            node.replace_input_with(place, copy)
        return
    value.const_value = ir.tensor(array, name=value.name)
    value.type = ir.TensorType(HALF)


def _store(graph: ir.Graph, value: ir.Value, table: HalfTable, wants: Wants) -> None:
    """Hold a weight as ``table``, for readers in either dtype."""
    value.const_value = ir.tensor(table.numbers, name=value.name)
    value.type = ir.TensorType(value.const_value.dtype)
    if table.step is None or table.start is None:
        _convert_value(graph, value, wants, is_half=True)
        return
    readers = _readers(value)
    numbers = _cast(value, FLOAT)
    name = f"{value.name}_scaled"
    step = weight(graph, f"{value.name}_step", table.step)
    start = weight(graph, f"{value.name}_start", table.start)
    scaled = new_node(
        "Mul", [numbers.outputs[0], step], name, dtype=FLOAT, shape=value.shape
    )
    name = f"{value.name}_moved"
    moved = new_node(
        "Add", [scaled.outputs[0], start], name, dtype=FLOAT, shape=value.shape
    )
    for node in (moved, scaled, numbers):
        _insert_behind(graph, value, node)
    for node, place in readers:
        node.replace_input_with(place, moved.outputs[0])
    _convert_value(graph, moved.outputs[0], wants, is_half=False)


def _convert_value(
    graph: ir.Graph, value: ir.Value, wants: Wants, *, is_half: bool
) -> None:
    """Put a Cast behind ``value`` for those that read it in the other dtype."""
    others = [use for use in _readers(value) if (use in wants) is not is_half]
    if not others:
        return
    cast = _cast(value, FLOAT if is_half else HALF)
    _insert_behind(graph, value, cast)
    for node, place in others:
        node.replace_input_with(place, cast.outputs[0])


def _convert_output(graph: ir.Graph, index: int, value: ir.Value, *, is_half: bool) -> None:
    """Give an output the dtype it is to have, under its name."""
    wanted = HALF if is_half else FLOAT
    if value.dtype == wanted:
        return
    name = value.name
    weight = graph.initializers.pop(name or "", None)
    value.name = free_name(graph, f"{name}_{'float32' if is_half else 'float16'}")
    if weight is not None:
        graph.register_initializer(weight)
    cast = _cast(value, wanted)
    cast.outputs[0].name = name
    graph.append(cast)
    graph.outputs[index] = cast.outputs[0]


def _cast(value: ir.Value, dtype: ir.DataType) -> ir.Node:
    name = f"{value.name}_to_{'float16' if dtype == HALF else 'float32'}"
    node = ir.node("Cast", [value], attributes={"to": dtype.value}, name=name)
    made = node.outputs[0]
    made.name, made.type, made.shape = name, ir.TensorType(dtype), value.shape
    return node


def _insert_behind(graph: ir.Graph, value: ir.Value, node: ir.Node) -> None:
    maker = value.producer()
    if maker is not None:
        graph.insert_after(maker, node)
        return
    first = next(iter(graph), None)
    if first is None:
        graph.append(node)
    else:
        graph.insert_before(first, node)


class Boundary:
    """Counts the Casts that :class:`ToFloat16` would write for a list of nodes to keep."""

    def __init__(self, graph: ir.Graph, opset: int) -> None:
        self._graph = graph
        constant = set(constant_nodes(graph))
        # What follows from weights is cast once, when a model is loaded.
        self._constants = {value for node in constant for value in node.outputs}
        self._places = {
            node: places_of(node, opset) for node in graph if node not in constant
        }

    def casts(self, keep: Collection[str]) -> int:
        """Return how many Casts stand between, those of outputs left out."""
        return sum(self._needs(value, keep) for value in _values(self._graph))

    def saved(self, node: ir.Node, keep: Collection[str]) -> int:
        """Return how many Casts fewer there are if ``node`` is kept, too."""
        near = {v for v in (*node.inputs, *node.outputs) if v is not None}
        before = sum(self._needs(value, keep) for value in near)
        return before - sum(self._needs(value, {*keep, key_of(node)}) for value in near)

    def _needs(self, value: ir.Value, keep: Collection[str]) -> bool:
        if value.dtype != FLOAT or value in self._constants:
            return False
        if value.is_initializer() and not value.is_graph_input():
            return False
        maker, output = value.producer(), value.index()
        native = maker is not None and output in self._halved(maker, keep)[1]
        wants = {place in self._halved(node, keep)[0] for node, place in _readers(value)}
        return (not native) in wants

    def _halved(self, node: ir.Node, keep: Collection[str]) -> tuple[list[int], list[int]]:
        return ([], []) if key_of(node) in keep else self._places.get(node, ([], []))
