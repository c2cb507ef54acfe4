"""Parses sizes of open dimensions from repeated options SYMBOL=SIZE."""

__all__ = ["sizes_of"]

from collections.abc import Iterable

from gsgen.contract.errors import ConfigInvalid


def sizes_of(entries: Iterable[str] | None, option: str) -> dict[str, int]:
    """Parse options SYMBOL=SIZE into a dict from symbolic dimension to size.

    ``option`` is the name of the option in errors.
    """
    return dict(_sized(entry, option) for entry in entries or ())


def _sized(entry: str, option: str) -> tuple[str, int]:
    symbol, sign, size = entry.partition("=")
    if not sign or not (size.isascii() and size.isdigit() and int(size) > 0):
        raise ConfigInvalid(f"is {entry!r}, expected SYMBOL=SIZE, such as J=24", where=option)
    return symbol, int(size)
