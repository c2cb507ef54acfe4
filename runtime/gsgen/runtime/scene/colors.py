"""Parses colours that users type: names, #rrggbb, or numbers."""

__all__ = ["color_of"]

from gsgen.contract.errors import ConfigInvalid

_TRANSPARENT_WORDS = ("transparent", "none")


def color_of(text: str, where: str) -> tuple[float, float, float, float]:
    """Parse a colour: a name of CSS, transparent, #rgb, #rrggbb[aa] or R,G,B[,A] from 0 to 1.

    Args:
        text: The colour.
        where: Location of the text in errors.

    Raises:
        ConfigInvalid: The text is not a colour in one of these forms.
    """
    if text.lower() in _TRANSPARENT_WORDS:
        return 0.0, 0.0, 0.0, 0.0
    channels = text.split(",")
    try:
        if len(channels) == 1:
            from PIL import ImageColor

            red, green, blue, *alphas = (byte / 255 for byte in ImageColor.getrgb(text))
        else:
            red, green, blue, *alphas = map(float, channels)
        (alpha,) = alphas or (1.0,)
        if not all(0 <= channel <= 1 for channel in (red, green, blue, alpha)):
            raise ValueError(text)
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r} is not a colour",
            where=where,
            hint="Give a name such as white, grey or transparent, #rgb, #rrggbb, or R,G,B[,A] "
            "from 0 to 1.",
        ) from error
    return red, green, blue, alpha
