"""Finds the folders and files of a training run."""

__all__ = ["find_iteration", "last_iteration", "likely_folders", "required_file", "within_run"]

import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint

_ITERATION_PATTERN = re.compile(r"iteration_(\d+)")
_CLOUD_FOLDER = "point_cloud"
_LAST_ITERATION = -1
# Folders of a run that hold a folder for each iteration.
_PARENT_FOLDERS = (_CLOUD_FOLDER, "deform", "mlp_ckpt")
# Files of a run that may be given in place of its folder.
_RUN_FILE = re.compile(r"cfg_args|point_cloud\.ply|.*\.pth?")
_MAX_FOLDER_DEPTH = 2
_MAX_SCANNED_ENTRIES = 500
_MAX_NAMED_FOLDERS = 3


def within_run(path: Path, iteration: int | None = None) -> tuple[Path, int | None]:
    """Return the folder of the training run around a path, and the number of the iteration.

    ``path`` is the run, an iteration, or a file in either; iteration −1 is the last, as in training
    code. Raises :class:`NotInCheckpoint` if the path is of another iteration.
    """
    iteration = None if iteration == _LAST_ITERATION else iteration
    file = path.is_file() and _RUN_FILE.fullmatch(path.name) is not None
    folder = path.parent if file else path
    absolute_path = folder.absolute()
    match = _ITERATION_PATTERN.fullmatch(absolute_path.name)
    if match and absolute_path.parent.name in _PARENT_FOLDERS:
        number = int(match[1])
        if iteration not in (None, number):
            hint = "Leave out --iteration, or give the folder of the run."
            message = f"is iteration {number}, not {iteration}"
            raise NotInCheckpoint(message, where=str(path), hint=hint)
        return absolute_path.parent.parent, number
    if absolute_path.name in _PARENT_FOLDERS and not (folder / _CLOUD_FOLDER).exists():
        return absolute_path.parent, iteration
    return folder, iteration


def find_iteration(folder: Path, iteration: int | None = None) -> tuple[int, Path]:
    """Return the number and the folder of an iteration, by default the last.

    ``folder`` has ``point_cloud/iteration_N``; other names, such as ``coarse_iteration_N``, are
    ignored. Or it has the files of one iteration by themselves: the number is that of its name, or
    0. The hint of an error names likely folders, or the existing iterations.
    """
    parent = folder / _CLOUD_FOLDER
    if not folder.is_dir():
        message = "is not a folder" if folder.exists() else "does not exist"
        hint = "Give the folder that training wrote: the one with cfg_args in it."
        raise CheckpointInvalid(message, where=str(folder), hint=hint)
    if (folder / f"{_CLOUD_FOLDER}.ply").is_file() and not parent.is_dir():
        match = _ITERATION_PATTERN.fullmatch(folder.absolute().name)
        number = int(match[1]) if match else 0
        if iteration not in (None, number):
            message = f"holds iteration {number} alone, not {iteration}"
            raise NotInCheckpoint(message, where=str(folder), hint="Leave out --iteration.")
        return number, folder
    if not parent.is_dir():
        hint = "Give the folder that training wrote: the one with cfg_args in it."
        hint = likely_folders(folder, lambda candidate: (candidate / parent.name).is_dir()) or hint
        raise CheckpointInvalid("has no folder point_cloud", where=str(folder), hint=hint)
    iterations = _iterations(parent)
    if not iterations:
        raise CheckpointInvalid("holds no folder iteration_N", where=str(parent))
    number = max(iterations) if iteration is None else iteration
    if number not in iterations:
        known = ", ".join(map(str, sorted(iterations)))
        raise NotInCheckpoint(
            f"has no iteration {number}", where=str(parent), hint=f"There are: {known}."
        )
    return number, iterations[number]


def last_iteration(folder: Path) -> Path:
    """Return the folder of a training run's last iteration; the run's folder if none is saved."""
    parent = folder / _CLOUD_FOLDER
    iterations = _iterations(parent) if parent.is_dir() else {}
    return iterations[max(iterations)] if iterations else folder


def likely_folders(folder: Path, is_wanted: Callable[[Path], bool]) -> str:
    """Return a hint with the folders for which ``is_wanted`` is true, up to two levels away."""
    candidates = [
        *folder.absolute().parents[:_MAX_FOLDER_DEPTH],
        *islice(_folders_below(folder), _MAX_SCANNED_ENTRIES),
    ]
    matches: list[Path] = []
    for candidate in candidates:
        if _is_match(is_wanted, candidate) and not set(matches) & set(candidate.parents):
            matches.append(candidate)
    if not matches:
        return ""
    remainder = f" ({len(matches) - _MAX_NAMED_FOLDERS} more look right.)" * (
        len(matches) > _MAX_NAMED_FOLDERS
    )
    return f"Did you mean {' or '.join(map(str, matches[:_MAX_NAMED_FOLDERS]))}?{remainder}"


def _is_match(is_wanted: Callable[[Path], bool], folder: Path) -> bool:
    try:
        return is_wanted(folder)
    except OSError:  # the folder cannot be listed
        return False


def _folders_below(folder: Path, levels: int = _MAX_FOLDER_DEPTH) -> Iterator[Path]:
    """Yield the readable subfolders of ``folder``, down to a depth of ``levels``."""
    try:
        subfolders = sorted(child for child in folder.iterdir() if child.is_dir())
    except OSError:  # the folder cannot be listed
        return
    yield from subfolders
    if levels > 1:
        for child in subfolders:
            yield from _folders_below(child, levels - 1)


def required_file(path: Path, content: str) -> Path:
    """Return the path of a required file; if missing, raise and name iterations that have it."""
    if not path.is_file():
        hint = _sibling_checkpoint_hint(path)
        raise CheckpointInvalid(f"is missing: {content}", where=str(path), hint=hint)
    return path


def _sibling_checkpoint_hint(path: Path) -> str:
    """Return a hint that lists the other iterations of a training run where the file exists."""
    training_folder = path.parent.parent
    if not _ITERATION_PATTERN.fullmatch(path.parent.name) or not training_folder.is_dir():
        return ""
    numbers = [
        n for n, folder in _iterations(training_folder).items() if (folder / path.name).is_file()
    ]
    return f"There is one of iteration {', '.join(map(str, sorted(numbers)))}." if numbers else ""


def _iterations(training_folder: Path) -> dict[int, Path]:
    matches = (
        (_ITERATION_PATTERN.fullmatch(child.name), child) for child in training_folder.iterdir()
    )
    return {int(match[1]): child for match, child in matches if match and child.is_dir()}
