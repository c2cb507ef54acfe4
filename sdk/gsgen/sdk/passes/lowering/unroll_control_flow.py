"""Control flow that is the same at every frame, written out."""

__all__ = ["UnrollControlFlow"]

from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of

# Beyond these a graph takes longer to load than the loop took to run.
_MOST_TURNS = 256
_MOST_NODES = 8192
# Since this operator set Unsqueeze takes its axes as an input.
_AXES_AS_INPUT = 13


class UnrollControlFlow(CautiousRewrite):
    """Write out If, Loop and Scan whose course is known before the first frame.

    One control-flow node makes a WebGPU provider refuse graph capture for the whole model, and
    most of them only count joints, bands or steps::

        If(true)               →   the branch
        Loop(24, true, x₀)     →   body(0, x₀) → body(1, x₁) → … → body(23, x₂₃)
        Scan over 24 rows      →   body(x₀, row 0) → body(x₁, row 1) → …

    A Loop must have a trip count that is known, and go on by a condition that is constantly true
    (or end at once by one that is false). Results that a body gives at each turn are joined by one
    Concat. At most 256 turns and 8,192 nodes are written; what is larger stays, and so does what
    data decides.
    """

    name: ClassVar[str] = "unroll-control-flow"
    wanted_by: ClassVar[str] = "targets that capture graphs"

    def __init__(self, turns: int = _MOST_TURNS, nodes: int = _MOST_NODES) -> None:
        super().__init__()
        self.turns, self.nodes = turns, nodes
        self.taken: set[str | None] = set()

    def rewrite(self, model: ir.Model) -> None:
        """Write out outer nodes first: what counts the inner ones may then be known."""
        left: set[ir.Node] = set()
        self.taken = _names(model)
        while True:
            found = (node for node in every_node(model) if is_op(node, *_WRITERS))
            node = next((one for one in found if one not in left), None)
            if node is None:
                return
            plan = _WRITERS[node.op_type](node, self)
            if self.opset < _AXES_AS_INPUT:
                plan = f"operator set {self.opset}, wanted {_AXES_AS_INPUT} or later"
            if isinstance(plan, str):
                self.refuse(node, plan)
                left.add(node)
                continue
            self.note(node)
            plan()

    def too_large(self, turns: int, body: ir.Graph) -> str:
        """Say by how much ``turns`` copies of ``body`` are too many; nothing if they are not."""
        written = turns * sum(1 for _ in body.all_nodes())
        if turns > self.turns:
            return f"{turns} turns, wanted {self.turns} at most"
        if written > self.nodes:
            return f"{written} nodes would be written, wanted {self.nodes} at most"
        return ""


Plan = str | Callable[[], None]


def _write_if(node: ir.Node, rewrite: UnrollControlFlow) -> Plan:
    known = _known(node.inputs[0])
    if known is None:
        return "its condition varies"
    branch = "then_branch" if known.reshape(-1)[0] else "else_branch"

    def write() -> None:
        before = InsertionPoint(node)
        copy = _Body(before, node.attributes[branch].as_graph(), rewrite.taken)
        before.replace(*copy(()))

    return write


def _write_loop(node: ir.Node, rewrite: UnrollControlFlow) -> Plan:
    body = node.attributes["body"].as_graph()
    turns = _turns_of_loop(node, body)
    if isinstance(turns, str):
        return turns
    carried = len(node.inputs) - 2
    if turns == 0 and len(node.outputs) > carried:
        return "it never runs, so what it would collect has no shape"
    large = rewrite.too_large(turns, body)
    if large:
        return large

    def write() -> None:
        before = InsertionPoint(node)
        copy = _Body(before, body, rewrite.taken)
        state = [_given(value) for value in node.inputs[2:]]
        lists: list[list[ir.Value]] = [[] for _ in node.outputs[carried:]]
        always = before.constant(np.asarray(True), "go_on")
        for turn in range(turns):
            number = before.constant(np.asarray(turn, np.int64), "turn")
            _, *made = copy((number, always, *state))
            state = made[:carried]
            for kept, value in zip(lists, made[carried:], strict=True):
                kept.append(value)
        before.replace(*state, *(_stacked(before, kept, 0) for kept in lists))

    return write


def _turns_of_loop(node: ir.Node, body: ir.Graph) -> int | str:
    """Return how often a Loop runs, or what keeps that from being known."""
    trips, first = (_known(value) for value in node.inputs[:2])
    if node.inputs[1] is not None and first is None:
        return "whether it starts varies"
    if first is not None and not first.reshape(-1)[0]:
        return 0
    goes_on = _source(body.outputs[0])
    again = constant_of(goes_on)
    if again is not None and not again.reshape(-1)[0]:
        return 1 if trips is None else min(1, max(0, int(trips.reshape(-1)[0])))
    if again is None and goes_on is not body.inputs[1]:
        return "data decides when it ends"
    if trips is None:
        return "its trip count varies"
    return max(0, int(trips.reshape(-1)[0]))


def _known(value: ir.Value | None) -> np.ndarray | None:
    return None if value is None else constant_of(_source(value))


def _source(value: ir.Value) -> ir.Value:
    """Return the value that ``value`` is, whatever it was called in between."""
    maker = value.producer()
    while maker is not None and is_op(maker, "Identity") and maker.inputs[0] is not None:
        value = maker.inputs[0]
        maker = value.producer()
    return value


def _write_scan(node: ir.Node, rewrite: UnrollControlFlow) -> Plan:
    body = node.attributes["body"].as_graph()
    scanned = node.attributes["num_scan_inputs"].as_int()
    carried = len(node.inputs) - scanned
    if len(body.inputs) != len(node.inputs):
        return "it is a Scan of operator set 8"
    in_axes = _numbers(node, "scan_input_axes", scanned)
    backwards = _numbers(node, "scan_input_directions", scanned)
    out_axes = _numbers(node, "scan_output_axes", len(node.outputs) - carried)
    prepended = _numbers(node, "scan_output_directions", len(node.outputs) - carried)
    sizes = {
        _size(value, axis)
        for value, axis in zip(node.inputs[carried:], in_axes, strict=True)
    }
    if len(sizes) != 1 or None in sizes:
        return "the length of what it scans is not known"
    turns = sizes.pop() or 0
    if turns == 0:
        return "it never runs, so what it would collect has no shape"
    large = rewrite.too_large(turns, body)
    if large:
        return large

    def write() -> None:
        before = InsertionPoint(node)
        copy = _Body(before, body, rewrite.taken)
        state = [_given(value) for value in node.inputs[:carried]]
        lists: list[list[ir.Value]] = [[] for _ in out_axes]
        for turn in range(turns):
            rows = [
                before.op(
                    "Gather",
                    value,
                    before.constant(
                        np.asarray(turns - 1 - turn if back else turn, np.int64)
                    ),
                    axis=axis,
                )
                for value, axis, back in zip(
                    node.inputs[carried:], in_axes, backwards, strict=True
                )
            ]
            made = copy((*state, *rows))
            state = made[:carried]
            for kept, value in zip(lists, made[carried:], strict=True):
                kept.append(value)
        joined = [
            _stacked(before, kept[::-1] if back else kept, axis)
            for kept, axis, back in zip(lists, out_axes, prepended, strict=True)
        ]
        before.replace(*state, *joined)

    return write


def _numbers(node: ir.Node, name: str, count: int) -> list[int]:
    attribute = node.attributes.get(name)
    return [0] * count if attribute is None else [int(n) for n in attribute.as_ints()]


def _size(value: ir.Value | None, axis: int) -> int | None:
    if value is None or value.shape is None:
        return None
    dim = value.shape[axis]
    return dim if isinstance(dim, int) else None


def _given(value: ir.Value | None) -> ir.Value:
    assert value is not None, "a loop's state is never left out"
    return value


_WRITERS: dict[str, Callable[[ir.Node, UnrollControlFlow], Plan]] = {
    "If": _write_if,
    "Loop": _write_loop,
    "Scan": _write_scan,
}


class _Body:
    """A body that is copied into the graph around it, once a turn."""

    def __init__(
        self, before: InsertionPoint, body: ir.Graph, taken: set[str | None]
    ) -> None:
        self.before, self.body, self.taken = before, body, taken
        self.stem = before.node.name or before.node.outputs[0].name or before.node.op_type
        self.turn = 0
        for value in list(body.initializers.values()):
            self._lift(value)

    def _lift(self, value: ir.Value) -> None:
        """Make a weight of the body one of the graph around it, so that its copies share it."""
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
        """Insert the nodes once more, run on ``inputs``; return what they give."""
        copy = self.body.clone(allow_outer_scope_values=True)
        stands = dict(zip(copy.inputs, inputs, strict=True))
        results = [stands.get(value, value) for value in copy.outputs]
        for old, new in stands.items():
            for user, place in list(old.uses()):
                user.replace_input_with(place, new)
        copy.outputs.clear()
        nodes = list(copy)
        copy.remove(nodes)
        for node in nodes:
            node.name = self._fresh(f"{self.stem}_{self.turn}_{node.name or node.op_type}")
            for made in node.outputs:
                if made.name:  # a result that is left out has none
                    made.name = self._fresh(f"{self.stem}_{self.turn}_{made.name}")
        self.before.graph.insert_before(self.before.node, nodes)
        self.turn += 1
        return results

    def _fresh(self, name: str) -> str:
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        return name


def _stacked(before: InsertionPoint, values: Sequence[ir.Value], axis: int) -> ir.Value:
    """Join what the turns gave along a new axis."""
    rank = rank_of(values[0])
    if axis < 0 and rank is not None:
        axis += rank + 1
    raised = [before.op("Unsqueeze", value, before.whole(axis)) for value in values]
    return raised[0] if len(raised) == 1 else before.op("Concat", *raised, axis=axis)


def _names(model: ir.Model) -> set[str | None]:
    graphs = (model.graph, *model.graph.subgraphs())
    taken = {value.name for g in graphs for value in (*g.inputs, *g.initializers.values())}
    for node in model.graph.all_nodes():
        taken.add(node.name)
        taken.update(value.name for value in node.outputs)
    return taken
