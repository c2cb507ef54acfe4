"""The build engine ``dask``: runs tasks on a Dask cluster, local or remote.

Futures alone: the shuffle is files, and neither DataFrames nor their peer-to-peer shuffle, which
loses rows when a worker dies (dask/distributed#8426), take part.
"""

__all__ = ["DaskEngine"]

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any, Final, TypeVar, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.parent_watchdog import safe_multiprocessing
from gsgen.tiles.build.engines.engine import MAX_RETRIES, Engine, EngineFailed

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

_START_SECONDS = 20
_DASK_SETTINGS: Final = {
    # A worker may die for reasons other than the task that it ran.
    "distributed.scheduler.allowed-failures": MAX_RETRIES,
    # Profiles, which take a stack sample every 10 ms, are not used.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    # Dask's own setting makes every array a mapping of its own: a page fault for each 4 KB of
    # it, four times the time of simple arithmetic. These are what glibc adapts to by itself.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 64 << 20,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 << 20,
    "distributed.nanny.pre-spawn-environ.MALLOC_ARENA_MAX": 1,
    "distributed.admin.tick.interval": "500ms",
}


@final
class DaskEngine(Engine):
    """Runs tasks on a Dask cluster; a task of a killed worker is run again on another worker.

    Args:
        address: Of a scheduler; None starts a cluster on this machine. Workers have to see the
            scenes and the output folder under the same paths.
        workers: Processes of the local cluster.

    Raises:
        ConfigInvalid: The package ``distributed`` is not installed.
    """

    def __init__(self, address: str | None, workers: int) -> None:
        try:
            import distributed
        except ImportError as error:
            raise ConfigInvalid(
                f"the engine dask needs {error.name or 'distributed'}, which is not installed",
                where="--engine",
                hint="pip install 'gsgen[cluster]'",
            ) from error
        self._dask_distributed: Any = distributed
        self._scheduler_address, self._workers = address, workers
        self._client: Any = None
        self._cluster: Any = None
        self._environment = ExitStack()

    def __enter__(self) -> "DaskEngine":
        """Connect to the Dask cluster, or start a local one.

        Raises:
            EngineFailed: No scheduler answers at the address.
        """
        import dask

        dask.config.set(_DASK_SETTINGS)
        self._environment.enter_context(safe_multiprocessing())
        try:
            if self._scheduler_address is None:
                self._cluster = self._dask_distributed.LocalCluster(
                    n_workers=self._workers,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    silence_logs="CRITICAL",
                )
            self._client = self._dask_distributed.Client(
                self._cluster or self._scheduler_address,
                timeout=_START_SECONDS,
                set_as_default=False,
            )
        except (OSError, TimeoutError, ValueError) as error:
            raise EngineFailed(
                f"no Dask scheduler can be used: {error}",
                where=f"dask={self._scheduler_address or ''}",
                hint="Start one: `dask scheduler`, then `dask worker ADDRESS`.",
            ) from error
        return self

    def __exit__(self, *error: object) -> None:
        if self._client is not None:
            self._client.close()
        if self._cluster is not None:
            self._cluster.close()
        self._environment.close()

    def run(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Iterator[tuple[int, _Result]]:
        """Run build tasks on the workers of the Dask cluster."""
        futures = [
            self._client.submit(function, task, pure=False, retries=MAX_RETRIES) for task in tasks
        ]
        index = {future.key: number for number, future in enumerate(futures)}
        try:
            for future in self._dask_distributed.as_completed(futures, loop=self._client.loop):
                yield index[future.key], future.result()
        except self._dask_distributed.scheduler.KilledWorker as error:
            raise EngineFailed(
                f"Dask workers died repeatedly: {error}",
                hint="A task may need more memory than a worker has.",
            ) from error
        finally:
            self._client.cancel(futures)
