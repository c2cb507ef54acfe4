"""Orders names by the numbers in them: frame 2 comes before frame 10."""

__all__ = ["natural_key"]

import re
from typing import Final

_DIGITS_PATTERN: Final = re.compile(r"(\d+)")


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Return a key that sorts names in natural order: runs of digits count as numbers."""
    parts = _DIGITS_PATTERN.split(name)
    # Texts and numbers alternate, so that equal places hold equal kinds.
    key = [(int(part), "") if index % 2 else (0, part) for index, part in enumerate(parts)]
    return (*key, (0, name))
