"""Unrolls If, Loop and Scan nodes that run the same way in every frame."""

__all__ = ["UnrollControlFlow"]

from collections.abc import Callable, Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of

# Beyond these numbers, loading the graph takes longer than running the loop.
_MAX_ITERATIONS = 256
_MAX_NODES = 8192
# Since this operator set Unsqueeze takes its axes as an input.
_AXES_AS_INPUT = 13


class UnrollControlFlow(CautiousRewrite):
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

    def __init__(self, turns: int = _MAX_ITERATIONS, nodes: int = _MAX_NODES) -> None:
        super().__init__()
        self.turns, self.nodes = turns, nodes
        self.used_names: set[str | None] = set()

    def rewrite(self, model: ir.Model) -> None:
        """Unroll control flow, outer nodes first, since this may fix inner iteration counts."""
        refused: set[ir.Node] = set()
        self.used_names = _used_names(model)
        while True:
            candidates = (node for node in every_node(model) if is_op(node, *_WRITERS))
            node = next((candidate for candidate in candidates if candidate not in refused), None)
            if node is None:
                return
            plan = _WRITERS[node.op_type](node, self)
            if self.opset < _AXES_AS_INPUT:
                plan = f"operator set is {self.opset}, expected {_AXES_AS_INPUT} or later"
            if isinstance(plan, str):
                self.refuse(node, plan)
                refused.add(node)
                continue
            self.note(node)
            plan()

    def size_obstacle(self, turns: int, body: ir.Graph) -> str:
        """Return why the copies of a loop body would be too large; empty if they are not."""
        written = turns * sum(1 for _ in body.all_nodes())
        if turns > self.turns:
            return f"{turns} iterations, expected {self.turns} at most"
        if written > self.nodes:
            return f"{written} nodes would be written, expected {self.nodes} at most"
        return ""


Plan = str | Callable[[], None]


def _write_if(node: ir.Node, rewrite: UnrollControlFlow) -> Plan:
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


def _write_loop(node: ir.Node, rewrite: UnrollControlFlow) -> Plan:
    """Return a function that unrolls a Loop node, or the reason why that is impossible."""
    body = node.attributes["body"].as_graph()
    turns = _trip_count(node, body)
    if isinstance(turns, str):
        return turns
    carried = len(node.inputs) - 2
    if turns == 0 and len(node.outputs) > carried:
        return "it never runs, so its collected outputs have no shape"
    obstacle = rewrite.size_obstacle(turns, body)
    if obstacle:
        return obstacle

    def write() -> None:
        before = InsertionPoint(node)
        copy = _BodyCopier(before, body, rewrite.used_names)
        state = [_required(value) for value in node.inputs[2:]]
        lists: list[list[ir.Value]] = [[] for _ in node.outputs[carried:]]
        always = before.constant(np.asarray(True), "go_on")
        for turn in range(turns):
            number = before.constant(np.asarray(turn, np.int64), "turn")
            _, *results = copy((number, always, *state))
            state = results[:carried]
            for collected, value in zip(lists, results[carried:], strict=True):
                collected.append(value)
        before.replace(*state, *(_stack(before, collected, 0) for collected in lists))

    return write


def _trip_count(node: ir.Node, body: ir.Graph) -> int | str:
    """Return the number of iterations of a Loop node, or the reason why it is unknown."""
    trips, first = (_known_array(value) for value in node.inputs[:2])
    if node.inputs[1] is not None and first is None:
        return "its start condition differs between frames"
    if first is not None and not first.reshape(-1)[0]:
        return 0
    condition = _before_identities(body.outputs[0])
    continues = constant_of(condition)
    if continues is not None and not continues.reshape(-1)[0]:
        return 1 if trips is None else min(1, max(0, int(trips.reshape(-1)[0])))
    if continues is None and condition is not body.inputs[1]:
        return "its end depends on data that differ between frames"
    if trips is None:
        return "its trip count differs between frames"
    return max(0, int(trips.reshape(-1)[0]))


def _known_array(value: ir.Value | None) -> np.ndarray | None:
    return None if value is None else constant_of(_before_identities(value))


def _before_identities(value: ir.Value) -> ir.Value:
    """Return the graph value before any chain of Identity nodes."""
    maker = value.producer()
    while maker is not None and is_op(maker, "Identity") and maker.inputs[0] is not None:
        value = maker.inputs[0]
        maker = value.producer()
    return value


def _write_scan(node: ir.Node, rewrite: UnrollControlFlow) -> Plan:
    """Return a function that unrolls a Scan node, or the reason why that is impossible."""
    body = node.attributes["body"].as_graph()
    scanned = node.attributes["num_scan_inputs"].as_int()
    carried = len(node.inputs) - scanned
    if len(body.inputs) != len(node.inputs):
        return "it is a Scan of operator set 8, which has other inputs"
    in_axes = _int_list(node, "scan_input_axes", scanned)
    backwards = _int_list(node, "scan_input_directions", scanned)
    out_axes = _int_list(node, "scan_output_axes", len(node.outputs) - carried)
    prepended = _int_list(node, "scan_output_directions", len(node.outputs) - carried)
    sizes = {
        _axis_size(value, axis) for value, axis in zip(node.inputs[carried:], in_axes, strict=True)
    }
    if len(sizes) != 1 or None in sizes:
        return "the length of its scanned inputs is not known"
    turns = sizes.pop() or 0
    if turns == 0:
        return "it never runs, so its collected outputs have no shape"
    obstacle = rewrite.size_obstacle(turns, body)
    if obstacle:
        return obstacle

    def write() -> None:
        before = InsertionPoint(node)
        copy = _BodyCopier(before, body, rewrite.used_names)
        state = [_required(value) for value in node.inputs[:carried]]
        lists: list[list[ir.Value]] = [[] for _ in out_axes]
        for turn in range(turns):
            rows = [
                before.op(
                    "Gather",
                    value,
                    before.constant(np.asarray(turns - 1 - turn if back else turn, np.int64)),
                    axis=axis,
                )
                for value, axis, back in zip(node.inputs[carried:], in_axes, backwards, strict=True)
            ]
            results = copy((*state, *rows))
            state = results[:carried]
            for collected, value in zip(lists, results[carried:], strict=True):
                collected.append(value)
        joined = [
            _stack(before, collected[::-1] if back else collected, axis)
            for collected, axis, back in zip(lists, out_axes, prepended, strict=True)
        ]
        before.replace(*state, *joined)

    return write


def _int_list(node: ir.Node, name: str, count: int) -> list[int]:
    attribute = node.attributes.get(name)
    return [0] * count if attribute is None else [int(n) for n in attribute.as_ints()]


def _axis_size(value: ir.Value | None, axis: int) -> int | None:
    if value is None or value.shape is None:
        return None
    dim = value.shape[axis]
    return dim if isinstance(dim, int) else None


def _required(value: ir.Value | None) -> ir.Value:
    assert value is not None, "a loop's state is never left out"
    return value


_WRITERS: dict[str, Callable[[ir.Node, UnrollControlFlow], Plan]] = {
    "If": _write_if,
    "Loop": _write_loop,
    "Scan": _write_scan,
}


class _BodyCopier:
    """Copies a loop body into the surrounding graph, once per iteration."""

    def __init__(self, before: InsertionPoint, body: ir.Graph, used_names: set[str | None]) -> None:
        self.before, self.body, self.used_names = before, body, used_names
        self.stem = before.node.name or before.node.outputs[0].name or before.node.op_type
        self.turn = 0
        for value in list(body.initializers.values()):
            self._lift(value)

    def _lift(self, value: ir.Value) -> None:
        """Move a weight of a loop body to the surrounding graph, so that all copies share it."""
        outer = ir.Value(
            name=self._fresh(f"{self.stem}_{value.name}"),
            const_value=value.const_value,
            type=value.type,
            shape=value.shape,
        )
        self.before.graph.register_initializer(outer)
        ir.convenience.replace_all_uses_with(value, outer, replace_graph_outputs=True)
        del self.body.initializers[value.name or ""]

    def __call__(self, inputs: Sequence[ir.Value]) -> list[ir.Value]:
        """Insert one copy of a loop body that reads given values; return the copy's outputs."""
        copy = self.body.clone(allow_outer_scope_values=True)
        replacements = dict(zip(copy.inputs, inputs, strict=True))
        results = [replacements.get(value, value) for value in copy.outputs]
        for old, new in replacements.items():
            for user, input_index in list(old.uses()):
                user.replace_input_with(input_index, new)
        copy.outputs.clear()
        nodes = list(copy)
        copy.remove(nodes)
        for node in nodes:
            node.name = self._fresh(f"{self.stem}_{self.turn}_{node.name or node.op_type}")
            for result in node.outputs:
                if result.name:  # an omitted output has no name
                    result.name = self._fresh(f"{self.stem}_{self.turn}_{result.name}")
        self.before.graph.insert_before(self.before.node, nodes)
        self.turn += 1
        return results

    def _fresh(self, name: str) -> str:
        while name in self.used_names:
            name += "_"
        self.used_names.add(name)
        return name


def _stack(before: InsertionPoint, values: Sequence[ir.Value], axis: int) -> ir.Value:
    """Stack the results of all loop iterations along a new axis."""
    rank = rank_of(values[0])
    if axis < 0 and rank is not None:
        axis += rank + 1
    raised = [before.op("Unsqueeze", value, before.int64(axis)) for value in values]
    return raised[0] if len(raised) == 1 else before.op("Concat", *raised, axis=axis)


def _used_names(model: ir.Model) -> set[str | None]:
    graphs = (model.graph, *model.graph.subgraphs())
    names = {value.name for g in graphs for value in (*g.inputs, *g.initializers.values())}
    for node in model.graph.all_nodes():
        names.add(node.name)
        names.update(value.name for value in node.outputs)
    return names
