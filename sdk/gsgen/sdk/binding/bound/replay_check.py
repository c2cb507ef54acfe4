"""Compares frames replayed by graph capture with frames computed without it."""

__all__ = ["ReplayMismatch", "arrays_agree", "largest_difference", "output_origin", "wrong_outputs"]

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gsgen.contract.probing import differences

if TYPE_CHECKING:
    from gsgen.contract.model.graph import Graph

Outputs = Mapping[str, np.ndarray]

# Two runs on one adapter use the same kernels, so they agree to the last bits.
_TOLERANCE_OF_DTYPE = {"float32": 1e-5, "float16": 2e-3}
# Operators that are buffer copies, which capture does not record, or that update in place.
_COPY_OPERATORS = frozenset({
    "Flatten", "Identity", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum",
    "Reshape", "ScatterElements", "ScatterND", "Squeeze", "Unsqueeze",
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class ReplayMismatch:
    """A model output whose replayed frames differ from frames computed without graph capture."""

    output: str  # the output, as a location
    actual: str  # how its replays differ, and the operator that computes it


def wrong_outputs(
    uncaptured: Sequence[Outputs], replayed: Sequence[Outputs], origin: Callable[[str], str]
) -> Iterator[ReplayMismatch]:
    """Yield every model output whose frames replayed by graph capture are wrong.

    ``replayed`` holds the frames of ``uncaptured``: the first was captured, the others replayed.
    ``origin`` describes the operator that an output, given by name, comes from.
    """
    for name in uncaptured[0] if uncaptured else ():
        expected = [np.asarray(outputs[name]) for outputs in uncaptured]
        actual = [np.asarray(outputs[name]) for outputs in replayed]
        wrong_frames = [
            k
            for k, pair in enumerate(zip(expected, actual, strict=True))
            if not arrays_agree(*pair)
        ]
        if not wrong_frames:
            continue
        is_output_changing = any(not _same_bits(array, expected[0]) for array in expected)
        does_repeat_first = all(_same_bits(array, actual[0]) for array in actual)
        if is_output_changing and does_repeat_first and arrays_agree(expected[0], actual[0]):
            difference = f"repeats frame 0 in all {len(actual) - 1} replays"
        else:
            difference = f"{len(wrong_frames)} of {len(expected)} frames differ, the first is frame {wrong_frames[0]}"
        yield ReplayMismatch(f"output {name}", f"{difference}; {origin(name)}")


def arrays_agree(a: np.ndarray, b: np.ndarray, tolerance: float | None = None) -> bool:
    """Return whether two arrays agree within a tolerance wherever the first one is finite."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return False
    if _same_bits(a, b):
        return True
    if a.dtype.kind != "f":
        return False
    allowed = _TOLERANCE_OF_DTYPE[a.dtype.name] if tolerance is None else tolerance
    finite_values = np.abs(a[np.isfinite(a)].astype(np.float64))
    return bool(largest_difference(a, b) <= allowed * finite_values.max(initial=0.0))


def largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return max |a − b| where ``a`` is finite; infinite if ``b`` is not finite there."""
    if a.shape != b.shape:
        return float("inf")
    finite_mask = np.isfinite(a)
    return differences.largest_difference(a[finite_mask], b[finite_mask])


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()


def output_origin(graph: "Graph", name: str) -> str:
    """Describe the node that probably makes an output wrong in replayed frames."""
    if graph.input(name) is not None:
        return "it is an unchanged input"
    producer = graph.producers.get(name)
    if producer is None:
        return "no node computes it"
    if producer.op_type in _COPY_OPERATORS:
        return f"made by {producer.op_type} (node {producer.name or producer.op_type})"
    scatter_nodes = [n for n in graph.ancestors(name)[1] if n.op_type.startswith("Scatter")]
    if scatter_nodes:
        scatter_node = scatter_nodes[0]
        return f"computed from {scatter_node.op_type} (node {scatter_node.name or scatter_node.op_type})"
    int64_nodes = [n for n in graph.ancestors(name)[1] if _has_int64(graph, list(n.output))]
    if int64_nodes:
        scatter_node = int64_nodes[0]
        return f"computed from int64 {scatter_node.op_type} (node {scatter_node.name or scatter_node.op_type})"
    return f"made by {producer.op_type} (node {producer.name or producer.op_type})"


def _has_int64(graph: "Graph", names: list[str]) -> bool:
    tensors = [graph.tensors.get(name) for name in names]
    return any(tensor is not None and tensor.dtype == "int64" for tensor in tensors)
