"""Opens the build engine that a user names; ``serial`` runs one task after the other."""

__all__ = ["SerialEngine", "open_engine"]

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar, final

from gsgen.contract.errors import UnknownName
from gsgen.contract.process.limits import available_cores
from gsgen.tiles.build.engines.engine import Engine
from gsgen.tiles.build.engines.processes import Processes

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


@final
class SerialEngine(Engine):
    """Runs one build task after the other in this process."""

    def __enter__(self) -> "SerialEngine":
        return self

    def __exit__(self, *error: object) -> None: ...

    def run(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Iterator[tuple[int, _Result]]:
        """Run the build tasks in order."""
        for index, task in enumerate(tasks):
            yield index, function(task)


def open_engine(name: str, workers: int | None = None) -> Engine:
    """Return the engine that runs a tileset's build tasks, as a context manager.

    Args:
        name: ``serial``, ``processes``, ``dask`` (a local cluster) or ``dask=ADDRESS``.
        workers: Processes; as many as there are processor cores where absent.

    Raises:
        ConfigInvalid: The name is unknown, or the engine is not installed.
    """
    count = workers or available_cores()
    kind, _, address = name.partition("=")
    if kind == "serial":
        return SerialEngine()
    if kind == "processes":
        return Processes(count)
    if kind == "dask":
        from gsgen.tiles.build.engines.dask_cluster import DaskEngine

        return DaskEngine(address or None, count)
    raise UnknownName.among("engine", name, ("serial", "processes", "dask"), "--engine")
