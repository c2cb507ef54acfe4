"""Validates several files, in parallel processes if requested."""

__all__ = ["ValidateFile", "validate_all"]

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.engine import Progress, silent
from gsgen.contract.validation.report import Entry, Report, Unreadable
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

ValidateFile = Callable[[Path, Settings, Progress], Report]


def validate_model(path: Path, settings: Settings, progress: Progress) -> Report:
    """Validate the model at ``path``, as one of several files."""
    return validate(path, settings, progress=progress)


def validate_all(
    paths: Sequence[Path],
    settings: Settings,
    *,
    jobs: int = 1,
    progress: Progress = silent,
    validate: ValidateFile = validate_model,
    rules: Callable[[], Registry] = installed_rules,
) -> list[Entry]:
    """Validate every file, and return the reports in the order of ``paths``.

    Args:
        paths: The files.
        settings: Level, target, limits and severities.
        jobs: Number of processes that validate; each runs models in a process of their own.
        progress: Called with a short text at the start of each stage, or after each file.
        validate: Validates one file; a function of a module, which the processes import.
        rules: Returns all rules that reports may name; a function of a module, too.

    Raises:
        WorkerDied: One of several processes was killed.
    """
    if jobs > 1 and len(paths) > 1:
        from gsgen.contract.tools.worker_pool import validate_in_processes

        one = partial(_validate_entry, validate, progress=silent)
        return validate_in_processes(one, rules, paths, settings, min(jobs, len(paths)), progress)
    return [_validate_entry(validate, path, settings, progress=progress) for path in paths]


def _validate_entry(
    validate: ValidateFile, path: Path, settings: Settings, *, progress: Progress
) -> Entry:
    """Validate one file; return its report, or the error if the file is unreadable."""
    try:
        return validate(path, settings, progress)
    except InputUnreadable as error:
        return Unreadable(str(path), error)
