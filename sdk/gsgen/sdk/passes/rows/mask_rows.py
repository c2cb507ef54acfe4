"""Boolean indexing with a shape that is known before the frame."""

__all__ = ["MaskRows"]

from collections.abc import Sequence
from typing import ClassVar

import onnx_ir as ir
from onnx_ir.passes.common import RemoveUnusedNodesPass

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.passes.framework.base import ErrorBudget, RewriteTarget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import append_output, remake
from gsgen.sdk.passes.framework.value_facts import fixed_shape
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import (
    Blocked,
    Fact,
    Filler,
    Index,
    Linear,
    Mask,
    Rows,
    read_mask,
)
from gsgen.sdk.passes.rows.row_indices import (
    compressed,
    index_of,
    moved_index,
    nested_mask,
    taken_again,
    taken_rows,
)
from gsgen.sdk.passes.rows.row_numbers import count_of, filled, linear, shape_fact
from gsgen.sdk.passes.rows.row_operators import moved_rows, split_rows
from gsgen.sdk.passes.rows.row_reductions import padded, reduced, scattered

_READS_NUMBERS = (
    "Add",
    "Cast",
    "Div",
    "Mul",
    "Sub",
    "Where",
    "Equal",
    "Less",
    "Greater",
    "Min",
    "Max",
)


class MaskRows(CautiousRewrite):
    """Compute all rows instead of those that a mask keeps, and bring these to the front at the end.

    NonZero and Compress give as many rows as values say, so they run on the CPU, and graph capture
    is refused for the whole model. Operators that treat each row by itself may as well treat all::

        x[mask] → f → y [K, 10]     →   x → f → Gather(order) → Where(row < K) → y [N, 10]
        x[mask] = f(x[mask])        →   Where(mask, f(x), x)
        cat(x[mask], zeros(C − K))  →   as above, C rows, the same in every bit
        sum(x[mask])                →   sum(Where(mask, x, 0))

    The order comes from the mask's prefix sum (CumSum) by binary search; K is its last element.
    An output of K rows becomes one of N rows, whose first K are the same and whose others are zero.
    By the contract that is the same model, as long as ``num_points`` is K; so it is done only where
    some output is provably K (and ``num_points``, where the manifest names it, is that one).

    Products and sums of N rows may round otherwise than those of K; nothing else changes a bit.

    A mask is left alone if a node on the way might mix rows or shapes (a running sum, a second
    mask, an index computed from rows): then nothing that hangs on it is touched.
    """

    name: ClassVar[str] = "mask-rows"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=2e-6, pads=True)
    wanted_by: ClassVar[str] = "targets that capture graphs"

    def __init__(self, count: str | None = None) -> None:
        super().__init__()
        self.count = count

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> "MaskRows":
        """Return the pass; the manifest says which output is the count."""
        declared = goal.manifest
        known = declared.outputs.count if isinstance(declared, GeneratorManifest) else None
        return cls(known.name if known is not None else None)

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite all masks that can be; those that cannot are left out one after the other."""
        left: frozenset[Mask] = frozenset()
        while True:
            attempt = _Attempt(model.graph, left, self.count)
            try:
                outputs = attempt.run()
            except Blocked as blocked:
                attempt.draft.discard()
                self.refuse(blocked.node, blocked.why)
                left |= {outer for mask in blocked.masks for outer in mask.chain}
                continue
            break
        if not attempt.born:
            attempt.draft.discard()
            return
        for node in attempt.born:
            self.note(node)
        attempt.finish(outputs)
        RemoveUnusedNodesPass()(model)


class _Attempt:
    """One walk through a graph, with the masks in ``left`` left out."""

    def __init__(self, graph: ir.Graph, left: frozenset[Mask], count: str | None) -> None:
        self.graph, self.left, self.count = graph, left, count
        self.draft = RowDraft("masked_rows")
        self.facts: dict[ir.Value, Fact] = {}
        self.born: list[ir.Node] = []

    def run(self) -> list[ir.Value | None]:
        """Draft everything; return what takes the place of each output, None where it stays.

        Raises:
            Blocked: A node mixes rows, or its shape would still vary.
        """
        for node in self.graph:
            self._refuse_bodies(node)
            self.draft.anchor = node
            self._visit(node)
        self.draft.anchor = None
        return self._outputs()

    def finish(self, outputs: Sequence[ir.Value | None]) -> None:
        """Put the draft into the graph."""
        for node, place, value in self.draft.fed:
            node.replace_input_with(place, value)
        self.draft.join(self.graph)
        for old, made in self.draft.results.items():
            remake(old, made)
        for old, new in zip(list(self.graph.outputs), outputs, strict=True):
            if new is not None:
                maker = new.producer()
                assert maker is not None
                self.graph.remove(maker)
                append_output(self.graph, old, [maker])

    def _refuse_bodies(self, node: ir.Node) -> None:
        for attribute in node.attributes.values():
            if attribute.type != ir.AttributeType.GRAPH:
                continue
            for inner in attribute.as_graph().all_nodes():
                facts = [
                    self.facts.get(value) for value in inner.inputs if value is not None
                ]
                if any(_varies(fact) for fact in facts):
                    raise Blocked(inner, "rows of a mask go into a body", _masks(facts))

    def _visit(self, node: ir.Node) -> None:
        facts = [None if value is None else self.facts.get(value) for value in node.inputs]
        if not any(fact is not None for fact in facts):
            made = self._born(node)
        elif is_op(node, "Split"):
            parts = split_rows(node, facts, self.draft)
            if parts is None and any(_varies(fact) for fact in facts):
                raise Blocked(node, "it may split rows apart", _masks(facts))
            self.facts.update(zip(node.outputs, parts or (), strict=False))
            return
        elif (fixed := self._fixed(node, facts)) is not None:
            self.draft.results[node.outputs[0]] = fixed
            return
        else:
            made = self._made(node, facts)
        if made is not None:
            self.facts[node.outputs[0]] = made
        elif not self._feed(node, facts) and any(_varies(fact) for fact in facts):
            raise Blocked(
                node, "it may mix rows, or its shape hangs on the count", _masks(facts)
            )

    def _fixed(self, node: ir.Node, facts: Sequence[Fact | None]) -> ir.Value | None:
        """Draft what has a fixed shape again, where ``node`` gives such."""
        if len(_masks(facts)) != 1:
            return None
        if is_op(node, "ScatterND"):
            return scattered(node, facts, self.draft)
        if is_op(node, "Concat", "Pad") and _fills_up(facts):
            return padded(node, facts, self.draft)
        return reduced(node, facts, self.draft)

    def _born(self, node: ir.Node) -> Fact | None:
        if is_op(node, "NonZero"):
            made: Fact | None = index_of(node)
        elif is_op(node, "Compress"):
            mask = read_mask(node.inputs[1])
            if mask is None or mask.bare in self.left:
                return None
            made = compressed(node, mask, self.draft)
        else:
            made = count_of(node) if is_op(node, "ReduceSum") else None
            return made if made is not None and made.mask.bare not in self.left else None
        if made is None or made.mask.bare in self.left:
            return None
        self.born.append(node)
        return made

    def _made(self, node: ir.Node, facts: Sequence[Fact | None]) -> Fact | None:
        if is_op(node, "NonZero", "Compress", "Gather", "GatherND"):
            again = self._nested(node, facts)
            if again is not None:
                return again
        if len(_masks(facts)) != 1:
            return None
        first, kinds = facts[0], {type(fact) for fact in facts if fact is not None}
        if is_op(node, "Shape") and first is not None:
            return shape_fact(node, first)
        if (
            is_op(node, "Gather", "GatherND")
            and first is None
            and isinstance(facts[1], Index)
        ):
            return taken_rows(node, facts[1], self.draft)
        if isinstance(first, Index):
            return moved_index(node, first)
        if Rows in kinds:
            return moved_rows(node, facts, self.draft)
        if isinstance(first, Filler):
            return first if is_op(node, "Identity") else None
        shape = facts[-1]
        if is_op(node, "ConstantOfShape", "Expand") and isinstance(shape, Linear):
            return filled(node, shape, self.draft)
        return linear(node, facts)

    def _nested(self, node: ir.Node, facts: Sequence[Fact | None]) -> Fact | None:
        """Return what a second mask keeps of rows that a first one kept."""
        rows, chosen = facts[0], facts[-1]
        if not isinstance(rows, Rows):
            return None
        if is_op(node, "NonZero"):
            mask = nested_mask(rows, self.draft)
            return None if mask is None else Index(mask, "columns")
        if is_op(node, "Compress"):
            axis = node.attributes.get("axis")
            if not isinstance(chosen, Rows) or chosen is rows or axis is None or rows.flat:
                return None
            mask = (
                nested_mask(chosen, self.draft)
                if chosen.mask.bare == rows.mask.bare
                else None
            )
            along = axis.as_int() % len(fixed_shape(rows.value) or (1,)) == rows.axis
            return Rows(mask, rows.value, rows.axis) if mask is not None and along else None
        return taken_again(node, rows, chosen) if isinstance(chosen, Index) else None

    def _feed(self, node: ir.Node, facts: Sequence[Fact | None]) -> bool:
        """Let a node that computes with a count, and not a shape, read the count drafted anew.

        Numbers that are taken from a shape but do not hang on the count may be read by any node.
        """
        if not all(fact is None or isinstance(fact, Linear) for fact in facts):
            return False
        numbers = [fact for fact in facts if isinstance(fact, Linear) and fact.varies]
        if any(fact.factor.any() for fact in numbers) and not is_op(node, *_READS_NUMBERS):
            return False
        for place, (value, fact) in enumerate(zip(node.inputs, facts, strict=True)):
            if isinstance(fact, Linear) and fact.varies and value is not None:
                self.draft.fed.append((node, place, self.draft.number(fact, value)))
        return True

    def _outputs(self) -> list[ir.Value | None]:
        facts = [self.facts.get(value) for value in self.graph.outputs]
        counted = {
            fact.mask.bare
            for value, fact in zip(self.graph.outputs, facts, strict=True)
            if isinstance(fact, Linear)
            and self.count in (None, value.name)
            and fact.factor.tolist() == [1]
            and not fact.constant.any()
        }
        made: list[ir.Value | None] = []
        for value, fact in zip(self.graph.outputs, facts, strict=True):
            node = value.producer()
            if isinstance(fact, Rows) and node is not None:
                if fact.axis or fact.flat or fact.mask.bare not in counted:
                    why = "its rows are as many as a mask keeps, and no count output is provably that"
                    raise Blocked(node, why, frozenset({fact.mask.bare}))
                made.append(self.draft.compact(fact))
            elif isinstance(fact, Linear):
                made.append(self._counted(fact, value) if fact.varies else None)
            elif fact is not None and node is not None:
                raise Blocked(
                    node, "the places of a mask are an output", frozenset({fact.mask.bare})
                )
            else:
                made.append(None)
        return made

    def _counted(self, fact: Linear, value: ir.Value) -> ir.Value:
        """Draft an output of counts, on an operator of its own that capture records."""
        assert value.dtype is not None
        zero = self.draft.constant(0, value.dtype.numpy())
        return self.draft.op(
            "Add", self.draft.number(fact, value), zero, shape=list(fact.constant.shape)
        )


def _fills_up(facts: Sequence[Fact | None]) -> bool:
    """Say whether rows meet what fills them up to a capacity."""
    return isinstance(facts[0], Rows) and any(
        isinstance(fact, Filler | Linear) for fact in facts[1:]
    )


def _varies(fact: Fact | None) -> bool:
    return fact is not None and (not isinstance(fact, Linear) or fact.varies)


def _masks(facts: Sequence[Fact | None]) -> frozenset[Mask]:
    return frozenset(fact.mask.bare for fact in facts if fact is not None)
