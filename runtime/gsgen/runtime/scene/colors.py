"""Parses colours that users type: names, #rrggbb, or numbers."""

__all__ = ["color_of"]

from typing import Final

from gsgen.contract.errors import ConfigInvalid

_COLOR_NAMES: Final = {
    "black": (0.0, 0.0, 0.0, 1.0),
    "white": (1.0, 1.0, 1.0, 1.0),
    "transparent": (0.0, 0.0, 0.0, 0.0),
}


def color_of(text: str, where: str) -> tuple[float, float, float, float]:
    """Parse a colour: black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1.

    Args:
        text: The colour.
        where: Location of the text in errors.

    Raises:
        ConfigInvalid: The text is not a colour in one of these forms.
    """
    if text.lower() in _COLOR_NAMES:
        return _COLOR_NAMES[text.lower()]
    try:
        if text.startswith("#") and len(text) == 7:
            rgb_bytes = bytes.fromhex(text[1:])
            return rgb_bytes[0] / 255, rgb_bytes[1] / 255, rgb_bytes[2] / 255, 1.0
        red, green, blue, *alphas = (float(channel) for channel in text.split(","))
        (alpha,) = alphas or (1.0,)
        if not all(0 <= channel <= 1 for channel in (red, green, blue, alpha)):
            raise ValueError(text)
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r} is not a colour",
            where=where,
            hint="Give black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1.",
        ) from error
    return red, green, blue, alpha
