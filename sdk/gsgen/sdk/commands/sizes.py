"""Sizes of open dimensions, as several commands take them: SYMBOL=SIZE, repeated."""

__all__ = ["sizes_of"]

from collections.abc import Iterable

from gsgen.contract.errors import ConfigInvalid


def sizes_of(entries: Iterable[str] | None, option: str) -> dict[str, int]:
    """Return symbol → size.

    Args:
        entries: As they were typed; None for none.
        option: What they were typed after.

    Raises:
        ConfigInvalid: One is not SYMBOL=SIZE.
    """
    return dict(_sized(entry, option) for entry in entries or ())


def _sized(entry: str, option: str) -> tuple[str, int]:
    symbol, sign, size = entry.partition("=")
    if not sign or not (size.isascii() and size.isdigit() and int(size) > 0):
        raise ConfigInvalid(f"{entry!r} is not SYMBOL=SIZE, such as J=24", where=option)
    return symbol, int(size)
