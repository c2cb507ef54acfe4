"""How a model may change the colours of pictures by mistake, and which pixels its rows show.

Each reading is a function of the picture's encoded colours, from 0 to 1. One that gives the model's
colours nearly exactly, where the colours as they are do not, is the reading of the model.
"""

__all__ = ["MIN_DECLARED_ERROR", "ColorReading", "Colors", "color_error", "explain_colors"]

from collections.abc import Callable, Mapping
from itertools import permutations
from typing import Final, NamedTuple

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.spec.spherical_harmonics import SH_DC
from gsgen.contract.spec.srgb import linear_of_srgb, srgb_of_linear

# The statistic is the error of half of the pixels, over the contrast of the result. Where the
# picture's colours stay, it is 0 to 0.05, and 0.3 to 3 after a change of channels, curve, range or
# place. A reading fits below the first number, and the picture as it is does not above the second.
_MAX_READING_ERROR, MIN_DECLARED_ERROR = 0.03, 0.1
# Less contrast than this says nothing, and so does a picture of fewer pixels.
_MIN_CONTRAST, _MIN_PIXELS = 0.005, 16
_IMAGENET_MEANS = np.array([0.485, 0.456, 0.406])
_IMAGENET_DEVIATIONS = np.array([0.229, 0.224, 0.225])

Colors = Float[np.ndarray, "n 3"]


class ColorReading(NamedTuple):
    """How a result follows from a picture.

    Attributes:
        name: The mistake.
        hint: How to repair the model.
        error: The error of half of the pixels in this reading, relative to the result's contrast.
        declared: The error of the picture as it is.
        line: The line of torch that undoes the mistake where colours are from 0 to 1, or nothing.
    """

    name: str
    hint: str
    error: float
    declared: float
    line: str = ""


def color_error(expected: Colors, actual: Colors) -> float:
    """Return the median difference of pixels over the contrast of the result; infinite without any."""
    contrast = float(actual.std(axis=0).mean()) if len(actual) >= _MIN_PIXELS else 0.0
    if not contrast > _MIN_CONTRAST:
        return np.inf
    return float(np.median(np.abs(expected - actual).max(axis=1))) / contrast


def explain_colors(
    picture: Colors, result: Colors, others: Mapping[str, tuple[Colors, str]] | None = None
) -> ColorReading | None:
    """Return the reading that turns a picture into the result, if the picture as it is does not.

    Args:
        picture: Encoded colours of the pixels, [n, 3].
        result: What the model makes of them, in the same units.
        others: Name → colours of the pixels in other places, and the repair.
    """
    declared = color_error(picture, result)
    if not MIN_DECLARED_ERROR < declared < np.inf:
        return None
    readings = {name: (read(picture), hint) for name, (read, hint) in _READINGS.items()}
    readings |= others or {}
    errors = {name: color_error(colors, result) for name, (colors, _) in readings.items()}
    name = min(errors, key=errors.__getitem__)
    if errors[name] > _MAX_READING_ERROR:
        return None
    return ColorReading(name, readings[name][1], errors[name], declared, _LINES.get(name, ""))


def _clipped(read: Callable[[Colors], Colors]) -> Callable[[Colors], Colors]:
    return lambda colors: np.clip(read(colors), 0, 1)


_LINEAR = "Return the colours sRGB-encoded, as the picture is, or declare color_space linear."
_TWICE = "Do not encode the colours again: the picture is sRGB-encoded already."
_MEANS = "Add the means back after the network, times the deviations where those were divided by."
_SIGNED = "Declare the image's range as [-1, 1], or map [0, 1] to [-1, 1] inside the model."
_ORDER = "Keep the order red, green, blue, of the picture and of the result."
# The mistake → the function of the picture's colours, and the repair.
_READINGS: Final[dict[str, tuple[Callable[[Colors], Colors], str]]] = {
    **{
        f"channels come in the order {' '.join('RGB'[channel] for channel in order)}": (
            lambda colors, order=order: colors[:, order],  # type: ignore[misc]
            _ORDER,
        )
        for order in permutations(range(3))
        if order != (0, 1, 2)
    },
    "colours are linear numbers, decoded by the sRGB curve": (linear_of_srgb, _LINEAR),
    "colours are linear numbers, as if raised to the power 2.2": (
        lambda colors: np.maximum(colors, 0) ** 2.2,
        _LINEAR,
    ),
    "colours were encoded twice by the sRGB curve": (srgb_of_linear, _TWICE),
    "colours were encoded twice, as if raised to the power 1/2.2": (
        lambda colors: np.maximum(colors, 0) ** (1 / 2.2),
        _TWICE,
    ),
    "a range from −1 to 1 was expected: colours are (x + 1) / 2, pale": (
        lambda colors: (colors + 1) / 2,
        _SIGNED,
    ),
    "colours range from −1 to 1, as 2 x − 1": (
        lambda colors: 2 * colors - 1,
        "Return (x + 1) / 2, or declare the range [-1, 1].",
    ),
    "colours range from −1 to 1 and were clipped, as 2 x − 1": (
        _clipped(lambda colors: 2 * colors - 1),
        "Return (x + 1) / 2 before the values are clipped.",
    ),
    "ImageNet's means were subtracted and not added back": (
        lambda colors: colors - _IMAGENET_MEANS,
        _MEANS,
    ),
    "ImageNet's means were subtracted, not added back, and the rest was clipped": (
        _clipped(lambda colors: colors - _IMAGENET_MEANS),
        _MEANS,
    ),
    "colours are normalised by ImageNet's means and deviations": (
        lambda colors: (colors - _IMAGENET_MEANS) / _IMAGENET_DEVIATIONS,
        _MEANS,
    ),
    "colours are normalised by ImageNet's means and deviations, and clipped": (
        _clipped(lambda colors: (colors - _IMAGENET_MEANS) / _IMAGENET_DEVIATIONS),
        _MEANS,
    ),
    "ImageNet's means and deviations were applied to a picture that was not normalised": (
        lambda colors: colors * _IMAGENET_DEVIATIONS + _IMAGENET_MEANS,
        "Normalise the picture by the same means and deviations before the network.",
    ),
    "RGB were stored as SH of degree 0": (
        lambda colors: 0.5 + SH_DC * colors,
        "Store (rgb − 0.5) / 0.28209479 as the constant term.",
    ),
}
# The line that undoes a mistake of colours from 0 to 1, with channels in the second axis.
_DECODED = "torch.where({0} <= 0.04045, {0} / 12.92, ((({0} + 0.055) / 1.055).clamp(0)) ** 2.4)"
_ENCODED = "torch.where({0} <= 0.0031308, {0} * 12.92, 1.055 * {0}.clamp(0) ** (1 / 2.4) - 0.055)"
_LINES: Final[dict[str, str]] = {
    **{
        f"channels come in the order {' '.join('RGB'[channel] for channel in order)}": (
            f"rows[:, :3] = rows[:, {[order.index(channel) for channel in range(3)]}]"
        )
        for order in permutations(range(3))
    },
    "colours are linear numbers, decoded by the sRGB curve": (
        f"rows[:, :3] = {_ENCODED.format('rows[:, :3]')}"
    ),
    "colours are linear numbers, as if raised to the power 2.2": (
        "rows[:, :3] = rows[:, :3].clamp(0) ** (1 / 2.2)"
    ),
    "colours were encoded twice by the sRGB curve": (
        f"rows[:, :3] = {_DECODED.format('rows[:, :3]')}"
    ),
    "colours were encoded twice, as if raised to the power 1/2.2": (
        "rows[:, :3] = rows[:, :3].clamp(0) ** 2.2"
    ),
    "a range from −1 to 1 was expected: colours are (x + 1) / 2, pale": (
        "rows[:, :3] = 2 * rows[:, :3] - 1"
    ),
    "colours range from −1 to 1, as 2 x − 1": "rows[:, :3] = (rows[:, :3] + 1) / 2",
}
