"""Run a model as a viewer does: in ONNX Runtime's WebGPU provider, captured once and replayed.

The model runs in a child process (:mod:`gsgen.sdk.live.worker`), on a GPU or on a software driver.
Each frame is computed by a plain session and by one that replays captured commands, with inputs
that change from frame to frame; the CPU's outputs for the same inputs are known already.
"""

__all__ = ["Frame", "Live", "Node", "Stop", "prepare_live", "survey"]

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
_FRAMES, _STILL_FRAMES = 6, 4

Outputs = Mapping[str, np.ndarray]
Event = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Stop:
    """Why a session ended before the last frame.

    Attributes:
        phase: ``plain`` or ``captured``.
        frame: Number of the frame; -1 while the session was being made.
        message: ONNX Runtime's words, or how the process ended.
    """

    phase: str
    frame: int
    message: str


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame, computed three ways.

    Attributes:
        probe: Its inputs.
        cpu: What the CPU gave: the outputs that the manifest declares.
        plain: What the WebGPU provider gave, or None.
        replayed: What a captured session gave, or None.
    """

    probe: Probe
    cpu: Outputs
    plain: Outputs | None
    replayed: Outputs | None


@dataclass(frozen=True, slots=True)
class Live:
    """What became of a model in the WebGPU provider.

    Attributes:
        subject: The model.
        adapter: What it ran on.
        nodes: Where every node of the plain session went; None where there was no session.
        accepted: ONNX Runtime agreed to capture the model.
        stop: What ended the run early, if anything did.
        frames: The first is the one that was captured.
    """

    subject: InspectedModel
    adapter: str
    nodes: tuple[Node, ...] | None
    accepted: bool
    stop: Stop | None
    frames: tuple[Frame, ...]

    @property
    def refusal(self) -> str:
        """Why ONNX Runtime would not capture the model; empty if it did not say no."""
        stop = self.stop
        early = stop is not None and stop.phase == "captured" and not self.accepted
        return stop.message if stop is not None and early else ""

    @property
    def state(self) -> str:
        """What became of the capture, in one line."""
        if self.accepted:
            done = sum(frame.replayed is not None for frame in self.frames)
            return f"accepted, {max(done - 1, 0)} replays"
        return f"refused: {self.refusal}" if self.refusal else "not tried"


@contextmanager
def prepare_live(trial: ProbeRuns) -> Iterator[LevelContext]:
    """Run the model of ``trial`` live; the arrays live as long as the block.

    Raises:
        LevelUnavailable: A package, a driver or a feature of the adapter is missing here.
        RuntimeError: ONNX Runtime fell back to the CPU without saying so.
    """
    _need_package()
    runs = _chosen_runs(trial)
    subject, probes = trial.subject, [trial.plan.probes[run] for run in runs]
    half = any(tensor.dtype == "float16" for tensor in subject.graph.tensors.values())
    path, limits = subject.file.path, subject.granted
    with execute(path, [], probes, limits, _WORKER, half=half) as execution:
        _refuse(execution)
        live = _read(trial, execution, runs)
        yield LevelContext(
            context=live,
            items=len(live.frames),
            environment=_environment(execution.events) | {"capture": live.state},
            seconds=execution.seconds,
        )


def survey(seconds: float = 60) -> dict[str, str]:
    """Return what is here to run WebGPU with: versions, and which adapter; in a child process.

    Raises:
        LevelUnavailable: A package or a driver is missing.
    """
    _need_package()
    with execute(Path(), [], [], Limits(seconds=seconds), _WORKER, half=False) as execution:
        _refuse(execution)
        return _environment(execution.events)


def _need_package() -> None:
    if find_spec(PACKAGE) is None:
        what = "onnxruntime-ep-webgpu is not installed"
        raise LevelUnavailable(what, hint="pip install 'gsgen[live]'")


def _chosen_runs(trial: ProbeRuns) -> list[int]:
    """Choose runs whose inputs differ, and at the end the first again."""
    plan = trial.plan
    runs = [run for run in range(plan.values) if not plan.probes[run].zeros]
    zeros = [run for run in range(plan.values) if plan.probes[run].zeros]
    if plan.values == 1:
        return [0] * _STILL_FRAMES
    spread = np.linspace(0, len(runs) - 1, min(len(runs), _FRAMES - 1)).round().astype(int)
    chosen = [runs[index] for index in spread]
    return [*chosen, *zeros, chosen[0]]


def _refuse(execution: Execution) -> None:
    """Raise where the child never got to the model."""
    for event in execution.events:
        if event["event"] == "fell-back":
            raise RuntimeError(f"ONNX Runtime fell back to the CPU: {event['message']}")
        if event["event"] == "unavailable":
            raise LevelUnavailable(event["message"], hint=event["hint"])
    ready = any(event["event"] == "adapter" for event in execution.events)
    if not ready and execution.fault is not None:
        what = f"the WebGPU provider does not start ({execution.fault.message})"
        raise LevelUnavailable(what, hint="ask `gsgen doctor`")


def _environment(events: tuple[Event, ...]) -> dict[str, str]:
    known = {"adapter": _adapter(events)}
    for event in events:
        if event["event"] == "device":
            known["onnxruntime-ep-webgpu"] = str(event["version"])
    return known


def _adapter(events: tuple[Event, ...]) -> str:
    """Return the name of the adapter and what is to be known of it."""
    device = next((e["name"] for e in events if e["event"] == "device"), "")
    for event in events:
        if event["event"] == "adapter":
            kind = "software" if event["software"] else "hardware"
            half = "with float16" if event["half"] else "without float16"
            return f"{event['name'] or device} ({kind}, {half})"
    return str(device)


def _read(trial: ProbeRuns, execution: Execution, runs: list[int]) -> Live:
    events = execution.events
    samples = {sample.index: sample.outputs for sample in execution.samples}
    given = {
        (event["phase"], event["frame"]): samples[event["sample"]]
        for event in events
        if event["event"] == "frame"
    }
    cpu = trial.execution
    frames = tuple(
        Frame(
            trial.plan.probes[run],
            cpu.samples[cpu.runs[run].sample].outputs,
            given.get(("plain", index)),
            given.get(("captured", index)),
        )
        for index, run in enumerate(runs)
    )
    placed = next((event["nodes"] for event in events if event["event"] == "placed"), None)
    return Live(
        subject=trial.subject,
        adapter=_adapter(events),
        nodes=None if placed is None else tuple(Node(*entry) for entry in placed),
        accepted=any(event["event"] == "accepted" for event in events),
        stop=_stop(execution),
        frames=frames,
    )


def _stop(execution: Execution) -> Stop | None:
    for event in execution.events:
        if event["event"] == "stopped":
            return Stop(event["phase"], event["frame"], event["message"])
    if execution.fault is None:
        return None
    begun = [event for event in execution.events if event["event"] == "begin"]
    phase = begun[-1]["phase"] if begun else "plain"
    return Stop(phase, execution.fault.probe or 0, execution.fault.message)
