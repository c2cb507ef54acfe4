"""Colours in words, as people type them."""

__all__ = ["color_of"]

from typing import Final

from gsgen.contract.errors import ConfigInvalid

_NAMED: Final = {
    "black": (0.0, 0.0, 0.0, 1.0),
    "white": (1.0, 1.0, 1.0, 1.0),
    "transparent": (0.0, 0.0, 0.0, 0.0),
}


def color_of(text: str, where: str) -> tuple[float, float, float, float]:
    """Return red, green, blue and alpha.

    Args:
        text: black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1.
        where: What an error calls its place.

    Raises:
        ConfigInvalid: It is none of these.
    """
    if text.lower() in _NAMED:
        return _NAMED[text.lower()]
    try:
        if text.startswith("#") and len(text) == 7:
            hexed = bytes.fromhex(text[1:])
            return hexed[0] / 255, hexed[1] / 255, hexed[2] / 255, 1.0
        red, green, blue, *rest = (float(one) for one in text.split(","))
        (alpha,) = rest or (1.0,)
        if not all(0 <= one <= 1 for one in (red, green, blue, alpha)):
            raise ValueError(text)
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r} is no colour",
            where=where,
            hint="Give black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1.",
        ) from error
    return red, green, blue, alpha
