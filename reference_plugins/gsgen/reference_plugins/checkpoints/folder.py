"""Find the files of a training run."""

__all__ = ["find_iteration", "required_file", "source_name"]

import re
from pathlib import Path

from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid

_ITERATION = re.compile(r"iteration_(\d+)")


def find_iteration(folder: Path, iteration: int | None = None) -> tuple[int, Path]:
    """Return the number and the folder of an iteration: the last where none is asked for.

    Args:
        folder: What holds ``point_cloud/iteration_N``; other names, such as
            ``coarse_iteration_N``, are passed over.
        iteration: N.

    Raises:
        CheckpointInvalid: There is no such folder; those that exist are named.
    """
    parent = folder / "point_cloud"
    if not folder.is_dir():
        raise CheckpointInvalid("is no folder", where=str(folder))
    if not parent.is_dir():
        mend = "Give the folder that training wrote: the one with cfg_args in it."
        raise CheckpointInvalid("has no folder point_cloud", where=str(folder), mend=mend)
    matches = ((_ITERATION.fullmatch(child.name), child) for child in parent.iterdir())
    found = {int(match[1]): child for match, child in matches if match and child.is_dir()}
    if not found:
        raise CheckpointInvalid("holds no folder iteration_N", where=str(parent))
    wanted = max(found) if iteration is None else iteration
    if wanted not in found:
        known = ", ".join(map(str, sorted(found)))
        raise CheckpointInvalid(
            f"has no iteration {wanted}", where=str(parent), mend=f"There are: {known}."
        )
    return wanted, found[wanted]


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
