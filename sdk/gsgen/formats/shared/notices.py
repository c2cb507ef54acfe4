"""What a reader says of a file that it can read, but not all of."""

from typing import final

__all__ = ["FormatWarning"]


@final
class FormatWarning(UserWarning):
    """Something in a file is passed over, and may change what the rest means."""
