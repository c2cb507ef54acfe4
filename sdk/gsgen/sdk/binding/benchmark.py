"""How long frames take on each provider, measured in a child process for each.

A driver that crashes takes its own measurement with it and no other.
"""

__all__ = ["Timed", "time_frames"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.limits import Limits

_WORKER = "gsgen.sdk.binding.benchmark_worker"

State = Literal["measured", "unavailable", "failed", "crashed"]


@dataclass(frozen=True, slots=True)
class Timed:
    """What one model costs on one provider.

    Attributes:
        model: The file.
        provider: The execution provider.
        state: ``unavailable``: not here; ``failed``: the model does not run; ``crashed``: the
            process died or took too long.
        why: Why it was not measured; empty where it was.
        facts: The figures, by the names that JSON has; empty where it was not.
    """

    model: str
    provider: str
    state: State
    why: str
    facts: Mapping[str, Any]


def time_frames(
    model: Path,
    provider: str,
    *,
    frames: int = 100,
    sizes: Mapping[str, int] | None = None,
    capture: bool = True,
    seconds: float = 300,
) -> Timed:
    """Run ``model`` on ``provider`` for some frames whose inputs change, and say what it took.

    Args:
        model: The ONNX file.
        provider: ``cpu``, ``webgpu`` or ``cuda``.
        frames: How many frames are measured.
        sizes: Symbol → size of a dimension that the model leaves open.
        capture: Whether frames are captured and replayed where that can be done.
        seconds: Time after which the child is stopped.
    """
    options = {
        "provider": provider,
        "frames": frames,
        "sizes": dict(sizes or {}),
        "capture": capture,
    }
    with execute(model, [], [], Limits(seconds), _WORKER, **options) as execution:
        state, why, facts = _outcome(execution)
        return Timed(str(model), provider, state, why, facts)


def _outcome(execution: Execution) -> tuple[State, str, dict[str, Any]]:
    for event in execution.events:
        if event["event"] == "measured":  # whatever the process did at its end
            return "measured", "", dict(event["facts"])
        if event["event"] == "unavailable":
            return "unavailable", event["message"], {}
        if event["event"] == "failed":
            return "failed", event["message"], {}
    fault = execution.fault
    return "crashed", fault.message if fault else "it ended without a word", {}
