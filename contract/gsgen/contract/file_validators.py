"""Plug-in validators of files other than ONNX models (entry point group ``gsgen.validators``).

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
    """Protocol of a plug-in that validates one kind of file, such as tilesets."""

    def recognises(self, path: Path) -> bool:
        """Return whether ``path`` names a file, folder or address that this plug-in validates."""
        ...

    def validate(
        self,
        path: Path,
        settings: "Settings",
        registry: "Registry",
        progress: Callable[[str], None],
    ) -> "Report":
        """Validate the file at ``path``, and return a report; raise InputUnreadable if damaged."""
        ...


def find_validator(path: Path) -> FileValidator | None:
    """Return the plug-in that validates the file at ``path``; None if the file may be ONNX."""
    if path.suffix.lower() == MODEL_SUFFIX:
        return None
    for point in registered_entry_points(_GROUP):
        validator: FileValidator = point.load()
        if validator.recognises(path):
            return validator
    return None
