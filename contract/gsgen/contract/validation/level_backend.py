"""Interface of packages that add the validation levels ``live`` (WebGPU) and ``render`` (images).

This package runs models in ONNX Runtime on the CPU. Another package may register, with its rules,
a backend for a further level: it receives the CPU runs, runs the model its own way, and prepares
the argument of the level's checks. If it cannot run, it raises :class:`LevelUnavailable`.
"""

__all__ = ["LevelBackend", "LevelContext", "LevelUnavailable"]

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.severity import Level


class LevelUnavailable(GsgenError):
    """Raised if a validation level cannot run on this machine; its rules are reported as skipped."""

    @property
    def reason(self) -> str:
        """Why the validation level cannot run: the missing dependency, and how to install it."""
        return f"{self.message}: {self.hint}" if self.hint else self.message


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelContext:
    """The inputs and resources with which the rules of a validation level check one model.

    Attributes:
        context: The argument of the checks of the level's rules.
        items: The number of checked items, such as frames.
        environment: Name → version, device or state, for the report.
        seconds: Wall-clock time of the preparation.
        skipped: Id of a rule that cannot be checked here, although the level ran → the reason.
    """

    context: Any
    items: int = 1
    environment: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    skipped: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LevelBackend:
    """A backend that gives one validation level's rules their input, such as a WebGPU run.

    Attributes:
        level: The level; the scope of its rules has the same name.
        activity: A short text for progress displays.
        prepare: Called once per model with its CPU runs; the context lives as long as the
            ``with`` block. It raises LevelUnavailable where the level cannot run; any other
            exception reports the level's rules as crashed.
    """

    level: Level
    activity: str
    prepare: Callable[[ProbeRuns], AbstractContextManager[LevelContext]]
