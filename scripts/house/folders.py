"""Finds folders with too many modules."""

__all__ = ["folders"]

from collections import Counter
from pathlib import PurePosixPath

from house.repository import Repository
from house.violation import Measurement, Violation

_MOST_MODULES = 15


def folders(repository: Repository) -> Measurement:
    """Find folders with more than 15 Python modules, ``__init__`` not counted."""
    counts: Counter[str] = Counter()
    for file in repository.selected:
        path = PurePosixPath(file.path)
        if path.name != "__init__.py":
            counts[str(path.parent)] += 1
    violations = [
        Violation(
            path=folder,
            line=0,
            subject=str(count),
            actual=f"{count} modules",
            expected=f"at most {_MOST_MODULES}",
            hint="split the folder by the questions that its modules answer",
        )
        for folder, count in sorted(counts.items())
        if count > _MOST_MODULES
    ]
    return Measurement(violations, len(counts))
