"""Draws the viewer's text panels and time slider as small images."""

__all__ = ["Slider", "paragraph"]

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, final

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

_TEXT_SIZE_PIXELS: Final = 14  # logical pixels
_LINE_HEIGHT: Final = 1.45  # text sizes
_MARGIN_PIXELS: Final = 10
_CORNER_RADIUS: Final = 6
_ASCII_REPLACEMENTS: Final = str.maketrans({"–": "-", "—": "-", "×": "x", "’": "'", "…": "..."})
_BACKGROUND_RGBA: Final = (16, 18, 22, 190)
_WHITE_RGBA: Final = (236, 238, 242, 255)
_GREY_RGBA: Final = (150, 156, 166, 255)
_ORANGE_RGBA: Final = (255, 176, 64, 255)


def paragraph(rows: Sequence[tuple[str, str]], ratio: float = 1.0) -> UInt8[np.ndarray, "h w 4"]:
    """Draw a panel of two columns of text; ``ratio`` is surface pixels per logical pixel."""
    rows = [(_printable_text(left), _printable_text(right)) for left, right in rows]
    font, size = _font(round(_TEXT_SIZE_PIXELS * ratio)), _TEXT_SIZE_PIXELS * ratio
    margin, line = round(_MARGIN_PIXELS * ratio), round(size * _LINE_HEIGHT)
    first = max((font.getlength(left) for left, right in rows if right), default=0.0)
    column = round(first + 1.2 * size) if first else 0
    widths = [
        (column + font.getlength(right)) if right else font.getlength(left) for left, right in rows
    ]
    width = round(max(widths, default=0.0)) + 2 * margin
    image, draw = _blank_panel(width, line * len(rows) + 2 * margin - round(size * 0.4), ratio)
    for number, (left, right) in enumerate(rows):
        top = margin + number * line - round(size * 0.1)
        draw.text((margin, top), left, _ORANGE_RGBA if right else _WHITE_RGBA, font)
        draw.text((margin + column, top), right, _WHITE_RGBA, font)
    return _premultiply_alpha(image)


@final
@dataclass(frozen=True, slots=True)
class Slider:
    """The layout of the time slider; ``ratio`` is surface pixels per logical pixel."""

    width: int
    height: int
    ratio: float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the time slider's panel, in pixels."""
        return max(1, self.width - 2 * self._edge_margin), round(34 * self.ratio)

    @property
    def corner(self) -> tuple[int, int]:
        """The upper left corner of the time slider's panel, in pixels of the surface."""
        return self._edge_margin, max(0, self.height - self.size[1] - self._edge_margin)

    @property
    def _edge_margin(self) -> int:
        return round(_MARGIN_PIXELS * self.ratio)

    def _slider_track_ends(self) -> tuple[float, float]:
        """Return both ends of the time slider's track, in pixels from the left of its panel."""
        width = self.size[0]
        return min(34 * self.ratio, width / 2), max(width - 130 * self.ratio, width / 2 + 1)

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point of the window's surface is on the time slider's panel."""
        left, top = self.corner
        return 0 <= x - left < self.size[0] and 0 <= y - top < self.size[1]

    def is_on_button(self, x: float) -> bool:
        """Return whether a point of the time slider's panel is on the play button."""
        return x - self.corner[0] < self._slider_track_ends()[0] - 6 * self.ratio

    def fraction(self, x: float) -> float:
        """Return the position of a point along the time slider's track, from 0 to 1."""
        low, high = self._slider_track_ends()
        return float(np.clip((x - self.corner[0] - low) / (high - low), 0, 1))

    def picture(self, fraction: float, label: str, *, playing: bool) -> UInt8[np.ndarray, "h w 4"]:
        """Draw the time slider, with the knob at a ``fraction`` and a label at the end."""
        (width, height), ratio, (low, high) = self.size, self.ratio, self._slider_track_ends()
        image, draw = _blank_panel(width, height, ratio)
        middle, knob_radius = height / 2, 6 * ratio
        draw.line((low, middle, high, middle), _GREY_RGBA, max(1, round(2 * ratio)))
        value = low + (high - low) * fraction
        draw.line((low, middle, value, middle), _ORANGE_RGBA, max(1, round(3 * ratio)))
        draw.ellipse(
            (value - knob_radius, middle - knob_radius, value + knob_radius, middle + knob_radius),
            _WHITE_RGBA,
        )
        left, half_width = 12 * ratio, 6 * ratio
        if playing:
            for start in (left, left + half_width):
                draw.rectangle(
                    (start, middle - half_width, start + half_width / 2, middle + half_width),
                    _WHITE_RGBA,
                )
        else:
            corners = [
                (left, middle - half_width),
                (left, middle + half_width),
                (left + 1.6 * half_width, middle),
            ]
            draw.polygon(corners, _WHITE_RGBA)
        font = _font(round(_TEXT_SIZE_PIXELS * ratio * 0.9))
        draw.text(
            (high + 14 * ratio, middle), _printable_text(label), _WHITE_RGBA, font, anchor="lm"
        )
        return _premultiply_alpha(image)


def _printable_text(text: str) -> str:
    """Replace characters that Pillow's built-in font lacks."""
    return text.translate(_ASCII_REPLACEMENTS).encode("latin-1", "replace").decode("latin-1")


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's built-in font, which needs no font file."""
    return ImageFont.load_default(max(6, size))


def _blank_panel(width: int, height: int, ratio: float) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    image = Image.new("RGBA", (width, height))
    draw = ImageDraw.Draw(image)
    draw.rounded_rectangle((0, 0, width - 1, height - 1), _CORNER_RADIUS * ratio, _BACKGROUND_RGBA)
    return image, draw


def _premultiply_alpha(image: Image.Image) -> UInt8[np.ndarray, "h w 4"]:
    """Return the pixels of an image with colours multiplied by alpha."""
    pixels = np.asarray(image, np.uint16)
    pixels = np.concatenate([pixels[..., :3] * pixels[..., 3:] // 255, pixels[..., 3:]], axis=-1)
    return pixels.astype(np.uint8)
