"""Whether replayed frames are what a plain run computes; and which operator is to blame if not."""

__all__ = ["WrongReplay", "agree", "largest_difference", "maker", "wrong_outputs"]

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gsgen.contract.model.graph import Graph

Outputs = Mapping[str, np.ndarray]

# Two runs on one adapter use the same kernels, so they agree to the last bits.
_SAME = {"float32": 1e-5, "float16": 2e-3}
# Capture records kernels; these are mere copies, or write where the frame before wrote.
_CULPRITS = frozenset(
    {
        "Flatten",
        "Identity",
        "ReduceMax",
        "ReduceMean",
        "ReduceMin",
        "ReduceProd",
        "ReduceSum",
        "Reshape",
        "ScatterElements",
        "ScatterND",
        "Squeeze",
        "Unsqueeze",
    }
)


@dataclass(frozen=True, slots=True)
class WrongReplay:
    """An output whose replays are not what a plain run computes.

    Attributes:
        place: The output.
        actual: How its replays differ, and which operator made it.
    """

    place: str
    actual: str


def wrong_outputs(
    plain: Sequence[Outputs], replayed: Sequence[Outputs], blame: Callable[[str], str]
) -> Iterator[WrongReplay]:
    """Yield every output that replays wrongly.

    Args:
        plain: The outputs of each frame, computed without capture.
        replayed: The same frames; the first was captured, the others were replayed.
        blame: Says of an output's name where it comes from.
    """
    for name in plain[0] if plain else ():
        wanted = [np.asarray(one[name]) for one in plain]
        given = [np.asarray(one[name]) for one in replayed]
        wrong = [
            k for k, pair in enumerate(zip(wanted, given, strict=True)) if not agree(*pair)
        ]
        if not wrong:
            continue
        changing = any(not _same_bits(one, wanted[0]) for one in wanted)
        still = all(_same_bits(one, given[0]) for one in given)
        if changing and still and agree(wanted[0], given[0]):
            how = f"repeats frame 0 in all {len(given) - 1} replays"
        else:
            how = f"{len(wrong)} of {len(wanted)} frames differ, the first is frame {wrong[0]}"
        yield WrongReplay(f"output {name}", f"{how}; {blame(name)}")


def agree(a: np.ndarray, b: np.ndarray, tolerance: float | None = None) -> bool:
    """Say whether two arrays agree; where ``a`` is not finite, anything does."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return False
    if _same_bits(a, b):
        return True
    if a.dtype.kind != "f":
        return False
    allowed = _SAME[a.dtype.name] if tolerance is None else tolerance
    finite = np.abs(a[np.isfinite(a)].astype(np.float64))
    return bool(largest_difference(a, b) <= allowed * finite.max(initial=0.0))


def largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference where ``a`` is finite; infinity where only ``b`` is not."""
    if a.shape != b.shape:
        return float("inf")
    x, y = a.astype(np.float64), b.astype(np.float64)
    known = np.isfinite(x)
    with np.errstate(invalid="ignore"):
        difference = np.abs(x - y)[known]
    return float(np.where(np.isnan(difference), np.inf, difference).max(initial=0.0))


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()


def maker(graph: "Graph", name: str) -> str:
    """Name the operator that is to blame: the output's own, else a suspect before it."""
    if graph.input(name) is not None:
        return "it is an input passed through"
    producer = graph.producers.get(name)
    if producer is None:
        return "no node makes it"
    if producer.op_type in _CULPRITS:
        return f"made by {producer.op_type} (node {producer.name or producer.op_type})"
    suspects = [n for n in graph.ancestors(name)[1] if n.op_type.startswith("Scatter")]
    if suspects:
        found = suspects[0]
        return f"computed from {found.op_type} (node {found.name or found.op_type})"
    wide = [n for n in graph.ancestors(name)[1] if _has_int64(graph, list(n.output))]
    if wide:
        found = wide[0]
        return f"computed from int64 {found.op_type} (node {found.name or found.op_type})"
    return f"made by {producer.op_type} (node {producer.name or producer.op_type})"


def _has_int64(graph: "Graph", names: list[str]) -> bool:
    tensors = [graph.tensors.get(name) for name in names]
    return any(tensor is not None and tensor.dtype == "int64" for tensor in tensors)
