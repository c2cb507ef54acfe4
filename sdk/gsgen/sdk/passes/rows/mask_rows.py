"""Rewrites boolean indexing (selecting rows by a mask) with static shapes."""

__all__ = ["MaskRows"]

from collections.abc import Sequence

import onnx_ir as ir
from onnx_ir.passes.common import RemoveUnusedNodesPass

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.passes.framework.base import ErrorBudget, RewriteTarget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import append_output, replace_value
from gsgen.sdk.passes.framework.value_facts import fixed_shape, numpy_dtype, required
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import (
    Index,
    Linear,
    Mask,
    MaskBlocked,
    PaddingRowsFact,
    Rows,
    RowTensorFact,
    read_mask,
)
from gsgen.sdk.passes.rows.row_indices import (
    compose_masks,
    compress_rows,
    gather_nested_rows,
    gather_rows,
    nonzero_index,
    transform_index,
)
from gsgen.sdk.passes.rows.row_numbers import constant_rows, linear_numbers, mask_count, shape_fact
from gsgen.sdk.passes.rows.row_operators import propagate_rows, split_rows
from gsgen.sdk.passes.rows.row_reductions import (
    pad_rows,
    reduce_rows,
    rows_of_fixed_count,
    scatter_rows,
)

_NUMBER_READING_OPERATORS = (
    "Add", "Cast", "Div", "Mul", "Sub", "Where", "Equal", "Less", "Greater", "Min", "Max",
)  # fmt: skip


class MaskRows(SkippableRewrite):
    """Compute all N rows instead of the K rows that a mask selects, and compact them at the end.

    The values decide how many rows NonZero and Compress return, so these run on the CPU, and graph
    capture is refused for the whole model. Operators that work row by row can process all rows::

        1  x[mask] → f → y [K, 10]     →   x → f → Gather(order) → Where(row < K) → y [N, 10]
        2  x[mask] = f(x[mask])        →   Where(mask, f(x), x)
        3  cat(x[mask], zeros(C − K))  →   as case 1, with C rows and equal bits
        4  sum(x[mask])                →   sum(Where(mask, x, 0))
        5  reshape(x[mask], [12, 3])   →   sum(Where(mask, x, 0), axis=1), if each row has one True

    The order comes from the mask's prefix sum (CumSum) by binary search; K is its last element.
    In case 1, an output of K rows becomes one of N rows: the first K are the same, the others are
    zero. By the contract this is the same model if ``num_points`` is K, so case 1 needs an output
    that is provably K (``num_points``, if the manifest names it).

    Products and sums of N rows may round differently from those of K; nothing else changes a bit.

    A mask stays as it is, with all nodes that depend on it, if one of them may mix rows or shapes
    (a running sum, an index computed from rows).
    """

    name = "mask-rows"
    exactness = ErrorBudget(relative=2e-6, pads=True)
    wanted_by = "targets that capture graphs"

    def __init__(self, count: str | None = None) -> None:
        super().__init__()
        self.count = count

    @classmethod
    def for_target(cls, target: RewriteTarget) -> "MaskRows":
        """Return the rewrite, set up with the name of the output that counts rows, if any."""
        declared = target.manifest
        known = declared.outputs.count if isinstance(declared, GeneratorManifest) else None
        return cls(known.name if known is not None else None)

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite all boolean row masks; each failed attempt excludes one more mask."""
        excluded: frozenset[Mask] = frozenset()
        while True:
            attempt = _MaskingAttempt(model.graph, excluded, self.count)
            try:
                outputs = attempt.run()
            except MaskBlocked as blocked:
                attempt.draft.discard()
                self.refuse(blocked.node, blocked.reason)
                excluded |= {outer_mask for mask in blocked.masks for outer_mask in mask.chain}
                continue
            break
        if not attempt.sources:
            attempt.draft.discard()
            return
        for node in attempt.sources:
            self.note(node)
        attempt.finish(outputs)
        RemoveUnusedNodesPass()(model)


class _MaskingAttempt:
    """One attempt to rewrite all boolean row masks of a graph except some excluded ones."""

    def __init__(self, graph: ir.Graph, excluded: frozenset[Mask], count: str | None) -> None:
        self.graph, self.excluded, self.count = graph, excluded, count
        self.draft = RowDraft("masked_rows")
        self.facts: dict[ir.Value, RowTensorFact] = {}
        self.sources: list[ir.Node] = []

    def run(self) -> list[ir.Value | None]:
        """Create static-shape nodes for a whole graph; return each graph output's replacement.

        Raises :class:`MaskBlocked` if a node mixes rows, or its shape would still vary.
        """
        for node in self.graph:
            self._refuse_subgraphs(node)
            self.draft.anchor = node
            self._propagate_fact(node)
        self.draft.anchor = None
        return self._new_outputs()

    def finish(self, outputs: Sequence[ir.Value | None]) -> None:
        """Add the created nodes to the graph, and use their results for the original values."""
        for node, input_index, value in self.draft.input_replacements:
            node.replace_input_with(input_index, value)
        self.draft.join(self.graph)
        for old, replacement in self.draft.results.items():
            replace_value(old, replacement)
        for old, new in zip(list(self.graph.outputs), outputs, strict=True):
            if new is not None:
                producer_node = required(new.producer())
                self.graph.remove(producer_node)
                append_output(self.graph, old, [producer_node])

    def _refuse_subgraphs(self, node: ir.Node) -> None:
        for attribute in node.attributes.values():
            if attribute.type != ir.AttributeType.GRAPH:
                continue
            for inner_node in attribute.as_graph().all_nodes():
                facts = [self.facts.get(value) for value in inner_node.inputs if value is not None]
                if any(_does_vary_by_row(fact) for fact in facts):
                    raise MaskBlocked(inner_node, "a subgraph reads rows of a mask", _masks(facts))

    def _propagate_fact(self, node: ir.Node) -> None:
        facts = [None if value is None else self.facts.get(value) for value in node.inputs]
        if not any(fact is not None for fact in facts):
            fact = self._source_row_fact(node)
        elif is_op(node, "Split"):
            parts = split_rows(node, facts, self.draft)
            if parts is None and any(_does_vary_by_row(fact) for fact in facts):
                raise MaskBlocked(node, "it may split the rows", _masks(facts))
            self.facts.update(zip(node.outputs, parts or (), strict=False))
            return
        elif (fixed_value := self._fixed_size_value(node, facts)) is not None:
            self.draft.results[node.outputs[0]] = fixed_value
            return
        else:
            fact = self._propagated_fact(node, facts)
        if fact is not None:
            self.facts[node.outputs[0]] = fact
        elif not self._replace_counts(node, facts) and any(
            _does_vary_by_row(fact) for fact in facts
        ):
            raise MaskBlocked(
                node, "it may mix rows, or its shape depends on the count", _masks(facts)
            )

    def _fixed_size_value(
        self, node: ir.Node, facts: Sequence[RowTensorFact | None]
    ) -> ir.Value | None:
        """Create a fixed-size value in place of a node's output, whose size depends on a mask."""
        if len(_masks(facts)) != 1:
            return None
        if is_op(node, "ScatterND"):  # Case 2: rows are written back
            return scatter_rows(node, facts, self.draft)
        is_padding_filled = any(isinstance(fact, PaddingRowsFact | Linear) for fact in facts[1:])
        if (
            is_op(node, "Concat", "Pad") and isinstance(facts[0], Rows) and is_padding_filled
        ):  # Case 3: up to a capacity
            return pad_rows(node, facts, self.draft)
        if is_op(node, "Reshape") and isinstance(facts[0], Rows) and not any(facts[1:]):
            return rows_of_fixed_count(node, facts, self.draft)  # Case 5: K is a known number
        return reduce_rows(node, facts, self.draft)  # Case 4: a reduction over the rows

    def _source_row_fact(self, node: ir.Node) -> RowTensorFact | None:
        if is_op(node, "NonZero"):
            fact: RowTensorFact | None = nonzero_index(node)
        elif is_op(node, "Compress"):
            mask = read_mask(node.inputs[1])
            if mask is None or mask.without_repeats in self.excluded:
                return None
            fact = compress_rows(node, mask, self.draft)
        else:
            fact = mask_count(node) if is_op(node, "ReduceSum") else None
            return (
                fact
                if fact is not None and fact.mask.without_repeats not in self.excluded
                else None
            )
        if fact is None or fact.mask.without_repeats in self.excluded:
            return None
        self.sources.append(node)
        return fact

    def _propagated_fact(
        self, node: ir.Node, facts: Sequence[RowTensorFact | None]
    ) -> RowTensorFact | None:
        if is_op(node, "NonZero", "Compress", "Gather", "GatherND"):
            nested_rows = self._nested_fact(node, facts)
            if nested_rows is not None:
                return nested_rows
        if len(_masks(facts)) != 1:
            return None
        first_fact, kinds = facts[0], {type(fact) for fact in facts if fact is not None}
        if is_op(node, "Shape") and first_fact is not None:
            return shape_fact(node, first_fact)
        if is_op(node, "Gather", "GatherND") and first_fact is None and isinstance(facts[1], Index):
            return gather_rows(node, facts[1], self.draft)
        if isinstance(first_fact, Index):
            return transform_index(node, first_fact)
        if Rows in kinds:
            return propagate_rows(node, facts, self.draft)
        if isinstance(first_fact, PaddingRowsFact):
            return first_fact if is_op(node, "Identity") else None
        shape = facts[-1]
        if is_op(node, "ConstantOfShape", "Expand") and isinstance(shape, Linear):
            return constant_rows(node, shape, self.draft)
        return linear_numbers(node, facts)

    def _nested_fact(
        self, node: ir.Node, facts: Sequence[RowTensorFact | None]
    ) -> RowTensorFact | None:
        """Return the rows that a mask selects among the rows that an earlier mask selected."""
        rows, selector = facts[0], facts[-1]
        if not isinstance(rows, Rows):
            return None
        if is_op(node, "NonZero"):
            mask = compose_masks(rows, self.draft)
            return None if mask is None else Index(mask, "columns")
        if is_op(node, "Compress"):
            axis = node.attributes.get("axis")
            if not isinstance(selector, Rows) or selector is rows or axis is None or rows.flat:
                return None
            mask = (
                compose_masks(selector, self.draft)
                if selector.mask.without_repeats == rows.mask.without_repeats
                else None
            )
            is_row_gather = axis.as_int() % len(fixed_shape(rows.value) or (1,)) == rows.axis
            return Rows(mask, rows.value, rows.axis) if mask is not None and is_row_gather else None
        return gather_nested_rows(node, rows, selector) if isinstance(selector, Index) else None

    def _replace_counts(self, node: ir.Node, facts: Sequence[RowTensorFact | None]) -> bool:
        """Replace inputs that count selected rows by the number of all rows; return whether done.

        Any node may read numbers from a shape if they do not depend on the count.
        """
        if not all(fact is None or isinstance(fact, Linear) for fact in facts):
            return False
        numbers = [fact for fact in facts if isinstance(fact, Linear) and fact.varies]
        is_repeated = is_op(node, "Expand") and facts[1] is None
        if any(fact.factor.any() for fact in numbers) and not (
            is_repeated or is_op(node, *_NUMBER_READING_OPERATORS)
        ):
            return False
        for input_index, (value, fact) in enumerate(zip(node.inputs, facts, strict=True)):
            if isinstance(fact, Linear) and fact.varies and value is not None:
                self.draft.input_replacements.append(
                    (node, input_index, self.draft.number(fact, value))
                )
        return True

    def _new_outputs(self) -> list[ir.Value | None]:
        """Replace outputs of K mask-selected rows by all N rows, if the model also outputs K."""
        facts = [self.facts.get(value) for value in self.graph.outputs]
        count_outputs = {
            fact.mask.without_repeats
            for value, fact in zip(self.graph.outputs, facts, strict=True)
            if isinstance(fact, Linear)
            and self.count in (None, value.name)
            and fact.factor.tolist() == [1]
            and not fact.constant.any()
        }
        replacements: list[ir.Value | None] = []
        for value, fact in zip(self.graph.outputs, facts, strict=True):
            node = value.producer()
            if isinstance(fact, Rows) and node is not None:
                if fact.axis or fact.flat or fact.mask.without_repeats not in count_outputs:
                    reason = "a mask decides its number of rows, and no count output is provably that number"
                    raise MaskBlocked(node, reason, frozenset({fact.mask.without_repeats}))
                replacements.append(self.draft.compact(fact))
            elif isinstance(fact, Linear):
                replacements.append(self._count_output(fact, value) if fact.varies else None)
            elif fact is not None and node is not None:
                raise MaskBlocked(
                    node,
                    "the indices of a mask are an output",
                    frozenset({fact.mask.without_repeats}),
                )
            else:
                replacements.append(None)
        return replacements

    def _count_output(self, fact: Linear, value: ir.Value) -> ir.Value:
        """Create an output with the row count, computed by an Add, which graph capture records."""
        zero = self.draft.constant(0, numpy_dtype(value))
        return self.draft.op(
            "Add", self.draft.number(fact, value), zero, shape=list(fact.constant.shape)
        )


def _does_vary_by_row(fact: RowTensorFact | None) -> bool:
    return fact is not None and (not isinstance(fact, Linear) or fact.varies)


def _masks(facts: Sequence[RowTensorFact | None]) -> frozenset[Mask]:
    return frozenset(fact.mask.without_repeats for fact in facts if fact is not None)
