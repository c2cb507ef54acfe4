"""Find the files of a training run."""

__all__ = ["find_iteration", "likely_folders", "required_file", "source_name", "within_run"]

import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint

_ITERATION = re.compile(r"iteration_(\d+)")
_CLOUD = "point_cloud"
_LAST = -1
# Where methods put what belongs to an iteration.
_PARENTS = (_CLOUD, "deform", "mlp_ckpt")
# Files of a run that stand for it.
_STANDING = re.compile(r"cfg_args|point_cloud\.ply|.*\.pth?")
_LEVELS = 2
_MOST_LOOKED_AT = 500
_MOST_NAMED = 3


def within_run(given: Path, iteration: int | None = None) -> tuple[Path, int | None]:
    """Return the training run that a path lies in, and which iteration is meant.

    Args:
        given: The run's folder, or one of an iteration in it, or a file in either.
        iteration: Which one is asked for besides; −1 is the last, as training code has it.

    Raises:
        NotInCheckpoint: The path is of another iteration.
    """
    iteration = None if iteration == _LAST else iteration
    file = given.is_file() and _STANDING.fullmatch(given.name) is not None
    place = given.parent if file else given
    whole = place.absolute()
    match = _ITERATION.fullmatch(whole.name)
    if match and whole.parent.name in _PARENTS:
        number = int(match[1])
        if iteration not in (None, number):
            hint = "Leave out --iteration, or give the folder of the run."
            what = f"is iteration {number}, not {iteration}"
            raise NotInCheckpoint(what, where=str(given), hint=hint)
        return whole.parent.parent, number
    if whole.name in _PARENTS and not (place / _CLOUD).exists():
        return whole.parent, iteration
    return place, iteration


def find_iteration(folder: Path, iteration: int | None = None) -> tuple[int, Path]:
    """Return the number and the folder of an iteration: the last where none is asked for.

    Args:
        folder: What holds ``point_cloud/iteration_N``; other names, such as
            ``coarse_iteration_N``, are passed over. Or what was in such a folder, by itself: then
            the number is that of its name, or 0.
        iteration: N.

    Raises:
        CheckpointInvalid: There is no such folder; likely ones nearby are named.
        NotInCheckpoint: There are other iterations; they are named.
    """
    parent = folder / _CLOUD
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "does not exist"
        hint = "Give the folder that training wrote: the one with cfg_args in it."
        raise CheckpointInvalid(what, where=str(folder), hint=hint)
    if (folder / f"{_CLOUD}.ply").is_file() and not parent.is_dir():
        match = _ITERATION.fullmatch(folder.absolute().name)
        number = int(match[1]) if match else 0
        if iteration not in (None, number):
            what = f"holds an iteration by itself, {number}, not {iteration}"
            raise NotInCheckpoint(what, where=str(folder), hint="Leave out --iteration.")
        return number, folder
    if not parent.is_dir():
        hint = "Give the folder that training wrote: the one with cfg_args in it."
        hint = likely_folders(folder, lambda one: (one / parent.name).is_dir()) or hint
        raise CheckpointInvalid("has no folder point_cloud", where=str(folder), hint=hint)
    found = _iterations(parent)
    if not found:
        raise CheckpointInvalid("holds no folder iteration_N", where=str(parent))
    wanted = max(found) if iteration is None else iteration
    if wanted not in found:
        known = ", ".join(map(str, sorted(found)))
        raise NotInCheckpoint(
            f"has no iteration {wanted}", where=str(parent), hint=f"There are: {known}."
        )
    return wanted, found[wanted]


def likely_folders(folder: Path, is_right: Callable[[Path], bool]) -> str:
    """Ask whether a folder a little above or below ``folder`` was meant; empty if none is right."""
    places = [
        *folder.absolute().parents[:_LEVELS],
        *islice(_below(folder), _MOST_LOOKED_AT),
    ]
    found: list[Path] = []
    for place in places:
        if _is(is_right, place) and not set(found) & set(place.parents):
            found.append(place)
    if not found:
        return ""
    more = f" ({len(found) - _MOST_NAMED} more look right.)" * (len(found) > _MOST_NAMED)
    return f"Did you mean {' or '.join(map(str, found[:_MOST_NAMED]))}?{more}"


def _is(is_right: Callable[[Path], bool], place: Path) -> bool:
    try:
        return is_right(place)
    except OSError:  # a folder of somebody else
        return False


def _below(folder: Path, levels: int = _LEVELS) -> Iterator[Path]:
    """Yield the folders in ``folder`` that can be looked into, and those in these."""
    try:
        inner = sorted(child for child in folder.iterdir() if child.is_dir())
    except OSError:  # somebody else's
        return
    yield from inner
    if levels > 1:
        for child in inner:
            yield from _below(child, levels - 1)


def required_file(path: Path, what: str) -> Path:
    """Return ``path`` if it is a file.

    Raises:
        CheckpointInvalid: It is not; ``what`` says what it should hold.
    """
    if not path.is_file():
        hint = _elsewhere(path)
        raise CheckpointInvalid(f"is missing: {what}", where=str(path), hint=hint)
    return path


def _elsewhere(path: Path) -> str:
    """Say of which other iterations there is such a file."""
    home = path.parent.parent
    if not _ITERATION.fullmatch(path.parent.name) or not home.is_dir():
        return ""
    has = [n for n, place in _iterations(home).items() if (place / path.name).is_file()]
    return f"There is one of iteration {', '.join(map(str, sorted(has)))}." if has else ""


def _iterations(home: Path) -> dict[int, Path]:
    matches = ((_ITERATION.fullmatch(child.name), child) for child in home.iterdir())
    return {int(match[1]): child for match, child in matches if match and child.is_dir()}


def source_name(folder: Path) -> str:
    """Return what to call a model made from ``folder``."""
    return folder.resolve().name
