"""The warning about parts of a splat file that a reader ignores."""

from typing import final

__all__ = ["FormatWarning"]


@final
class FormatWarning(UserWarning):
    """Warning about a part of a splat file that the reader ignores."""
