"""Validation level ``live``: runs a model in WebGPU as viewers do, captured and replayed.

The model runs in a child process (:mod:`gsgen.sdk.live.worker`), on a GPU or a software driver.
Each frame is computed without capture and by a session that replays captured commands. Inputs
change from frame to frame; the CPU's outputs for them are already known.
"""

__all__ = ["EarlyStop", "Frame", "LiveLevel", "Node", "prepare_live", "survey"]

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.validation.level_backend import LevelContext, LevelUnavailable
from gsgen.sdk.binding.providers.node_placement import Node
from gsgen.sdk.binding.providers.webgpu import PACKAGE

_WORKER = "gsgen.sdk.live.worker"
# Frames: the first is captured, the others are replayed.
_FRAME_COUNT, _STATIC_FRAME_COUNT = 6, 4

Outputs = Mapping[str, np.ndarray]
Event = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class EarlyStop:
    """The reason why a model's WebGPU session ended before the last frame."""

    phase: str  # ``plain`` or ``captured``
    frame: int  # number of the frame; -1 during the creation of the session
    message: str  # ONNX Runtime's message, or how the process ended


@dataclass(frozen=True, slots=True)
class Frame:
    """The outputs of one frame on the CPU, in WebGPU, and in WebGPU by replay of a capture.

    Attributes:
        probe: The inputs.
        cpu: The CPU's outputs that the manifest declares.
        uncaptured: The WebGPU provider's outputs without capture, if it ran.
        replayed: The outputs of a capturing session, if it ran.
    """

    probe: Probe
    cpu: Outputs
    uncaptured: Outputs | None
    replayed: Outputs | None


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveLevel:
    """The results of running a model in ONNX Runtime's WebGPU provider."""

    subject: InspectedModel
    adapter: str  # the adapter that it ran on
    # execution provider of each node without capture; None without a session
    nodes: tuple[Node, ...] | None
    is_capture_accepted: bool  # whether ONNX Runtime accepted to capture the model
    stop: EarlyStop | None  # the reason for an early end, if any
    frames: tuple[Frame, ...]  # all frames; the first one was captured, the others were replayed

    @property
    def refusal(self) -> str:
        """Why ONNX Runtime refused to capture the model's graph; empty if it did not."""
        stop = self.stop
        has_worker_ended_early = (
            stop is not None and stop.phase == "captured" and not self.is_capture_accepted
        )
        return stop.message if stop is not None and has_worker_ended_early else ""

    @property
    def state(self) -> str:
        """The result of the graph capture as one line of text."""
        if self.is_capture_accepted:
            replayed = sum(frame.replayed is not None for frame in self.frames)
            return f"accepted, {max(replayed - 1, 0)} replays"
        return f"refused: {self.refusal}" if self.refusal else "not tried"


@contextmanager
def prepare_live(probe_runs: ProbeRuns) -> Iterator[LevelContext]:
    """Run a model in WebGPU; the returned arrays are valid within the ``with`` block."""
    _require_package()
    runs = _select_runs(probe_runs)
    subject, probes = probe_runs.subject, [probe_runs.plan.probes[run] for run in runs]
    half = any(tensor.dtype == "float16" for tensor in subject.graph.tensors.values())
    path, limits = subject.file.path, subject.sandbox_limits
    with execute(path, [], probes, limits, _WORKER, has_gpu=True, half=half) as execution:
        _raise_if_unavailable(execution)
        live = _read(probe_runs, execution, runs)
        yield LevelContext(
            context=live,
            items=len(live.frames),
            environment=_environment(execution.events) | {"capture": live.state},
            seconds=execution.seconds,
        )


def survey(seconds: float = 60) -> dict[str, str]:
    """Start a child process that reports the versions and adapter of the WebGPU provider."""
    _require_package()
    with execute(
        Path(), [], [], Limits(seconds=seconds), _WORKER, has_gpu=True, half=False
    ) as execution:
        _raise_if_unavailable(execution)
        return _environment(execution.events)


def _require_package() -> None:
    if find_spec(PACKAGE) is None:
        message = "onnxruntime-ep-webgpu is not installed"
        raise LevelUnavailable(message, hint="pip install 'gsgen[live]'")


def _select_runs(probe_runs: ProbeRuns) -> list[int]:
    """Select runs of a model with different inputs; the last run repeats the first."""
    plan = probe_runs.plan
    runs = [run for run in range(plan.values) if not plan.probes[run].zeros]
    zeros = [run for run in range(plan.values) if plan.probes[run].zeros]
    if plan.values == 1:
        return [0] * _STATIC_FRAME_COUNT
    run_indices = (
        np.linspace(0, len(runs) - 1, min(len(runs), _FRAME_COUNT - 1)).round().astype(int)
    )
    selected_runs = [runs[index] for index in run_indices]
    return [*selected_runs, *zeros, selected_runs[0]]


def _raise_if_unavailable(execution: Execution) -> None:
    """Raise if the child process could not run the model in WebGPU, or not in time.

    How long a run takes depends on the machine and on its load, so it is not a fault of the model.
    """
    for event in execution.events:
        if event["event"] == "fell-back":
            raise RuntimeError(f"ONNX Runtime fell back to the CPU: {event['message']}")
        if event["event"] == "unavailable":
            raise LevelUnavailable(event["message"], hint=event["hint"])
    if execution.fault is not None and execution.fault.stage == "time":
        message = f"not checked: out of time, {execution.fault.message}"
        raise LevelUnavailable(message, hint="give more with --timeout")
    has_adapter = any(event["event"] == "adapter" for event in execution.events)
    if not has_adapter and execution.fault is not None:
        message = f"the WebGPU provider does not start ({execution.fault.message})"
        raise LevelUnavailable(message, hint="run `gsgen doctor`")


def _environment(events: tuple[Event, ...]) -> dict[str, str]:
    versions = {"adapter": _adapter_name(events)}
    for event in events:
        if event["event"] == "device":
            versions["onnxruntime-ep-webgpu"] = str(event["version"])
    return versions


def _adapter_name(events: tuple[Event, ...]) -> str:
    """Return a GPU's name, kind and float16 support, as text."""
    device = next(
        (device_event["name"] for device_event in events if device_event["event"] == "device"), ""
    )
    for event in events:
        if event["event"] == "adapter":
            kind = "software" if event["software"] else "hardware"
            half = "with float16" if event["half"] else "without float16"
            return f"{event['name'] or device} ({kind}, {half})"
    return str(device)


def _read(probe_runs: ProbeRuns, execution: Execution, runs: list[int]) -> LiveLevel:
    events = execution.events
    samples = {sample.index: sample.outputs for sample in execution.samples}
    outputs = {
        (event["phase"], event["frame"]): samples[event["sample"]]
        for event in events
        if event["event"] == "frame"
    }
    cpu = probe_runs.execution
    frames = tuple(
        Frame(
            probe_runs.plan.probes[run],
            cpu.samples[cpu.runs[run].sample].outputs,
            outputs.get(("plain", index)),
            outputs.get(("captured", index)),
        )
        for index, run in enumerate(runs)
    )
    placed_nodes = next((event["nodes"] for event in events if event["event"] == "placed"), None)
    return LiveLevel(
        subject=probe_runs.subject,
        adapter=_adapter_name(events),
        nodes=None if placed_nodes is None else tuple(Node(*entry) for entry in placed_nodes),
        is_capture_accepted=any(event["event"] == "accepted" for event in events),
        stop=_find_early_stop(execution),
        frames=frames,
    )


def _find_early_stop(execution: Execution) -> EarlyStop | None:
    for event in execution.events:
        if event["event"] == "stopped":
            return EarlyStop(event["phase"], event["frame"], event["message"])
    if execution.fault is None:
        return None
    begin_events = [event for event in execution.events if event["event"] == "begin"]
    phase = begin_events[-1]["phase"] if begin_events else "plain"
    return EarlyStop(phase, execution.fault.probe or 0, execution.fault.message)
