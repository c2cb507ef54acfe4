"""Decides which nodes and weights stay float32, by output error, tiny ε terms and neighbours."""

__all__ = ["RetainedFloat32", "choose_tables", "epsilon_guards", "merge_islands", "retained_nodes"]

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.units import FLOAT16_MAX, FLOAT16_SMALLEST_NORMAL
from gsgen.sdk.float16.error_measure import ErrorProbe
from gsgen.sdk.float16.instrumented_model import GUARD_ELEMENTS
from gsgen.sdk.float16.sensitivity_search import Search, Sensitivity, max_quantizable
from gsgen.sdk.float16.to_float16 import FLOAT, Boundary, convertible_indices, node_key
from gsgen.sdk.float16.weight_tables import LEAST_ELEMENTS
from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.graph_builder import constant_array

# Operators between a guard and the division that it protects.
_BEHIND_GUARDS = (
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
    measure: ErrorProbe, budget: int, allowed: float, allowed_with_small: float
) -> Search:
    """Choose weight tables to store in 16 bits, large ones first, within the allowed error.

    A table whose even steps are too coarse is tried as float16, which rounds small numbers less.

    ``allowed`` is the largest share of the tolerance, ``allowed_with_small`` the one up to which
    tables of fewer than ``LEAST_ELEMENTS`` are stored so, too: few bytes depend on them.
    """
    # Step 1: large tables, each in the form that is closer.
    measure.model.store_unstepped(())
    large = [k for k, size in enumerate(measure.sizes) if size >= LEAST_ELEMENTS]
    first = max_quantizable(large, measure.of_weights, budget=budget, allowed=allowed)
    stepped = [k for group in first.retained for k in group.units if measure.model.is_in_steps(k)]
    # Step 2: large tables that were too coarse in even steps, as float16.
    measure.model.store_unstepped(stepped)
    unstepped = max_quantizable(
        stepped,
        lambda added: measure.of_weights([*first.quantized, *added]),
        budget=budget - first.measured,
        allowed=allowed,
    )
    stored = first.quantized | unstepped.quantized
    retained_groups = (
        replace(group, units=tuple(k for k in group.units if k not in stored))
        for group in first.retained
    )
    measured = first.measured + unstepped.measured
    # Step 3: small tables.
    small = [k for k, size in enumerate(measure.sizes) if size < LEAST_ELEMENTS]
    second = max_quantizable(
        small,
        lambda added: measure.of_weights([*stored, *added]),
        budget=budget - measured,
        allowed=allowed_with_small,
    )
    return Search(
        stored | second.quantized,
        (*(group for group in retained_groups if group.units), *second.retained),
        measured + second.measured,
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
    front: list[ir.Node] = []
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
                front.append(node)
    while front:
        for reader in (use.node for v in front.pop().outputs for use in v.uses()):
            ends = is_op(reader, "Div", "Mul")
            if reader in reasons or not (ends or is_op(reader, *_BEHIND_GUARDS)):
                continue
            reasons[reader] = "between a guard and its division"  # Case 4
            if not ends:
                front.append(reader)
    return reasons


def retained_nodes(
    nodes: Sequence[ir.Node], guarded: Mapping[ir.Node, str], costly: Sequence[Sensitivity]
) -> list[RetainedFloat32]:
    """Return the nodes that stay float32: tiny ε terms, and groups with too large an error."""
    able = set(nodes)
    retained = [
        RetainedFloat32(node_key(node), reason) for node, reason in guarded.items() if node in able
    ]
    for group in costly:
        retained += [
            RetainedFloat32(node_key(nodes[k]), group.field, group.excess) for k in group.units
        ]
    return retained


def merge_islands(
    boundary: Boundary, nodes: Sequence[ir.Node], retained: Sequence[RetainedFloat32]
) -> list[RetainedFloat32]:
    """Return further nodes to keep in float32, so that fewer Casts between dtypes are needed."""
    keep = {entry.node for entry in retained}
    added: list[RetainedFloat32] = []
    while True:
        fresh = [
            node
            for node in nodes
            if node_key(node) not in keep
            and _borders(node, keep)
            and boundary.saved(node, keep) > 0
        ]
        if not fresh:
            return added
        keep.add(node_key(fresh[0]))
        added.append(RetainedFloat32(node_key(fresh[0]), "saves Casts"))


def _borders(node: ir.Node, keep: Collection[str]) -> bool:
    near = [value.producer() for value in node.inputs if value is not None]
    near += [use.node for value in node.outputs for use in value.uses()]
    return any(neighbour is not None and node_key(neighbour) in keep for neighbour in near)
