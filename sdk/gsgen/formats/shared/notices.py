"""The warning about parts of a splat file that a reader ignores."""

from typing import final

__all__ = ["FormatWarning"]


@final
class FormatWarning(UserWarning):
    """A reader ignores a part of a file, which may change the meaning of the rest."""
