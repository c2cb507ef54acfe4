"""The protocol of build engines, which run tasks, and the error for lost workers."""

__all__ = ["MAX_RETRIES", "Engine", "EngineFailed"]

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Final, Protocol, TypeVar

from gsgen.contract.errors import GsgenError

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

MAX_RETRIES: Final = 5
"""How often a task is tried again after its worker was killed."""


class EngineFailed(GsgenError):
    """Raised if worker processes of a build died repeatedly, or if a cluster disappeared."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Protocol of build engines, which run independent tasks of a tileset build."""

    def run(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Iterator[tuple[int, _Result]]:
        """Run a function on every build task; yield each task's number and result when it is done.

        Raises:
            EngineFailed: A worker died more than ``MAX_RETRIES`` times.
        """
        ...
