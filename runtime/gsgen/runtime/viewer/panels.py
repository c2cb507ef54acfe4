"""Panels of a viewer: help, numbers, a slider and messages, as small pictures."""

__all__ = ["Slider", "paragraph"]

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

_TEXT: Final = 14  # pixels at a ratio of 1
_LEADING: Final = 1.45
_MARGIN: Final = 10
_CORNER: Final = 6
_ASCII: Final = str.maketrans({"–": "-", "—": "-", "×": "x", "’": "'", "…": "..."})
_PAPER: Final = (16, 18, 22, 190)
_INK: Final = (236, 238, 242, 255)
_DIM: Final = (150, 156, 166, 255)
_LIT: Final = (255, 176, 64, 255)


def paragraph(
    rows: Sequence[tuple[str, str]], ratio: float = 1.0
) -> UInt8[np.ndarray, "h w 4"]:
    """Return a panel of two columns.

    Args:
        rows: The left and the right text of each line; either may be empty.
        ratio: Pixels of the surface for each that is meant.
    """
    rows = [(_plain(left), _plain(right)) for left, right in rows]
    font, size = _font(round(_TEXT * ratio)), _TEXT * ratio
    margin, line = round(_MARGIN * ratio), round(size * _LEADING)
    first = max((font.getlength(left) for left, right in rows if right), default=0.0)
    column = round(first + 1.2 * size) if first else 0
    whole = [
        (column + font.getlength(right)) if right else font.getlength(left)
        for left, right in rows
    ]
    width = round(max(whole, default=0.0)) + 2 * margin
    image, draw = _paper(width, line * len(rows) + 2 * margin - round(size * 0.4), ratio)
    for number, (left, right) in enumerate(rows):
        top = margin + number * line - round(size * 0.1)
        draw.text((margin, top), left, _LIT if right else _INK, font)
        draw.text((margin + column, top), right, _INK, font)
    return _multiplied(image)


@final
@dataclass(frozen=True, slots=True)
class Slider:
    """Where the slider of the time is, in pixels of the surface.

    Attributes:
        width: Of the surface.
        height: Of the surface.
        ratio: Pixels of the surface for each that is meant.
    """

    width: int
    height: int
    ratio: float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its panel."""
        return max(1, self.width - 2 * self._edge), round(34 * self.ratio)

    @property
    def at(self) -> tuple[int, int]:
        """The upper left corner of its panel."""
        return self._edge, max(0, self.height - self.size[1] - self._edge)

    @property
    def _edge(self) -> int:
        return round(_MARGIN * self.ratio)

    def _ends(self) -> tuple[float, float]:
        """Return where the groove begins and ends in the panel."""
        width = self.size[0]
        return min(34 * self.ratio, width / 2), max(width - 130 * self.ratio, width / 2 + 1)

    def holds(self, x: float, y: float) -> bool:
        """Say whether a place on the surface is on the panel."""
        left, top = self.at
        return 0 <= x - left < self.size[0] and 0 <= y - top < self.size[1]

    def on_button(self, x: float) -> bool:
        """Say whether a place on the panel is on the button that plays."""
        return x - self.at[0] < self._ends()[0] - 6 * self.ratio

    def share(self, x: float) -> float:
        """Return how far along the groove a place is, from 0 to 1."""
        low, high = self._ends()
        return float(np.clip((x - self.at[0] - low) / (high - low), 0, 1))

    def picture(
        self, share: float, label: str, playing: bool
    ) -> UInt8[np.ndarray, "h w 4"]:
        """Return the panel.

        Args:
            share: How far along the knob is.
            label: What is said at the end.
            playing: Whether the button pauses.
        """
        (width, tall), ratio, (low, high) = self.size, self.ratio, self._ends()
        image, draw = _paper(width, tall, ratio)
        middle, knob = tall / 2, 6 * ratio
        draw.line((low, middle, high, middle), _DIM, max(1, round(2 * ratio)))
        value = low + (high - low) * share
        draw.line((low, middle, value, middle), _LIT, max(1, round(3 * ratio)))
        draw.ellipse((value - knob, middle - knob, value + knob, middle + knob), _INK)
        left, half = 12 * ratio, 6 * ratio
        if playing:
            for start in (left, left + half):
                draw.rectangle(
                    (start, middle - half, start + half / 2, middle + half), _INK
                )
        else:
            corners = [
                (left, middle - half),
                (left, middle + half),
                (left + 1.6 * half, middle),
            ]
            draw.polygon(corners, _INK)
        font = _font(round(_TEXT * ratio * 0.9))
        draw.text((high + 14 * ratio, middle), _plain(label), _INK, font, anchor="lm")
        return _multiplied(image)


def _plain(text: str) -> str:
    """Return a text in characters that the font has."""
    return text.translate(_ASCII).encode("latin-1", "replace").decode("latin-1")


@cache
def _font(size: int) -> Any:
    """Return Pillow's own font: it is there wherever Pillow is."""
    return ImageFont.load_default(max(6, size))


def _paper(
    width: int, height: int, ratio: float
) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    image = Image.new("RGBA", (width, height))
    draw = ImageDraw.Draw(image)
    draw.rounded_rectangle((0, 0, width - 1, height - 1), _CORNER * ratio, _PAPER)
    return image, draw


def _multiplied(image: Image.Image) -> UInt8[np.ndarray, "h w 4"]:
    """Return the bytes with colours multiplied by alpha."""
    pixels = np.asarray(image, np.uint16)
    pixels = np.concatenate(
        [pixels[..., :3] * pixels[..., 3:] // 255, pixels[..., 3:]], axis=-1
    )
    return pixels.astype(np.uint8)
