"""The protocol of engines, which run the tasks of a build, and the error for lost workers."""

__all__ = ["RETRIES", "Engine", "EngineFailed"]

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Final, Protocol, TypeVar

from gsgen.contract.errors import GsgenError

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

RETRIES: Final = 5
"""How often a task is tried again after its worker was killed."""


class EngineFailed(GsgenError):
    """Workers died again and again, or a cluster went away."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Runs tasks that are independent of each other."""

    def run(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Iterator[tuple[int, _Result]]:
        """Run ``function`` on every task; yield index and result as they are done.

        Raises:
            EngineFailed: A worker died more than ``RETRIES`` times.
        """
        ...
