"""Find the files of a training run."""

__all__ = ["find_iteration", "likely_folders", "required_file", "source_name"]

import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid, NotInCheckpoint

_ITERATION = re.compile(r"iteration_(\d+)")
_LEVELS = 2
_MOST_LOOKED_AT = 500
_MOST_NAMED = 3


def find_iteration(folder: Path, iteration: int | None = None) -> tuple[int, Path]:
    """Return the number and the folder of an iteration: the last where none is asked for.

    Args:
        folder: What holds ``point_cloud/iteration_N``; other names, such as
            ``coarse_iteration_N``, are passed over.
        iteration: N.

    Raises:
        CheckpointInvalid: There is no such folder; likely ones nearby are named.
        NotInCheckpoint: There are other iterations; they are named.
    """
    parent = folder / "point_cloud"
    if not folder.is_dir():
        raise CheckpointInvalid("is no folder", where=str(folder))
    if not parent.is_dir():
        mend = "Give the folder that training wrote: the one with cfg_args in it."
        mend = likely_folders(folder, lambda one: (one / parent.name).is_dir()) or mend
        raise CheckpointInvalid("has no folder point_cloud", where=str(folder), mend=mend)
    matches = ((_ITERATION.fullmatch(child.name), child) for child in parent.iterdir())
    found = {int(match[1]): child for match, child in matches if match and child.is_dir()}
    if not found:
        raise CheckpointInvalid("holds no folder iteration_N", where=str(parent))
    wanted = max(found) if iteration is None else iteration
    if wanted not in found:
        known = ", ".join(map(str, sorted(found)))
        raise NotInCheckpoint(
            f"has no iteration {wanted}", where=str(parent), mend=f"There are: {known}."
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
        raise CheckpointInvalid(f"is missing: {what}", where=str(path))
    return path


def source_name(folder: Path) -> str:
    """Return what to call a model made from ``folder``."""
    return folder.resolve().name
