"""What of a model stays float32: tables and nodes whose rounding shows, guards, and islands."""

__all__ = ["Kept", "choose_tables", "epsilon_guards", "explain", "merge_islands"]

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx_ir as ir

from gsgen.sdk.float16.error_measure import ErrorProbe
from gsgen.sdk.float16.instrumented_model import GUARD_ELEMENTS, LARGEST
from gsgen.sdk.float16.sensitivity_search import Search, Sensitivity, max_quantizable
from gsgen.sdk.float16.to_float16 import FLOAT, Boundary, key_of, places_of
from gsgen.sdk.float16.weight_tables import LEAST_ELEMENTS
from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.graph_builder import known_array

_NORMAL = 2.0**-14
_BEHIND_GUARDS = (
    *("Sqrt", "Reciprocal", "Pow", "Cast", "Expand", "Reshape", "Squeeze", "Unsqueeze"),
    *("Transpose", "Identity", "Slice", "Gather", "Where", "Clip", "Max", "Min"),
)


@dataclass(frozen=True, slots=True)
class Kept:
    """A node that stays float32.

    Attributes:
        node: Its name, which is that of its first result.
        why: The field that would show it, a guard, a decision, or a neighbour that saves Casts.
        excess: How much of what is allowed, beyond the rounding of outputs, its group alone would
            use up; 0 where that is not the reason.
    """

    node: str
    why: str
    excess: float = 0.0


def choose_tables(measure: ErrorProbe, budget: int, allowed: float) -> Search:
    """Find tables to store in 16 bits: large ones first, since small ones hardly matter.

    A table whose even steps would show is tried as float16, which rounds small numbers less.
    """
    measure.model.store_plainly(())
    large = [k for k, size in enumerate(measure.sizes) if size >= LEAST_ELEMENTS]
    first = max_quantizable(large, measure.of_weights, budget=budget, allowed=allowed)
    again = [k for one in first.kept for k in one.units if measure.model.is_in_steps(k)]
    measure.model.store_plainly(again)
    plain = max_quantizable(
        again,
        lambda more: measure.of_weights([*first.quantized, *more]),
        budget=budget - first.measured,
        allowed=allowed,
    )
    stored = first.quantized | plain.quantized
    kept = (
        replace(one, units=tuple(k for k in one.units if k not in stored))
        for one in first.kept
    )
    measured = first.measured + plain.measured
    small = [k for k, size in enumerate(measure.sizes) if size < LEAST_ELEMENTS]
    second = max_quantizable(
        small,
        lambda more: measure.of_weights([*stored, *more]),
        budget=budget - measured,
        allowed=allowed,
    )
    return Search(
        stored | second.quantized,
        (*(one for one in kept if one.units), *second.kept),
        measured + second.measured,
    )


def epsilon_guards(nodes: Sequence[ir.Node], opset: int) -> dict[ir.Node, str]:
    """Return nodes that are kept from float16 whatever the probes show.

    An epsilon that becomes zero guards nothing, and what it guards may only be zero in a frame that
    no probe has; so all that follows it stays, up to the division. And a comparison turns a small
    error into a large one, at some time between the probes.
    """
    found: dict[ir.Node, str] = {}
    front: list[ir.Node] = []
    for node in nodes:
        if not places_of(node, opset)[1]:
            found[node] = "it decides"
        for value in node.inputs:
            array = (
                known_array(value) if value is not None and value.dtype == FLOAT else None
            )
            if array is None:
                continue
            size = np.abs(array[np.isfinite(array)])
            if (size > LARGEST).any():
                found[node] = "a constant beyond 65,504"
            elif array.size <= GUARD_ELEMENTS and ((size > 0) & (size < _NORMAL)).any():
                found[node] = "a guard that float16 makes zero"
                front.append(node)
    while front:
        for reader in (use.node for v in front.pop().outputs for use in v.uses()):
            ends = is_op(reader, "Div", "Mul")
            if reader in found or not (ends or is_op(reader, *_BEHIND_GUARDS)):
                continue
            found[reader] = "what a guard guards"
            if not ends:
                front.append(reader)
    return found


def explain(
    nodes: Sequence[ir.Node], guarded: Mapping[ir.Node, str], costly: Sequence[Sensitivity]
) -> list[Kept]:
    """Say why nodes stay float32: what was known beforehand, and what was measured."""
    able = set(nodes)
    kept = [Kept(key_of(node), why) for node, why in guarded.items() if node in able]
    for group in costly:
        kept += [Kept(key_of(nodes[k]), group.field, group.excess) for k in group.units]
    return kept


def merge_islands(
    boundary: Boundary, nodes: Sequence[ir.Node], kept: Sequence[Kept]
) -> list[Kept]:
    """Return nodes among the kept ones that need fewer Casts if they are kept, too."""
    keep = {one.node for one in kept}
    added: list[Kept] = []
    while True:
        fresh = [
            node
            for node in nodes
            if key_of(node) not in keep
            and _borders(node, keep)
            and boundary.saved(node, keep) > 0
        ]
        if not fresh:
            return added
        keep.add(key_of(fresh[0]))
        added.append(Kept(key_of(fresh[0]), "saves Casts"))


def _borders(node: ir.Node, keep: Collection[str]) -> bool:
    near = [value.producer() for value in node.inputs if value is not None]
    near += [use.node for value in node.outputs for use in value.uses()]
    return any(one is not None and key_of(one) in keep for one in near)
