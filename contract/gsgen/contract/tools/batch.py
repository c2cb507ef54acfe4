"""Validates several files, in parallel processes if requested."""

__all__ = ["registry_for", "validate_all"]

from collections.abc import Sequence
from pathlib import Path

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.rules.catalogue import installed_rules, model_rules
from gsgen.contract.validation.engine import Progress, silent
from gsgen.contract.validation.report import Entry, Unreadable
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate


def registry_for(paths: Sequence[Path]) -> Registry:
    """Return the installed rules; tileset rules only if one of the files is a tileset."""
    models_only = all(path.suffix.lower() == MODEL_SUFFIX for path in paths)
    return model_rules() if models_only else installed_rules()


def validate_all(
    paths: Sequence[Path], settings: Settings, *, jobs: int = 1, progress: Progress = silent
) -> list[Entry]:
    """Validate every file, and return the reports in the order of ``paths``.

    Args:
        paths: The files.
        settings: Level, target, limits and severities.
        jobs: Number of processes that validate; each runs models in a process of their own.
        progress: Called with a short text at the start of each stage, or after each file.

    Raises:
        WorkerDied: One of several processes was killed.
    """
    if jobs > 1 and len(paths) > 1:
        from gsgen.contract.tools.worker_pool import validate_in_processes

        return validate_in_processes(
            _validate_in_worker, paths, settings, min(jobs, len(paths)), progress
        )
    registry = registry_for(paths)
    return [_validate_entry(path, settings, registry, progress) for path in paths]


def _validate_entry(
    path: Path, settings: Settings, registry: Registry, progress: Progress
) -> Entry:
    """Validate one file; return its report, or the error if the file is unreadable."""
    try:
        return validate(path, settings, registry=registry, progress=progress)
    except InputUnreadable as error:
        return Unreadable(str(path), error)


def _validate_in_worker(path: Path, settings: Settings) -> Entry:
    return _validate_entry(path, settings, registry_for([path]), silent)
