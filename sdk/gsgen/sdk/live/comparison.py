"""Compares WebGPU outputs with CPU outputs, and replayed frames with uncaptured ones."""

__all__ = ["disagreements", "wrong_replays"]

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.validation.agreement import FieldError, comparable_parts, field_errors
from gsgen.contract.validation.report import Tolerance
from gsgen.contract.validation.tolerances import effective_tolerances
from gsgen.sdk.binding.bound.replay_check import (
    ReplayMismatch,
    arrays_agree,
    largest_difference,
    output_origin,
    wrong_outputs,
)
from gsgen.sdk.live.level import Frame, LiveLevel, Outputs

# Of more rows than this, evenly spaced ones are compared.
_MAX_ROWS = 1 << 14
# Companion models declare no tolerances; relative to the largest value of an output.
_TOLERANCE = 2e-3
_EXPECTED_TEXT = "the CPU's value"


def wrong_replays(live: LiveLevel) -> Iterator[ReplayMismatch]:
    """Yield every output whose frames replayed by graph capture differ from uncaptured frames."""
    graph = live.subject.graph
    pairs = [(f.uncaptured, f.replayed) for f in live.frames if f.uncaptured and f.replayed]
    uncaptured, replayed = ([expected for expected, _ in pairs], [actual for _, actual in pairs])
    yield from wrong_outputs(uncaptured, replayed, lambda name: output_origin(graph, name))


def disagreements(live: LiveLevel) -> Iterator[tuple[str, str, str]]:
    """Yield (location, actual, expected) for each output field in which CPU and WebGPU differ."""
    frames = [frame for frame in live.frames if frame.uncaptured is not None]
    pairs = [_compared_rows(live, frame) for frame in frames]
    packed = [pair for pair in pairs if pair is not None]
    if len(packed) < len(pairs) or live.subject.generator is None:
        packed = []
    for error in _worst_errors(packed, effective_tolerances(live.subject)):
        times = f"{error.excess:.3g} times the tolerance"
        actual = f"off by {error.error:.3g} at row {error.row}, {times} ({error.probe})"
        yield f"field {error.field}", actual, _EXPECTED_TEXT
    compared = _declared_names(live) if packed else set()
    for name in frames[0].cpu if frames else ():
        if name not in compared:
            yield from _compare_output(name, frames)


def _worst_errors(
    pairs: list[tuple[ModelOutputs, ModelOutputs]], tolerances: Sequence[Tolerance]
) -> Iterable[FieldError]:
    """Return the largest excess of each field in which packed rows of two providers differ."""
    worst_errors: dict[str, FieldError] = {}
    for cpu, gpu in pairs:
        if cpu.count == gpu.count:
            errors = list(field_errors(cpu, gpu, tolerances))
        else:
            count_difference = float(abs(cpu.count - gpu.count))
            errors = [
                FieldError(field="count", error=count_difference, excess=np.inf, probe=cpu.probe)
            ]
        for error in errors:
            if error.field not in worst_errors or error.excess > worst_errors[error.field].excess:
                worst_errors[error.field] = error
    return worst_errors.values()


def _compared_rows(live: LiveLevel, frame: Frame) -> tuple[ModelOutputs, ModelOutputs] | None:
    """Return some rows of both providers; None without packed rows, colours and cells in both."""
    cpu, gpu = (_model_outputs(live, frame, outputs) for outputs in (frame.cpu, frame.uncaptured))
    rows, colors, cells = comparable_parts(cpu, gpu)
    if rows is None or colors is None or (cells is None) != (cpu.cells is None):
        return None
    row_numbers, cell_numbers = _sampled_rows(cpu)
    live_rows = int(np.count_nonzero(row_numbers < cpu.count))
    cpu_rows, gpu_rows = (
        replace(
            outputs,
            gaussians=rows[provider_index][row_numbers],
            appearance=colors[provider_index][row_numbers],
            cells=None if cells is None else cells[provider_index][cell_numbers],
            count=live_rows if outputs.count == cpu.count else outputs.count,
        )
        for provider_index, outputs in enumerate((cpu, gpu))
    )
    return cpu_rows, gpu_rows


def _model_outputs(live: LiveLevel, frame: Frame, outputs: Outputs | None) -> ModelOutputs:
    probe = frame.probe
    return read_outputs(live.subject, probe.label, dict(outputs or {}), zeros=probe.zeros)


def _sampled_rows(outputs: ModelOutputs) -> tuple[np.ndarray, np.ndarray | None]:
    """Select the indices of Gaussians, and of groups (cells) of them, to compare; evenly spaced."""
    if outputs.cells is None or outputs.gaussians is None:
        return _evenly_spaced_indices(outputs.count, _MAX_ROWS), None
    per_cell = len(outputs.gaussians) // len(outputs.cells)
    cells = _evenly_spaced_indices(-(-outputs.count // per_cell), max(1, _MAX_ROWS // per_cell))
    return (cells[:, None] * per_cell + np.arange(per_cell)).ravel(), cells


def _evenly_spaced_indices(count: int, most: int) -> np.ndarray:
    """Return a limited number of evenly spaced row indices."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.int64)


def _declared_names(live: LiveLevel) -> set[str]:
    parts = (
        live.subject.declared_gaussians,
        live.subject.declared_appearance,
        live.subject.declared_count,
        live.subject.declared_cells,
    )
    return {part.name for part in parts if part is not None}


def _compare_output(name: str, frames: list[Frame]) -> Iterator[tuple[str, str, str]]:
    """Compare one output of two runs as a whole, relative to its largest value."""
    for frame in frames:
        cpu, gpu = np.asarray(frame.cpu[name]), np.asarray((frame.uncaptured or {})[name])
        if not arrays_agree(cpu, gpu, _TOLERANCE):
            actual = f"off by {largest_difference(cpu, gpu):.3g} ({frame.probe.label})"
            yield f"output {name}", actual, _EXPECTED_TEXT
            return
