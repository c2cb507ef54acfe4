"""Opens the build engine that a user names."""

__all__ = ["open_engine"]

from gsgen.contract.errors import UnknownName
from gsgen.contract.process.limits import available_cores
from gsgen.tiles.build.engines.engine import Engine
from gsgen.tiles.build.engines.processes import Processes
from gsgen.tiles.build.engines.serial import Serial


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
        return Serial()
    if kind == "processes":
        return Processes(count)
    if kind == "dask":
        from gsgen.tiles.build.engines.dask_cluster import DaskEngine

        return DaskEngine(address or None, count)
    raise UnknownName.among("engine", name, ("serial", "processes", "dask"), "--engine")
