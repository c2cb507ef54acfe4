"""Parses image sizes of command-line options."""

__all__ = ["read_size"]

import re

from gsgen.contract.errors import ConfigInvalid

_SIZE_PATTERN = re.compile(r"(\d{1,6})[x×](\d{1,6})")


def read_size(size: str) -> tuple[int, int] | None:
    """Parse ``WIDTHxHEIGHT`` into height and width, in this order; ``any`` gives None."""
    word = size.strip().lower()
    if word == "any":
        return None
    match = _SIZE_PATTERN.fullmatch(word)
    if match is None or not (int(match[1]) and int(match[2])):
        hint = "Write it as 1024x576, width first, or any."
        raise ConfigInvalid(f"{size!r} is not an image size", where="--size", hint=hint)
    return int(match[2]), int(match[1])
