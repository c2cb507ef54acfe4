"""Decides which nodes and weights stay float32, by output error, tiny ε terms and neighbours."""

__all__ = ["RetainedFloat32", "choose_tables", "epsilon_guards", "merge_islands", "retained_nodes"]

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.units import FLOAT16_MAX, FLOAT16_SMALLEST_NORMAL
from gsgen.sdk.float16.error_measure import ErrorProbe
from gsgen.sdk.float16.instrumented_model import GUARD_ELEMENTS
from gsgen.sdk.float16.sensitivity_search import Sensitivity, SensitivitySearch, max_quantizable
from gsgen.sdk.float16.to_float16 import FLOAT, Boundary, convertible_indices, node_key
from gsgen.sdk.float16.weight_tables import MIN_TABLE_ELEMENTS
from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.graph_builder import constant_array

# Operators between a guard and the division that it protects.
_GUARD_CHAIN_OPERATORS = (
    *("Sqrt", "Reciprocal", "Pow", "Cast", "Expand", "Reshape", "Squeeze", "Unsqueeze"),
    *("Transpose", "Identity", "Slice", "Gather", "Where", "Clip", "Max", "Min"),
)


@dataclass(frozen=True, slots=True)
class RetainedFloat32:
    """A node or weight that stays float32 in a float16 model, with the reason.

    Attributes:
        node: Its name; for a node, the name of its first result.
        reason: The field whose error is too large, a guard, a decision, or "saves Casts".
        excess: The share of the tolerance, beyond the rounding of outputs, that its group alone
            would use; 0 for other reasons.
    """

    node: str
    reason: str
    excess: float = 0.0


def choose_tables(
    measure: ErrorProbe, budget: int, allowed: float, allowed_error_of_small_tables: float
) -> SensitivitySearch:
    """Choose weight tables to store in 16 bits, large ones first, within the allowed error.

    A table whose even steps are too coarse is tried as float16, which rounds small numbers less.

    ``allowed`` is the largest share of the tolerance, ``allowed_error_of_small_tables`` the one up to which
    tables of fewer than ``MIN_TABLE_ELEMENTS`` are stored so, too: few bytes depend on them.
    """
    # Step 1: large tables, each in the form that is closer.
    measure.model.store_unstepped(())
    large_tables = [k for k, size in enumerate(measure.sizes) if size >= MIN_TABLE_ELEMENTS]
    first_search = max_quantizable(
        large_tables, measure.weights_error, budget=budget, allowed=allowed
    )
    even_step_tables = [
        k
        for group in first_search.retained
        for k in group.units
        if measure.model.is_evenly_quantized(k)
    ]
    # Step 2: large tables that were too coarse in even steps, as float16.
    measure.model.store_unstepped(even_step_tables)
    unstepped = max_quantizable(
        even_step_tables,
        lambda added_entries: measure.weights_error([*first_search.quantized, *added_entries]),
        budget=budget - first_search.measured,
        allowed=allowed,
    )
    stored = first_search.quantized | unstepped.quantized
    retained_groups = (
        replace(group, units=tuple(k for k in group.units if k not in stored))
        for group in first_search.retained
    )
    measured = first_search.measured + unstepped.measured
    # Step 3: small tables.
    small_tables = [k for k, size in enumerate(measure.sizes) if size < MIN_TABLE_ELEMENTS]
    second_search = max_quantizable(
        small_tables,
        lambda added_entries: measure.weights_error([*stored, *added_entries]),
        budget=budget - measured,
        allowed=allowed_error_of_small_tables,
    )
    return SensitivitySearch(
        stored | second_search.quantized,
        (*(group for group in retained_groups if group.units), *second_search.retained),
        measured + second_search.measured,
    )


def epsilon_guards(nodes: Sequence[ir.Node], opset: int) -> dict[ir.Node, str]:
    """Return nodes that must stay float32: comparisons, tiny ε terms, constants above 65,504.

    Case 1: a comparison turns a small error into a large one, at a time between the probes.
    Case 2: a constant beyond 65,504 becomes infinite.
    Case 3: an epsilon that becomes zero no longer protects a division, whose divisor may be zero
    only in a frame without a probe.
    Case 4: the operators between such an epsilon and the division.
    """
    reasons: dict[ir.Node, str] = {}
    pending_nodes: list[ir.Node] = []
    for node in nodes:
        if not convertible_indices(node, opset)[1]:
            reasons[node] = "it decides"  # Case 1
        for value in node.inputs:
            array = constant_array(value) if value is not None and value.dtype == FLOAT else None
            if array is None:
                continue
            size = np.abs(array[np.isfinite(array)])
            if (size > FLOAT16_MAX).any():
                reasons[node] = "a constant beyond 65,504"  # Case 2
            elif (
                array.size <= GUARD_ELEMENTS
                and ((size > 0) & (size < FLOAT16_SMALLEST_NORMAL)).any()
            ):
                reasons[node] = "a guard that float16 makes zero"  # Case 3
                pending_nodes.append(node)
    while pending_nodes:
        for reader in (use.node for v in pending_nodes.pop().outputs for use in v.uses()):
            is_division = is_op(reader, "Div", "Mul")
            if reader in reasons or not (is_division or is_op(reader, *_GUARD_CHAIN_OPERATORS)):
                continue
            reasons[reader] = "between a guard and its division"  # Case 4
            if not is_division:
                pending_nodes.append(reader)
    return reasons


def retained_nodes(
    nodes: Sequence[ir.Node],
    guard_reasons: Mapping[ir.Node, str],
    costly_groups: Sequence[Sensitivity],
) -> list[RetainedFloat32]:
    """Return the nodes that stay float32: tiny ε terms, and groups with too large an error."""
    convertible_nodes = set(nodes)
    retained = [
        RetainedFloat32(node_key(node), reason)
        for node, reason in guard_reasons.items()
        if node in convertible_nodes
    ]
    for group in costly_groups:
        retained += [
            RetainedFloat32(node_key(nodes[k]), group.field, group.excess) for k in group.units
        ]
    return retained


def merge_islands(
    boundary: Boundary, nodes: Sequence[ir.Node], retained: Sequence[RetainedFloat32]
) -> list[RetainedFloat32]:
    """Return further nodes to keep in float32, so that fewer Casts between dtypes are needed."""
    keep = {entry.node for entry in retained}
    added_entries: list[RetainedFloat32] = []
    while True:
        new_entries = [
            node
            for node in nodes
            if node_key(node) not in keep
            and _has_retained_neighbour(node, keep)
            and boundary.saved_casts(node, keep) > 0
        ]
        if not new_entries:
            return added_entries
        keep.add(node_key(new_entries[0]))
        added_entries.append(RetainedFloat32(node_key(new_entries[0]), "saves Casts"))


def _has_retained_neighbour(node: ir.Node, keep: Collection[str]) -> bool:
    neighbours = [value.producer() for value in node.inputs if value is not None]
    neighbours += [use.node for value in node.outputs for use in value.uses()]
    return any(neighbour is not None and node_key(neighbour) in keep for neighbour in neighbours)
