"""What stops us: every error a user can meet carries where, what and how to mend it."""

__all__ = [
    "ConfigInvalid",
    "GsgenError",
    "InputUnreadable",
    "LayoutMismatch",
    "ManifestInvalid",
    "ModelUnreadable",
    "UnknownName",
]

from collections.abc import Iterable
from typing import ClassVar

_MOST_LISTED = 12


class GsgenError(Exception):
    """The base of all errors that are the input's fault, never ours.

    Attributes:
        message: What was wrong, with the offending value.
        where: The file, tensor, row or option it was found in.
        hint: The next thing to do or type; empty if there is nothing to say.
        exit_code: What a command ends with that the error stops.
    """

    exit_code: ClassVar[int] = 2

    def __init__(self, message: str, *, where: str = "", hint: str = "") -> None:
        self.message = message
        self.where = where
        self.hint = hint
        super().__init__(message)

    def __str__(self) -> str:
        head = f"{self.where}: {self.message}" if self.where else self.message
        return f"{head}\n  {self.hint}" if self.hint else head


class InputUnreadable(GsgenError):
    """A file or folder is missing, damaged, or holds something else than is read (exit code 4)."""

    exit_code: ClassVar[int] = 4


class ModelUnreadable(InputUnreadable):
    """The file is not an ONNX model that can be judged at all."""


class ManifestInvalid(GsgenError):
    """A manifest does not follow its schema, or cannot be written."""


class ConfigInvalid(GsgenError):
    """An option or a configuration file says something that cannot be meant."""


class LayoutMismatch(GsgenError):
    """Arrays do not have the shapes or dtypes of the packed layout."""


class UnknownName(ConfigInvalid):
    """A rule, target, role or plugin of that name does not exist."""

    @classmethod
    def among(
        cls, noun: str, name: str, known: Iterable[str], where: str = ""
    ) -> "UnknownName":
        """Say that ``name`` is unknown, and which known name it may have meant."""
        from difflib import get_close_matches  # only trouble needs it, and start-up counts

        names = sorted(known)
        close = get_close_matches(name, names, n=1, cutoff=0.5)
        short = len(names) <= _MOST_LISTED
        all = (
            f"Known: {', '.join(names) or 'none'}." if short else f"{len(names)} are known."
        )
        hint = f"Did you mean {close[0]!r}?" if close else all
        return cls(f"unknown {noun} {name!r}", where=where, hint=hint)
