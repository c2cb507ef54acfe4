"""What can go wrong with a splat file, each kind with the fields a report needs."""

from typing import final

__all__ = [
    "ArchiveDamaged",
    "BodyMalformed",
    "FileTruncated",
    "FileUnreadable",
    "FileUnwritable",
    "FormatError",
    "HeaderMalformed",
    "NotRecognised",
    "NotSupported",
    "PropertyMissing",
    "SizeExceeded",
    "ValueInvalid",
]


class FormatError(Exception):
    """A splat file, or the data for one, is not what it has to be.

    Catch this one to catch them all. As text it is one to three lines: where and what
    was seen, what was wanted, what to do next.

    Attributes:
        path: The file, as the caller gave it; None for data that is in memory only.
        message: What was seen.
        where: The property, row, element, array or byte offset; may be empty.
        expected: What was wanted; may be empty.
        hint: What to do next; may be empty.
    """

    def __init__(
        self,
        message: str,
        *,
        where: str = "",
        expected: str = "",
        hint: str = "",
        path: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        self.expected = expected
        self.hint = hint
        self.path = path

    def __str__(self) -> str:
        seen = ": ".join(part for part in (self.path, self.where, self.message) if part)
        wanted = f"expected {self.expected}" if self.expected else ""
        return "\n".join(line for line in (seen, wanted, self.hint) if line)


@final
class FileUnreadable(FormatError):
    """The file is missing, empty, a folder, or closed to us."""


@final
class FileUnwritable(FormatError):
    """The file could not be put where it was asked for."""


@final
class FileTruncated(FormatError):
    """The file ends before the data that it promises."""


@final
class NotRecognised(FormatError):
    """The content is of no kind that can be read here."""


@final
class NotSupported(FormatError):
    """The content is of a known kind that is not read here."""


@final
class HeaderMalformed(FormatError):
    """The description at the start of the file breaks the rules of its format."""


@final
class BodyMalformed(FormatError):
    """A row of a text file does not hold what the header says."""


@final
class ArchiveDamaged(FormatError):
    """A zip archive, or an array in it, cannot be unpacked."""


@final
class PropertyMissing(FormatError):
    """Properties or arrays that are needed are not in the file."""


@final
class SizeExceeded(FormatError):
    """Reading the file would take more memory than allowed."""


@final
class ValueInvalid(FormatError, ValueError):
    """A value, a shape or a data type is one that cannot be drawn."""


def shown(text: str, limit: int = 60) -> str:
    """Return ``text`` quoted and cut short: names in a hostile file can be anything."""
    return repr(text if len(text) <= limit else text[: limit - 1] + "…")


def listed(names: list[str], limit: int = 12) -> str:
    """Return ``names`` joined by commas, and how many were left out after ``limit``."""
    kept = [name if name.isidentifier() else shown(name) for name in names[:limit]]
    more = [f"and {len(names) - limit} more"] if len(names) > limit else []
    return ", ".join(kept + more) or "nothing"
