"""The build engine ``serial``: runs one task after the other in this process."""

__all__ = ["Serial"]

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar, final

from gsgen.tiles.build.engines.engine import Engine

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


@final
class Serial(Engine):
    """Runs one build task after the other in this process."""

    def __enter__(self) -> "Serial":
        return self

    def __exit__(self, *error: object) -> None: ...

    def run(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Iterator[tuple[int, _Result]]:
        """Run the build tasks in order."""
        for index, task in enumerate(tasks):
            yield index, function(task)
