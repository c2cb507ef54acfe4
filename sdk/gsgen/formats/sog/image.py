"""Decodes and encodes the images of a SOG file with Pillow; sizes are checked before decoding."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import UInt8

from gsgen.formats.shared.bytes import DOWNLOAD_HINT
from gsgen.formats.shared.errors import ArchiveDamaged, FileTruncated, HeaderMalformed, NotSupported

Image = UInt8[np.ndarray, "p 4"]


def most_pixels(needed: int) -> int:
    """Return the largest allowed pixel count of a SOG image with ``needed`` used pixels."""
    return 2 * needed + (1 << 16)


def image_size(content: bytes, where: str) -> tuple[int, int]:
    """Return the width and height of a WebP image, in pixels, without decoding it.

    Raises:
        ArchiveDamaged: The content is not WebP.
        NotSupported: Pillow is not installed.
    """
    with _opening(content, where) as image:
        width, height = image.size
        return width, height


def decode_image(content: bytes, needed: int, where: str, width: int | None = None) -> Image:
    """Decode the first ``needed`` pixels of a WebP image to red, green, blue and alpha.

    Raises:
        ArchiveDamaged: The content is not WebP, or cannot be unpacked.
        NotSupported: Pillow is not installed.
        FileTruncated: The image has too few pixels.
        HeaderMalformed: The image has far too many pixels, or another ``width``.
    """
    with _opening(content, where) as image:
        _require_size(image.size, needed, where, width)
        pixels = np.asarray(image.convert("RGBA"))
    return np.asarray(pixels.reshape(-1, 4)[:needed])


@contextmanager
def _opening(content: bytes, where: str) -> Iterator[Any]:
    """Open a WebP image with Pillow; damage raises ArchiveDamaged."""
    pillow_module = _import_pillow(where)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pillow_module.DecompressionBombWarning)
            opened_image = pillow_module.open(BytesIO(content), formats=["WEBP"])
        yield opened_image
    # Pillow documents OSError, but damage also raises ValueError, SyntaxError and others.
    except (FileTruncated, HeaderMalformed):
        raise
    except Exception as error:
        raise ArchiveDamaged(
            f"the SOG image cannot be unpacked ({type(error).__name__}: {error})",
            where=where,
            expected="lossless WebP",
            hint=DOWNLOAD_HINT,
        ) from error


def encode_image(pixels: Image, width: int | None = None) -> bytes:
    """Encode pixels, row by row, as lossless WebP; zeros fill the last row.

    Args:
        pixels: Red, green, blue and alpha.
        width: The pixels of a row; about the square root of their number if None.

    Raises:
        NotSupported: Pillow is not installed.
    """
    width = width or 4 * math.ceil(math.sqrt(len(pixels)) / 4)
    table = np.zeros((-(-len(pixels) // width) * width, 4), np.uint8)
    table[: len(pixels)] = pixels
    stream = BytesIO()
    image = _import_pillow("WebP").fromarray(table.reshape(-1, width, 4))
    # Higher qualities take ten times as long for 0.1 % of the bytes. `exact` keeps the colours
    # of transparent pixels.
    image.save(stream, "WEBP", lossless=True, exact=True, method=4, quality=70)
    return stream.getvalue()


def _import_pillow(where: str) -> ModuleType:
    try:
        from PIL import Image as pillow  # noqa: N813 -- a module
    except ImportError as error:
        raise NotSupported(
            "SOG images need Pillow, which is not installed",
            where=where,
            hint="pip install 'gsgen[formats]'",
        ) from error
    return pillow


def _require_size(size: tuple[int, int], needed: int, where: str, width: int | None) -> None:
    pixels = size[0] * size[1]
    message = f"an image of {size[0]} × {size[1]} pixels"
    if pixels < needed:
        raise FileTruncated(message, where=where, expected=f"{needed} pixels or more")
    if pixels > most_pixels(needed) or (width is not None and size[0] != width):
        row_note = f", {width} in a row" if width is not None else ""
        raise HeaderMalformed(message, where=where, expected=f"about {needed} pixels{row_note}")
