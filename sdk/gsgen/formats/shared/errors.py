"""Exceptions for splat files that cannot be read or written, one class per cause."""

__all__ = [
    "ArchiveDamaged",
    "BodyMalformed",
    "FileTruncated",
    "FileUnreadable",
    "FileUnwritable",
    "FormatError",
    "FormatNotRecognised",
    "HeaderMalformed",
    "NotSupported",
    "PropertyMissing",
    "SizeExceeded",
    "ValueInvalid",
]

from typing import ClassVar, Self, final

from gsgen.contract.errors import ExitCode, GsgenError


class FormatError(GsgenError):
    """Base class of errors about splat files, and about data that a file format cannot store.

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

    def located(self, where: str) -> Self:
        """Return a copy of the error whose location stands for that of the file."""
        error = super().located(where)
        error.path = None
        return error

    def __str__(self) -> str:
        actual = ": ".join(part for part in (self.path, self.where, self.message) if part)
        expected = f"expected {self.expected}" if self.expected else ""
        return "\n".join(line for line in (actual, expected, self.hint) if line)


@final
class FileUnreadable(FormatError):
    """Raised if a splat file is missing or empty, is a folder, or may not be read."""


@final
class FileUnwritable(FormatError):
    """Raised if a splat file cannot be written at its path."""

    exit_code: ClassVar[int] = ExitCode.USAGE


@final
class FileTruncated(FormatError):
    """Raised if a file ends before the data that its header announces."""


@final
class FormatNotRecognised(FormatError):
    """Raised if a file is not of the expected splat format, or of no known format."""


@final
class NotSupported(FormatError):
    """Raised for a variant of a known splat format that gsgen does not read."""


@final
class HeaderMalformed(FormatError):
    """Raised if the header of a file breaks the rules of its format."""


@final
class BodyMalformed(FormatError):
    """Raised if a row of a file does not hold the values that its header announces."""


@final
class ArchiveDamaged(FormatError):
    """Raised if compressed data, such as a zip archive or an image in it, cannot be unpacked."""


@final
class PropertyMissing(FormatError):
    """Raised if a file lacks properties or arrays that splats need."""


@final
class SizeExceeded(FormatError):
    """Raised if reading a file would take more memory than allowed."""


@final
class ValueInvalid(FormatError, ValueError):
    """Raised if splats cannot be drawn because of a value, a shape or a dtype."""


def quoted(text: str, limit: int = 60) -> str:
    """Return ``text`` quoted and truncated to ``limit`` characters, for error messages."""
    return repr(text if len(text) <= limit else text[: limit - 1] + "…")


def join_names(names: list[str], limit: int = 12) -> str:
    """Join names by commas; those after the first ``limit`` are only counted."""
    words = [name if name.isidentifier() else quoted(name) for name in names[:limit]]
    if len(names) > limit:
        words.append(f"and {len(names) - limit} more")
    return ", ".join(words) or "nothing"
