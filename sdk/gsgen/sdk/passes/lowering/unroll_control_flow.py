"""Unrolls If, Loop and Scan nodes that run the same way in every frame."""

__all__ = ["UnrollControlFlow"]

from collections.abc import Callable, Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of

# Beyond these numbers, loading the graph takes longer than running the loop.
_MAX_ITERATIONS = 256
_MAX_NODES = 8192
# Since this operator set Unsqueeze takes its axes as an input.
_AXES_AS_INPUT = 13


class UnrollControlFlow(SkippableRewrite):
    """Unroll If, Loop and Scan nodes whose branches and iteration counts do not depend on inputs.

    One control-flow node makes a WebGPU provider refuse graph capture for the whole model, and
    most of them only count joints, bands or steps::

        1  If(true)             →   the branch
        2  Loop(24, true, x₀)   →   body(0, x₀) → body(1, x₁) → … → body(23, x₂₃)
        3  Scan over 24 rows    →   body(x₀, row 0) → body(x₁, row 1) → …

    A Loop needs a known trip count and a condition that is always true (or false, which ends it
    after one iteration). One Concat joins the results of all iterations. The limits are 256
    iterations and 8,192 nodes; larger and data-dependent nodes stay as they are.
    """

    name = "unroll-control-flow"
    wanted_by = "targets that capture graphs"

    def __init__(self, iterations: int = _MAX_ITERATIONS, nodes: int = _MAX_NODES) -> None:
        super().__init__()
        self.iterations, self.nodes = iterations, nodes
        self.used_names: set[str | None] = set()

    def rewrite(self, model: ir.Model) -> None:
        """Unroll control flow, outer nodes first, since this may fix inner iteration counts."""
        refused_nodes: set[ir.Node] = set()
        self.used_names = _used_names(model)
        while True:
            candidates = (node for node in every_node(model) if is_op(node, *_UNROLLER_BY_OPERATOR))
            node = next(
                (candidate for candidate in candidates if candidate not in refused_nodes), None
            )
            if node is None:
                return
            plan = _UNROLLER_BY_OPERATOR[node.op_type](node, self)
            if self.opset < _AXES_AS_INPUT:
                plan = f"operator set is {self.opset}, expected {_AXES_AS_INPUT} or later"
            if isinstance(plan, str):
                self.refuse(node, plan)
                refused_nodes.add(node)
                continue
            self.note(node)
            plan()

    def size_obstacle(self, iterations: int, body: ir.Graph) -> str:
        """Return why the copies of a loop body would be too large; empty if they are not."""
        written_nodes = iterations * sum(1 for _ in body.all_nodes())
        if iterations > self.iterations:
            return f"{iterations} iterations, expected {self.iterations} at most"
        if written_nodes > self.nodes:
            return f"{written_nodes} nodes would be written, expected {self.nodes} at most"
        return ""


UnrollPlan = str | Callable[[], None]


def _unroll_if_node(node: ir.Node, rewrite: UnrollControlFlow) -> UnrollPlan:
    """Return a function that inserts the taken branch of an If node, or why that is impossible."""
    known = _known_array(node.inputs[0])
    if known is None:
        return "its condition differs between frames"
    branch = "then_branch" if known.reshape(-1)[0] else "else_branch"

    def write() -> None:
        before = InsertionPoint(node)
        copy = _BodyCopier(before, node.attributes[branch].as_graph(), rewrite.used_names)
        before.replace(*copy(()))

    return write


def _unroll_loop_node(node: ir.Node, rewrite: UnrollControlFlow) -> UnrollPlan:
    """Return a function that unrolls a Loop node, or the reason why that is impossible."""
    body = node.attributes["body"].as_graph()
    iterations = _trip_count(node, body)
    if isinstance(iterations, str):
        return iterations
    carried_value_count = len(node.inputs) - 2
    if iterations == 0 and len(node.outputs) > carried_value_count:
        return "it never runs, so its collected outputs have no shape"
    obstacle = rewrite.size_obstacle(iterations, body)
    if obstacle:
        return obstacle

    def write() -> None:
        before = InsertionPoint(node)
        copy = _BodyCopier(before, body, rewrite.used_names)
        state = [_require_value(value) for value in node.inputs[2:]]
        stacked_results: list[list[ir.Value]] = [[] for _ in node.outputs[carried_value_count:]]
        true_condition = before.constant(np.asarray(True), "go_on")
        for turn in range(iterations):
            number = before.constant(np.asarray(turn, np.int64), "turn")
            _, *results = copy((number, true_condition, *state))
            state = results[:carried_value_count]
            for results_list, value in zip(
                stacked_results, results[carried_value_count:], strict=True
            ):
                results_list.append(value)
        before.replace(
            *state, *(_stack_values(before, results_list, 0) for results_list in stacked_results)
        )

    return write


def _trip_count(node: ir.Node, body: ir.Graph) -> int | str:
    """Return the number of iterations of a Loop node, or the reason why it is unknown."""
    trip_count, first = (_known_array(value) for value in node.inputs[:2])
    if node.inputs[1] is not None and first is None:
        return "its start condition differs between frames"
    if first is not None and not first.reshape(-1)[0]:
        return 0
    condition = _skip_identities(body.outputs[0])
    loop_condition = constant_of(condition)
    if loop_condition is not None and not loop_condition.reshape(-1)[0]:
        return 1 if trip_count is None else min(1, max(0, int(trip_count.reshape(-1)[0])))
    if loop_condition is None and condition is not body.inputs[1]:
        return "its end depends on data that differ between frames"
    if trip_count is None:
        return "its trip count differs between frames"
    return max(0, int(trip_count.reshape(-1)[0]))


def _known_array(value: ir.Value | None) -> np.ndarray | None:
    return None if value is None else constant_of(_skip_identities(value))


def _skip_identities(value: ir.Value) -> ir.Value:
    """Return the graph value before any chain of Identity nodes."""
    producer_node = value.producer()
    while (
        producer_node is not None
        and is_op(producer_node, "Identity")
        and producer_node.inputs[0] is not None
    ):
        value = producer_node.inputs[0]
        producer_node = value.producer()
    return value


def _unroll_scan_node(node: ir.Node, rewrite: UnrollControlFlow) -> UnrollPlan:
    """Return a function that unrolls a Scan node, or the reason why that is impossible."""
    body = node.attributes["body"].as_graph()
    scanned_count = node.attributes["num_scan_inputs"].as_int()
    carried_value_count = len(node.inputs) - scanned_count
    if len(body.inputs) != len(node.inputs):
        return "it is a Scan of operator set 8, which has other inputs"
    scan_input_axes = _int_list(node, "scan_input_axes", scanned_count)
    backward_flags = _int_list(node, "scan_input_directions", scanned_count)
    scan_output_axes = _int_list(node, "scan_output_axes", len(node.outputs) - carried_value_count)
    prepended_flags = _int_list(
        node, "scan_output_directions", len(node.outputs) - carried_value_count
    )
    sizes = {
        _axis_size(value, axis)
        for value, axis in zip(node.inputs[carried_value_count:], scan_input_axes, strict=True)
    }
    if len(sizes) != 1 or None in sizes:
        return "the length of its scanned inputs is not known"
    iterations = sizes.pop() or 0
    if iterations == 0:
        return "it never runs, so its collected outputs have no shape"
    obstacle = rewrite.size_obstacle(iterations, body)
    if obstacle:
        return obstacle

    def write() -> None:
        before = InsertionPoint(node)
        copy = _BodyCopier(before, body, rewrite.used_names)
        state = [_require_value(value) for value in node.inputs[:carried_value_count]]
        stacked_results: list[list[ir.Value]] = [[] for _ in scan_output_axes]
        for turn in range(iterations):
            rows = [
                before.op(
                    "Gather",
                    value,
                    before.constant(
                        np.asarray(iterations - 1 - turn if is_backward_scan else turn, np.int64)
                    ),
                    axis=axis,
                )
                for value, axis, is_backward_scan in zip(
                    node.inputs[carried_value_count:], scan_input_axes, backward_flags, strict=True
                )
            ]
            results = copy((*state, *rows))
            state = results[:carried_value_count]
            for results_list, value in zip(
                stacked_results, results[carried_value_count:], strict=True
            ):
                results_list.append(value)
        joined_values = [
            _stack_values(before, results_list[::-1] if is_backward_scan else results_list, axis)
            for results_list, axis, is_backward_scan in zip(
                stacked_results, scan_output_axes, prepended_flags, strict=True
            )
        ]
        before.replace(*state, *joined_values)

    return write


def _int_list(node: ir.Node, name: str, count: int) -> list[int]:
    attribute = node.attributes.get(name)
    return [0] * count if attribute is None else [int(n) for n in attribute.as_ints()]


def _axis_size(value: ir.Value | None, axis: int) -> int | None:
    if value is None or value.shape is None:
        return None
    dim = value.shape[axis]
    return dim if isinstance(dim, int) else None


def _require_value(value: ir.Value | None) -> ir.Value:
    assert value is not None, "a loop's state is never left out"
    return value


_UNROLLER_BY_OPERATOR: dict[str, Callable[[ir.Node, UnrollControlFlow], UnrollPlan]] = {
    "If": _unroll_if_node,
    "Loop": _unroll_loop_node,
    "Scan": _unroll_scan_node,
}


class _BodyCopier:
    """Copies a loop body into the surrounding graph, once per iteration."""

    def __init__(self, before: InsertionPoint, body: ir.Graph, used_names: set[str | None]) -> None:
        self.before, self.body, self.used_names = before, body, used_names
        self.stem = before.node.name or before.node.outputs[0].name or before.node.op_type
        self.turn = 0
        for value in list(body.initializers.values()):
            self._lift_value_to_outer_graph(value)

    def _lift_value_to_outer_graph(self, value: ir.Value) -> None:
        """Move a weight of a loop body to the surrounding graph, so that all copies share it."""
        outer_value = ir.Value(
            name=self._new_name(f"{self.stem}_{value.name}"),
            const_value=value.const_value,
            type=value.type,
            shape=value.shape,
        )
        self.before.graph.register_initializer(outer_value)
        ir.convenience.replace_all_uses_with(value, outer_value, replace_graph_outputs=True)
        del self.body.initializers[value.name or ""]

    def __call__(self, inputs: Sequence[ir.Value]) -> list[ir.Value]:
        """Insert one copy of a loop body that reads given values; return the copy's outputs."""
        copy = self.body.clone(allow_outer_scope_values=True)
        replacements = dict(zip(copy.inputs, inputs, strict=True))
        results = [replacements.get(value, value) for value in copy.outputs]
        for old, new in replacements.items():
            for user_node, input_index in list(old.uses()):
                user_node.replace_input_with(input_index, new)
        copy.outputs.clear()
        nodes = list(copy)
        copy.remove(nodes)
        for node in nodes:
            node.name = self._new_name(f"{self.stem}_{self.turn}_{node.name or node.op_type}")
            for result in node.outputs:
                if result.name:  # an omitted output has no name
                    result.name = self._new_name(f"{self.stem}_{self.turn}_{result.name}")
        self.before.graph.insert_before(self.before.node, nodes)
        self.turn += 1
        return results

    def _new_name(self, name: str) -> str:
        while name in self.used_names:
            name += "_"
        self.used_names.add(name)
        return name


def _stack_values(before: InsertionPoint, values: Sequence[ir.Value], axis: int) -> ir.Value:
    """Stack the results of all loop iterations along a new axis."""
    rank = rank_of(values[0])
    if axis < 0 and rank is not None:
        axis += rank + 1
    unsqueezed_values = [before.op("Unsqueeze", value, before.int64(axis)) for value in values]
    return (
        unsqueezed_values[0]
        if len(unsqueezed_values) == 1
        else before.op("Concat", *unsqueezed_values, axis=axis)
    )


def _used_names(model: ir.Model) -> set[str | None]:
    graphs = (model.graph, *model.graph.subgraphs())
    names = {value.name for g in graphs for value in (*g.inputs, *g.initializers.values())}
    for node in model.graph.all_nodes():
        names.add(node.name)
        names.update(value.name for value in node.outputs)
    return names
