"""The public functions that validate a model, or several, by every installed rule."""

__all__ = ["ValidateFile", "expand_paths", "validate", "validate_all"]

import glob
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.engine import Progress, ignore_progress, validate_with
from gsgen.contract.validation.report import Entry, Report, Unreadable
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings


def _to_text(report: Report) -> str:
    from gsgen.contract.reporters.text import render

    return "\n".join(line.text for line in render(report))


Report.to_text = _to_text


def validate(
    path: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    registry: Registry | None = None,
    progress: Progress = ignore_progress,
) -> Report:
    """Validate the model at ``path`` by every installed rule and return the report.

    Args:
        path: An ONNX file, its address, or a ZIP archive of it; ``gsgen.tiles.validate`` validates
            tilesets.
        settings: Level, target, limits and severities.
        registry: The rules to check; by default, all installed rules.
        progress: Called with a short text at the start of each stage.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
        InputUnreadable: The file at an address cannot be had.
    """
    settings = settings or Settings()
    models = (registry or installed_rules()).of_files("model", settings.only)
    return validate_with(models, _on_disk(Path(path)), settings, progress=progress)


def _on_disk(path: Path) -> Path:
    """Return the file of a path, address or archive; a file named as a model is one."""
    if path.suffix.lower() == MODEL_SUFFIX and path.exists():
        return path
    from gsgen.contract.model.fetched_inputs import local_file

    return local_file(path)


ValidateFile = Callable[[Path, Settings, Progress], Report]


def validate_model(path: Path, settings: Settings, progress: Progress) -> Report:
    """Validate the model at ``path``, as one of several files."""
    return validate(path, settings, progress=progress)


def validate_all(
    paths: Sequence[Path],
    settings: Settings,
    *,
    jobs: int = 1,
    progress: Progress = ignore_progress,
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
        from gsgen.contract._worker_pool import validate_in_processes

        validate_one = partial(_validate_entry, validate, progress=ignore_progress)
        return validate_in_processes(
            validate_one, rules, paths, settings, min(jobs, len(paths)), progress
        )
    return [_validate_entry(validate, path, settings, progress=progress) for path in paths]


def _validate_entry(
    validate: ValidateFile, path: Path, settings: Settings, *, progress: Progress
) -> Entry:
    """Validate one file; return its report, or the error if the file is unreadable."""
    try:
        return validate(path, settings, progress)
    except InputUnreadable as error:
        return Unreadable(str(path), error)


_WILDCARD_CHARACTERS = frozenset("*?[")


def expand_paths(
    names: Iterable[Path], is_entry_folder: Callable[[Path], bool] = lambda folder: False
) -> list[Path]:
    """Return the model files that names, folders and globs denote, each once, in order.

    A folder gives the models in it and below, sorted by path, without hidden files and folders. A
    folder for which ``is_entry_folder`` returns True, such as that of a tileset, stays one entry. A name with wildcards that no file has by itself is a glob, in which ``**`` matches any folders.

    Raises:
        ConfigInvalid: A folder holds no model, or a glob matches no file.
    """
    return list(
        dict.fromkeys(path for name in names for path in _expand_path(name, is_entry_folder))
    )


def _expand_path(name: Path, is_entry_folder: Callable[[Path], bool]) -> Iterator[Path]:
    if not name.is_dir() and not name.exists() and _WILDCARD_CHARACTERS & set(str(name)):
        matches = sorted(glob.glob(str(name), recursive=True))
        if not matches:
            hint = "Check the folder that the command runs in."
            raise ConfigInvalid("the pattern matches no file", where=str(name), hint=hint)
        for match in matches:
            yield from _expand_path(Path(match), is_entry_folder)
    elif name.is_dir() and not is_entry_folder(name):
        models = sorted(path for path in name.rglob(f"*{MODEL_SUFFIX}") if _is_visible(path, name))
        if not models:
            raise _no_model_error(name)
        yield from models
    else:
        yield name


def _no_model_error(folder: Path) -> ConfigInvalid:
    from gsgen.contract.file_kinds.folder_kinds import kind_of_folder

    kind = kind_of_folder(folder)
    actual = "the folder holds no ONNX model"
    hint = f"Name a folder with {MODEL_SUFFIX} files, or a file."
    if kind is not None:
        actual, hint = f"this is {kind.title}, which holds no ONNX model", kind.hint
    return ConfigInvalid(actual, where=str(folder), hint=hint)


def _is_visible(path: Path, folder: Path) -> bool:
    is_hidden_file = any(part.startswith(".") for part in path.relative_to(folder).parts)
    return path.is_file() and not is_hidden_file
