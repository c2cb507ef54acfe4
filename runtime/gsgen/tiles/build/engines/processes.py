"""The build engine ``processes``: runs tasks in worker processes of this machine."""

__all__ = ["Processes"]

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from multiprocessing import get_context
from typing import Final, TypeVar, final

from gsgen.contract.process.parent_watchdog import prepare_worker, safe_multiprocessing
from gsgen.tiles.build.engines.engine import MAX_RETRIES, Engine, EngineFailed

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

_QUEUED_PER_WORKER: Final = 2  # tasks a worker that wait with it: results arrive while it computes
_MEMORY_HINT: Final = "A worker was killed, by lack of memory perhaps: use fewer --workers."


@final
class Processes(Engine):
    """Runs tasks in worker processes; a killed worker is replaced and its tasks run again."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._environment = ExitStack()

    def __enter__(self) -> "Processes":
        self._environment.enter_context(safe_multiprocessing())
        return self

    def __exit__(self, *error: object) -> None:
        self._environment.close()
        if self._pool is not None:
            if error[0] is not None:
                self._stop_pool(self._pool)
            self._pool.shutdown(wait=error[0] is None, cancel_futures=True)
            self._pool = None

    @staticmethod
    def _stop_pool(pool: ProcessPoolExecutor) -> None:
        for process in list((getattr(pool, "_processes", None) or {}).values()):
            process.terminate()

    def _open_pool(self) -> ProcessPoolExecutor:
        if self._pool is None:
            context = get_context("spawn")  # forking would copy locks of our threads
            self._pool = ProcessPoolExecutor(self._workers, context, prepare_worker)
        return self._pool

    def run(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Iterator[tuple[int, _Result]]:
        """Run build tasks on all worker processes, started in the order of the tasks."""
        pending = list(range(len(tasks)))[::-1]
        failures = 0
        running_tasks: dict[Future[_Result], int] = {}
        while pending or running_tasks:
            try:
                pool = self._open_pool()
                while pending and len(running_tasks) < _QUEUED_PER_WORKER * self._workers:
                    future: Future[_Result] = pool.submit(function, tasks[pending[-1]])
                    running_tasks[future] = pending.pop()
                finished_tasks, _ = wait(running_tasks, return_when=FIRST_COMPLETED)
                for future in finished_tasks:
                    result = future.result()
                    yield running_tasks.pop(future), result
            except BrokenProcessPool as error:
                failures += 1
                if failures > MAX_RETRIES:
                    raise EngineFailed(
                        f"worker processes died {failures} times", hint=_MEMORY_HINT
                    ) from error
                # Tasks that finished but were not yielded return at once: their marker file exists.
                pending += sorted(running_tasks.values(), reverse=True)
                running_tasks.clear()
                if self._pool is not None:
                    self._pool.shutdown(wait=True, cancel_futures=True)
                self._pool = None
