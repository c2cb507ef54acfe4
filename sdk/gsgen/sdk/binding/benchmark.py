"""Measures the frame time of a model on an execution provider, in a child process.

If a driver crashes, only the measurement on its provider is lost.
"""

__all__ = ["BenchmarkResult", "time_frames"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.limits import Limits

_WORKER = "gsgen.sdk.binding.benchmark_worker"

BenchmarkState = Literal["measured", "unavailable", "failed", "crashed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkResult:
    """The measured frame time and memory of one model on one execution provider.

    Attributes:
        model: The model file.
        provider: The execution provider.
        state: ``unavailable``: the provider is not installed or has no device; ``failed``: the
            model does not run; ``crashed``: the process died or took too long.
        reason: The reason why it was not measured; empty if it was.
        facts: The figures by their JSON names; empty if it was not measured.
    """

    model: str
    provider: str
    state: BenchmarkState
    reason: str
    facts: Mapping[str, Any]


def time_frames(
    model: Path,
    provider: str,
    *,
    frames: int = 100,
    sizes: Mapping[str, int] | None = None,
    capture: bool = True,
    limits: Limits | None = None,
    trusted: bool = False,
) -> BenchmarkResult:
    """Run a model on an execution provider for many frames, and return the measured frame times.

    Args:
        model: The ONNX file.
        provider: ``cpu``, ``webgpu`` or ``cuda``.
        frames: Number of measured frames.
        sizes: Symbol → size of a dimension that the model leaves open.
        capture: Capture and replay frames if model and provider allow it.
        limits: Time and memory of the child process; None for five minutes and the usual memory.
        trusted: Do not confine the child process, whose time alone is limited.
    """
    limits = (limits or Limits(seconds=300)).for_model(open_model(model).weight_bytes)
    options: dict[str, Any] = {
        "provider": provider,
        "frames": frames,
        "sizes": dict(sizes or {}),
        "capture": capture,
    }
    with execute(
        model, [], [], limits, _WORKER, has_gpu=provider != "cpu", trusted=trusted, **options
    ) as execution:
        state, reason, facts = _benchmark_outcome(execution)
        return BenchmarkResult(
            model=str(model), provider=provider, state=state, reason=reason, facts=facts
        )


def _benchmark_outcome(execution: Execution) -> tuple[BenchmarkState, str, dict[str, Any]]:
    for event in execution.events:
        if event["event"] == "measured":  # a crash at the end of the process does not matter
            return "measured", "", dict(event["facts"])
        if event["event"] == "unavailable":
            return "unavailable", event["message"], {}
        if event["event"] == "failed":
            return "failed", event["message"], {}
    fault = execution.fault
    return "crashed", fault.message if fault else "it ended without a result", {}
