"""Compare what the WebGPU provider gave with the CPU, and replays with plain runs."""

__all__ = ["disagreements", "wrong_replays"]

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsgen.contract.errors import LayoutMismatch
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.spec import layout
from gsgen.contract.validation.tolerances import as_tolerances
from gsgen.sdk.binding.replay_check import (
    WrongReplay,
    agree,
    largest_difference,
    maker,
    wrong_outputs,
)
from gsgen.sdk.live.level import Frame, Live, Outputs
from gsgen.sdk.parity import ModelOutput, Parity, Reference, compare

# Rows beyond this many are compared at even distances.
_MOST_ROWS = 1 << 14
# Companion models declare no tolerances; relative to the largest value of an output.
_TOLERANCE = 2e-3


def wrong_replays(live: Live) -> Iterator[WrongReplay]:
    """Yield every output that replays wrongly, those that no manifest declares included."""
    graph = live.subject.graph
    pairs = [(f.plain, f.replayed) for f in live.frames if f.plain and f.replayed]
    plain, replayed = [one for one, _ in pairs], [other for _, other in pairs]
    yield from wrong_outputs(plain, replayed, lambda name: maker(graph, name))


def disagreements(live: Live) -> Iterator[tuple[str, str, str]]:
    """Yield (place, what was seen, what was wanted) wherever CPU and GPU differ too much."""
    frames = [frame for frame in live.frames if frame.plain is not None]
    packed = _packed(live, frames)
    if packed is not None:
        for field in packed.fields:
            if not field.excess <= 1:
                times = f"{field.excess:.3g} times what is allowed"
                actual = (
                    f"off by {field.error:.3g} at row {field.row}, {times} ({field.probe})"
                )
                yield f"field {field.field}", actual, "what the CPU gives"
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
        rows, cells = _some_rows(cpu)
        if cells is not None and gpu.cells is None:
            return None
        try:
            wanted = layout.decode(cpu.gaussians[rows], cpu.appearance[rows], space)
        except LayoutMismatch:
            return None
        alive = int(np.count_nonzero(rows < cpu.count))
        count = alive if gpu.count == cpu.count else gpu.count
        made = ModelOutput(gpu.gaussians[rows], gpu.appearance[rows], count)
        known = Reference(frame.probe, wanted, alive)
        if cells is not None and cpu.cells is not None and gpu.cells is not None:
            known = replace(known, cells=layout.decode_cells(cpu.cells[cells]))
            made = replace(made, cells=gpu.cells[cells])
        references.append(known)
        outputs.append(made)
    return compare(references, outputs, as_tolerances(live.subject), roundings=2)


def _emission(live: Live, frame: Frame, outputs: Outputs | None) -> ModelOutputs:
    probe = frame.probe
    return read_outputs(live.subject, probe.label, probe.zeros, dict(outputs or {}))


def _some_rows(emission: ModelOutputs) -> tuple[np.ndarray, np.ndarray | None]:
    """Return which rows to compare, and which cells; of cells, all rows, in order."""
    if emission.cells is None or emission.gaussians is None:
        return _spread(emission.count, _MOST_ROWS), None
    per_cell = len(emission.gaussians) // len(emission.cells)
    cells = _spread(-(-emission.count // per_cell), max(1, _MOST_ROWS // per_cell))
    return (cells[:, None] * per_cell + np.arange(per_cell)).ravel(), cells


def _spread(count: int, most: int) -> np.ndarray:
    """Return numbers below ``count``, at even distances where they are more than ``most``."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.int64)


def _declared_names(live: Live) -> set[str]:
    parts = (
        live.subject.declared_gaussians,
        live.subject.declared_appearance,
        live.subject.declared_count,
        live.subject.declared_cells,
    )
    return {part.name for part in parts if part is not None}


def _loose(name: str, frames: list[Frame]) -> Iterator[tuple[str, str, str]]:
    """Compare one output as a whole, in the scale of its largest value."""
    for frame in frames:
        cpu, gpu = np.asarray(frame.cpu[name]), np.asarray((frame.plain or {})[name])
        if not agree(cpu, gpu, _TOLERANCE):
            actual = f"off by {largest_difference(cpu, gpu):.3g} ({frame.probe.label})"
            yield f"output {name}", actual, "what the CPU gives"
            return
