"""Runners: how levels beyond our own get what their rules look at.

This package runs models in ONNX Runtime on the CPU. Another one may register, with its rules, a
runner for a further level: it has a model's CPU runs, runs the model its own way, and gives each
check of that level's scope what it found. Where it cannot, it says why.
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
    """A level cannot run here; its rules are reported as skipped, with this as the reason."""

    @property
    def reason(self) -> str:
        """What is missing and how to get it, in one line."""
        return f"{self.message}: {self.hint}" if self.hint else self.message


@dataclass(frozen=True, slots=True)
class LevelContext:
    """What a runner got ready.

    Attributes:
        context: What the checks of the level's rules are called with.
        items: How many things were looked at, such as frames.
        environment: What ran: name → version, device or state, for the report.
        seconds: How long it took.
        unjudged: Id of a rule that cannot be judged here, though the level ran → why.
    """

    context: Any
    items: int = 1
    environment: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    unjudged: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LevelBackend:
    """What prepares one level; registered beside the level's rules.

    Attributes:
        level: The level whose rules it serves; their scope has the level's name.
        activity: What it does, in a few words, for progress displays.
        prepare: Called once a model, with its runs on the CPU. What it gives lives as long as the
            block. It raises LevelUnavailable where the level cannot run here; whatever else it
            raises makes the level's rules crashed ones.
    """

    level: Level
    activity: str
    prepare: Callable[[ProbeRuns], AbstractContextManager[LevelContext]]
