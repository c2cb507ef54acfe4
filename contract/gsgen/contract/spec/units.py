"""The limits of float16 numbers, and functions that format byte counts."""

__all__ = [
    "FLOAT16_EPSILON",
    "FLOAT16_MAX",
    "FLOAT16_SMALLEST_NORMAL",
    "KIBIBYTE",
    "MEBIBYTE",
    "format_bytes",
    "format_mebibytes",
    "parse_bytes",
]

import re
from typing import Final

from gsgen.contract.errors import ConfigInvalid

# The largest finite float16; larger values become infinite.
FLOAT16_MAX: Final = 65504.0

# Positive float16 values below it are subnormal, which GPUs may flush to zero.
FLOAT16_SMALLEST_NORMAL: Final = 2.0**-14

# The distance from 1 to the next larger float16.
FLOAT16_EPSILON: Final = 2.0**-10

KIBIBYTE: Final = 1 << 10
MEBIBYTE: Final = 1 << 20


def format_bytes(size: int) -> str:
    """Return a byte count with its unit: ``812 B``, ``12.4 KiB`` or ``3.1 MiB``."""
    if size < KIBIBYTE:
        return f"{size} B"
    if size < MEBIBYTE:
        return f"{size / KIBIBYTE:.1f} KiB"
    return f"{size / MEBIBYTE:.1f} MiB"


def format_mebibytes(size: int, digits: int = 1) -> str:
    """Return a byte count in MiB, with ``digits`` decimals."""
    return f"{size / MEBIBYTE:.{digits}f} MiB"


_UNIT_POWERS: Final = {"K": 10, "M": 20, "G": 30, "T": 40}


def parse_bytes(text: str, where: str) -> int:
    """Parse a number of bytes such as ``2GB``, ``512 MiB`` or ``0``.

    Units are powers of 1,024, with or without the ``i``.

    Raises:
        ConfigInvalid: The text is no such number; the error's location is ``where``.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:I?B)?", text.strip().upper())
    if match is None:
        hint = "Write for example 2GB, 512MB or 0."
        raise ConfigInvalid(f"{text!r} is not a number of bytes", where=where, hint=hint)
    unit = 1 if not match[2] else 1 << _UNIT_POWERS[match[2]]
    return int(float(match[1]) * unit)
