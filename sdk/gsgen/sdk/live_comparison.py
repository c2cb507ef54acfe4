"""Compare what the WebGPU provider gave with the CPU, and replays with plain runs."""

__all__ = ["WrongReplay", "disagreements", "wrong_replays"]

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gsgen.contract import layout
from gsgen.contract.emission import Emission, read_emission
from gsgen.contract.errors import LayoutMismatch
from gsgen.contract.graph import Graph
from gsgen.contract.manifest import Tolerances
from gsgen.sdk.live import Frame, Live, Outputs
from gsgen.sdk.parity import Parity, Reference, compare

# Rows beyond this many are compared at even distances.
_MOST_ROWS = 1 << 14
# Companion models declare no tolerances; relative to the largest value of an output.
_TOLERANCE = 2e-3
# Two sessions on one adapter run the same kernels, so they agree to the last bits.
_SAME = {"float32": 1e-5, "float16": 2e-3}
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
    """An output whose replays are not what a plain session computes.

    Attributes:
        place: The output.
        saw: How its replays differ, and which operator made it.
    """

    place: str
    saw: str


def wrong_replays(live: Live) -> Iterator[WrongReplay]:
    """Yield every output that replays wrongly, those that no manifest declares included."""
    pairs = [(f.plain, f.replayed) for f in live.frames if f.plain and f.replayed]
    graph = live.subject.graph
    for name in pairs[0][0] if pairs else ():
        plain = [np.asarray(a[name]) for a, _ in pairs if a]
        replayed = [np.asarray(b[name]) for _, b in pairs if b]
        wrong = [k for k in range(len(plain)) if not _agree(plain[k], replayed[k])]
        if not wrong:
            continue
        changing = any(not _same_bits(one, plain[0]) for one in plain)
        still = all(_same_bits(one, replayed[0]) for one in replayed)
        if changing and still and not _same_bits_nowhere(plain[0], replayed[0]):
            how = f"repeats frame 0 in all {len(replayed) - 1} replays"
        else:
            how = (
                f"{len(wrong)} of {len(plain)} frames differ, the first is frame {wrong[0]}"
            )
        yield WrongReplay(f"output {name}", f"{how}; {_maker(graph, name)}")


def disagreements(live: Live) -> Iterator[tuple[str, str, str]]:
    """Yield (place, what was seen, what was wanted) wherever CPU and GPU differ too much."""
    frames = [frame for frame in live.frames if frame.plain is not None]
    packed = _packed(live, frames)
    if packed is not None:
        for field in packed.fields:
            if not field.excess <= 1:
                times = f"{field.excess:.3g} times what is allowed"
                saw = (
                    f"off by {field.error:.3g} at row {field.row}, {times} ({field.probe})"
                )
                yield f"field {field.field}", saw, "what the CPU gives"
    judged = _declared_names(live) if packed is not None else set()
    for name in frames[0].cpu if frames else ():
        if name not in judged:
            yield from _loose(name, frames)


def _packed(live: Live, frames: list[Frame]) -> Parity | None:
    """Compare packed rows field by field; None where the model does not give them."""
    generator = live.subject.generator
    if generator is None:
        return None
    references, outputs = [], []
    for frame in frames:
        cpu, gpu = (_emission(live, frame, one) for one in (frame.cpu, frame.plain))
        space = cpu.declared.space if cpu.declared else None
        if cpu.gaussians is None or cpu.appearance is None or space is None:
            return None
        if gpu.gaussians is None or gpu.appearance is None:
            return None
        rows = _some_rows(cpu.count)
        try:
            wanted = layout.decode(cpu.gaussians[rows], cpu.appearance[rows], space)
        except LayoutMismatch:
            return None
        count = len(rows) if gpu.count == cpu.count else gpu.count
        references.append(Reference(frame.probe, wanted, len(rows)))
        outputs.append((gpu.gaussians[rows], gpu.appearance[rows], count))
    return compare(references, outputs, generator.tolerances or Tolerances(), roundings=2)


def _emission(live: Live, frame: Frame, outputs: Outputs | None) -> Emission:
    probe = frame.probe
    return read_emission(live.subject, probe.label, probe.zeros, dict(outputs or {}))


def _some_rows(count: int) -> np.ndarray:
    if count <= _MOST_ROWS:
        return np.arange(count)
    return np.linspace(0, count - 1, _MOST_ROWS).astype(np.int64)


def _declared_names(live: Live) -> set[str]:
    parts = (
        live.subject.declared_gaussians,
        live.subject.declared_appearance,
        live.subject.declared_count,
    )
    return {part.name for part in parts if part is not None}


def _loose(name: str, frames: list[Frame]) -> Iterator[tuple[str, str, str]]:
    """Compare one output as a whole, in the scale of its largest value."""
    for frame in frames:
        cpu, gpu = np.asarray(frame.cpu[name]), np.asarray((frame.plain or {})[name])
        if not _agree(cpu, gpu, _TOLERANCE):
            saw = f"off by {_largest(cpu, gpu):.3g} ({frame.probe.label})"
            yield f"output {name}", saw, "what the CPU gives"
            return


def _agree(a: np.ndarray, b: np.ndarray, tolerance: float | None = None) -> bool:
    """Say whether two arrays agree; where ``a`` is not finite, anything does."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return False
    if _same_bits(a, b):
        return True
    if a.dtype.kind != "f":
        return False
    allowed = _SAME[a.dtype.name] if tolerance is None else tolerance
    finite = np.abs(a[np.isfinite(a)].astype(np.float64))
    return bool(_largest(a, b) <= allowed * finite.max(initial=0.0))


def _largest(a: np.ndarray, b: np.ndarray) -> float:
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


def _same_bits_nowhere(a: np.ndarray, b: np.ndarray) -> bool:
    """Say whether the very first frame is wrong already: then nothing was right to repeat."""
    return not _agree(a, b)


def _maker(graph: Graph, name: str) -> str:
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


def _has_int64(graph: Graph, names: list[str]) -> bool:
    tensors = [graph.tensors.get(name) for name in names]
    return any(tensor is not None and tensor.dtype == "int64" for tensor in tensors)
