"""Exceptions raised for splat files that cannot be read or written, one class a cause."""

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

from typing import ClassVar, final

from gsgen.contract.errors import ExitCode, GsgenError


class FormatError(GsgenError):
    """Base class of the errors about splat files, and about data that a file cannot hold.

    As text it has one to three lines: the location and the actual value, the expected value, and
    the hint.

    Attributes:
        path: The file, as the caller gave it; None for data in memory.
        message: The actual value or the fault.
        where: The property, row, element, array or byte offset; may be empty.
        expected: The expected value; may be empty.
        hint: The next thing to do; may be empty.
    """

    exit_code: ClassVar[int] = ExitCode.UNREADABLE

    def __init__(
        self,
        message: str,
        *,
        where: str = "",
        expected: str = "",
        hint: str = "",
        path: str | None = None,
    ) -> None:
        super().__init__(message, where=where, hint=hint)
        self.expected = expected
        self.path = path

    def __str__(self) -> str:
        actual = ": ".join(part for part in (self.path, self.where, self.message) if part)
        expected = f"expected {self.expected}" if self.expected else ""
        return "\n".join(line for line in (actual, expected, self.hint) if line)


@final
class FileUnreadable(FormatError):
    """The file is missing or empty, is a folder, or may not be read."""


@final
class FileUnwritable(FormatError):
    """The file cannot be written at its path."""

    exit_code: ClassVar[int] = ExitCode.USAGE


@final
class FileTruncated(FormatError):
    """The file ends before the data that its header announces."""


@final
class NotRecognised(FormatError):
    """The content is not of the expected splat format, or of any."""


@final
class NotSupported(FormatError):
    """The content is of a known format, but of a variant that gsgen does not read."""


@final
class HeaderMalformed(FormatError):
    """The header of the file breaks the rules of its format."""


@final
class BodyMalformed(FormatError):
    """A row of the file does not hold the values that the header announces."""


@final
class ArchiveDamaged(FormatError):
    """Compressed data, such as a zip archive or an image in it, cannot be unpacked."""


@final
class PropertyMissing(FormatError):
    """The file lacks properties or arrays that splats need."""


@final
class SizeExceeded(FormatError):
    """Reading the file would take more memory than allowed."""


@final
class ValueInvalid(FormatError, ValueError):
    """A value, a shape or a data type cannot be drawn."""


def shown(text: str, limit: int = 60) -> str:
    """Return ``text`` quoted and cut to ``limit`` characters; a hostile file can hold any name."""
    return repr(text if len(text) <= limit else text[: limit - 1] + "…")


def listed(names: list[str], limit: int = 12) -> str:
    """Join ``names`` by commas; after ``limit`` names only count the others."""
    words = [name if name.isidentifier() else shown(name) for name in names[:limit]]
    if len(names) > limit:
        words.append(f"and {len(names) - limit} more")
    return ", ".join(words) or "nothing"
