"""Suggests a file for a path that does not exist."""

__all__ = ["similar_file_hint"]

import os
from contextlib import suppress


def similar_file_hint(path: str | os.PathLike[str]) -> str:
    """Return a hint with the file whose name is nearest to a missing one, or an empty text."""
    from difflib import get_close_matches  # imported on failure only: start-up time counts

    folder, name = os.path.split(path)
    with suppress(OSError):  # there is no such folder either
        close = get_close_matches(name, os.listdir(folder or "."), n=1, cutoff=0.7)
        if close and close[0] != name:
            return f"Did you mean {os.path.join(folder, close[0])!r}?"
    return ""
