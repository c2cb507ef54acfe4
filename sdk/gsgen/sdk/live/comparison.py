"""Compares WebGPU outputs with CPU outputs, and replayed frames with uncaptured ones."""

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
    output_origin,
    wrong_outputs,
)
from gsgen.sdk.live.level import Frame, Live, Outputs
from gsgen.sdk.parity import ModelOutput, Parity, Reference, compare

# Of more rows than this, evenly spaced ones are compared.
_MOST_ROWS = 1 << 14
# Companion models declare no tolerances; relative to the largest value of an output.
_TOLERANCE = 2e-3
_EXPECTED = "the CPU's value"


def wrong_replays(live: Live) -> Iterator[WrongReplay]:
    """Yield every output whose frames replayed by graph capture differ from uncaptured frames."""
    graph = live.subject.graph
    pairs = [(f.uncaptured, f.replayed) for f in live.frames if f.uncaptured and f.replayed]
    uncaptured, replayed = ([expected for expected, _ in pairs], [actual for _, actual in pairs])
    yield from wrong_outputs(uncaptured, replayed, lambda name: output_origin(graph, name))


def disagreements(live: Live) -> Iterator[tuple[str, str, str]]:
    """Yield (location, actual, expected) for each output field in which CPU and WebGPU differ."""
    frames = [frame for frame in live.frames if frame.uncaptured is not None]
    packed = _compare_rows(live, frames)
    if packed is not None:
        for field in packed.fields:
            if not field.excess <= 1:
                times = f"{field.excess:.3g} times the tolerance"
                actual = f"off by {field.error:.3g} at row {field.row}, {times} ({field.probe})"
                yield f"field {field.field}", actual, _EXPECTED
    compared = _declared_names(live) if packed is not None else set()
    for name in frames[0].cpu if frames else ():
        if name not in compared:
            yield from _compare_whole(name, frames)


def _compare_rows(live: Live, frames: list[Frame]) -> Parity | None:
    """Compare packed Gaussians of two runs field by field; None for a model without Gaussians."""
    generator = live.subject.generator
    if generator is None:
        return None
    references, gpu_outputs = [], []
    for frame in frames:
        cpu, gpu = (
            _model_outputs(live, frame, outputs) for outputs in (frame.cpu, frame.uncaptured)
        )
        space = cpu.declared.space if cpu.declared else None
        if cpu.gaussians is None or cpu.appearance is None or space is None:
            return None
        if gpu.gaussians is None or gpu.appearance is None:
            return None
        rows, cells = _some_rows(cpu)
        if cells is not None and gpu.cells is None:
            return None
        try:
            expected = layout.decode(cpu.gaussians[rows], cpu.appearance[rows], space)
        except LayoutMismatch:
            return None
        alive = int(np.count_nonzero(rows < cpu.count))
        count = alive if gpu.count == cpu.count else gpu.count
        output = ModelOutput(gpu.gaussians[rows], gpu.appearance[rows], count)
        reference = Reference(frame.probe, expected, alive)
        if cells is not None and cpu.cells is not None and gpu.cells is not None:
            reference = replace(reference, cells=layout.decode_cells(cpu.cells[cells]))
            output = replace(output, cells=gpu.cells[cells])
        references.append(reference)
        gpu_outputs.append(output)
    return compare(references, gpu_outputs, as_tolerances(live.subject), roundings=2)


def _model_outputs(live: Live, frame: Frame, outputs: Outputs | None) -> ModelOutputs:
    probe = frame.probe
    return read_outputs(live.subject, probe.label, dict(outputs or {}), zeros=probe.zeros)


def _some_rows(outputs: ModelOutputs) -> tuple[np.ndarray, np.ndarray | None]:
    """Select the indices of Gaussians, and of groups (cells) of them, to compare; evenly spaced."""
    if outputs.cells is None or outputs.gaussians is None:
        return _even_indices(outputs.count, _MOST_ROWS), None
    per_cell = len(outputs.gaussians) // len(outputs.cells)
    cells = _even_indices(-(-outputs.count // per_cell), max(1, _MOST_ROWS // per_cell))
    return (cells[:, None] * per_cell + np.arange(per_cell)).ravel(), cells


def _even_indices(count: int, most: int) -> np.ndarray:
    """Return a limited number of evenly spaced row indices."""
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


def _compare_whole(name: str, frames: list[Frame]) -> Iterator[tuple[str, str, str]]:
    """Compare one output of two runs as a whole, relative to its largest value."""
    for frame in frames:
        cpu, gpu = np.asarray(frame.cpu[name]), np.asarray((frame.uncaptured or {})[name])
        if not agree(cpu, gpu, _TOLERANCE):
            actual = f"off by {largest_difference(cpu, gpu):.3g} ({frame.probe.label})"
            yield f"output {name}", actual, _EXPECTED
            return
