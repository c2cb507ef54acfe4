"""Validators of files that are not models: found by the entry point group ``gsgen.validators``.

An entry point names a module with two functions: ``recognises``, which looks at the name of a
file alone, and ``validate``, which returns a report such as a model gets.
"""

__all__ = ["FileValidator", "find_validator"]

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from gsgen.contract._entry_points import registered_entry_points
from gsgen.contract.process.atomic_files import MODEL_SUFFIX

if TYPE_CHECKING:
    from gsgen.contract.validation.report import Report
    from gsgen.contract.validation.rule import Registry
    from gsgen.contract.validation.settings import Settings

_GROUP = "gsgen.validators"


class FileValidator(Protocol):
    """Judges files of a kind that another package knows."""

    def recognises(self, path: Path) -> bool:
        """Say whether ``path`` names a file, folder or address of this kind."""
        ...

    def validate(
        self,
        path: Path,
        settings: "Settings",
        registry: "Registry",
        progress: Callable[[str], None],
    ) -> "Report":
        """Judge it; raises InputUnreadable where it cannot be judged at all."""
        ...


def find_validator(path: Path) -> FileValidator | None:
    """Return what judges the file at ``path``; None for a model, or what may be one."""
    if path.suffix.lower() == MODEL_SUFFIX:
        return None
    for point in registered_entry_points(_GROUP):
        validator: FileValidator = point.load()
        if validator.recognises(path):
            return validator
    return None
