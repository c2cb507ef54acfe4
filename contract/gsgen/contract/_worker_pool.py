"""Worker processes that validate files in parallel."""

__all__ = ["WorkerDied", "validate_in_processes"]

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import ClassVar

from gsgen.contract.errors import ExitCode, GsgenError
from gsgen.contract.process.parent_watchdog import prepare_worker, safe_multiprocessing
from gsgen.contract.validation.engine import Progress
from gsgen.contract.validation.report import Entry
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.settings import Settings


class WorkerDied(GsgenError):
    """Raised if a worker process ended without a report, for example out of memory."""

    exit_code: ClassVar[int] = ExitCode.INTERNAL


def validate_in_processes(
    validate: Callable[[Path, Settings], Entry],
    rules: Callable[[], Registry],
    paths: Sequence[Path],
    settings: Settings,
    jobs: int,
    progress: Progress,
) -> list[Entry]:
    """Validate files in ``jobs`` processes, and return the results in the order of ``paths``.

    Args:
        validate: Validates one file; a function of a module, which the processes import.
        rules: Returns all rules that reports may name; a function of a module, too.
        paths: The files.
        settings: Level, target, limits and severities.
        jobs: Number of processes.
        progress: Called with a short text after each file.

    Raises:
        WorkerDied: A process was killed.
    """
    context = multiprocessing.get_context("spawn")  # a fork would copy the threads' locks
    other_processes = multiprocessing.active_children()
    with (
        safe_multiprocessing(),
        ProcessPoolExecutor(jobs, context, _start_worker, (rules,)) as pool,
    ):
        futures = [pool.submit(validate, path, settings) for path in paths]
        try:
            return [
                _result(future, f"{number} of {len(paths)} validated", progress)
                for number, future in enumerate(futures, 1)
            ]
        except BrokenProcessPool as error:
            hint = "Give it fewer --jobs, or less --memory."
            raise WorkerDied(
                "a worker process ended without a validation report", hint=hint
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()).difference(other_processes):
                process.terminate()
            raise


def _result(future: "Future[Entry]", text: str, progress: Progress) -> Entry:
    entry = future.result()
    progress(text)
    return entry


def _start_worker(rules: Callable[[], Registry]) -> None:
    prepare_worker()
    ForkingPickler.register(Rule, partial(_reduce_rule, rules))


def _reduce_rule(
    rules: Callable[[], Registry], rule: Rule
) -> tuple[Callable[..., Rule], tuple[Callable[[], Registry], str]]:
    """Pickle a rule as its id only, since the parent process has the same rules installed."""
    return _find_rule, (rules, rule.id)


def _find_rule(rules: Callable[[], Registry], rule_id: str) -> Rule:
    return rules().rules[rule_id]
