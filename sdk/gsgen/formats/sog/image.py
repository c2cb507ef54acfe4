"""Decodes the images of a SOG file with Pillow, after a check of their size."""

import warnings
from io import BytesIO

import numpy as np
from jaxtyping import UInt8

from gsgen.formats.shared.bytes import DOWNLOAD_HINT
from gsgen.formats.shared.errors import ArchiveDamaged, FileTruncated, HeaderMalformed, NotSupported

Image = UInt8[np.ndarray, "p 4"]


def most_pixels(needed: int) -> int:
    """Return the largest number of pixels that an image of ``needed`` values may have."""
    return 2 * needed + (1 << 16)


def decode_image(content: bytes, needed: int, where: str, width: int | None = None) -> Image:
    """Return the first ``needed`` pixels of a WebP image as red, green, blue and alpha.

    Raises:
        ArchiveDamaged: The content is not WebP, or cannot be unpacked.
        NotSupported: Pillow is not installed.
        FileTruncated: The image has too few pixels.
        HeaderMalformed: The image has far too many pixels, or another ``width``.
    """
    try:
        from PIL import Image as pillow  # noqa: N813 -- a module
    except ImportError as error:
        raise NotSupported(
            "is a WebP image, and Pillow is not installed",
            where=where,
            hint="pip install 'gsgen[formats]'",
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pillow.DecompressionBombWarning)
            opened = pillow.open(BytesIO(content), formats=["WEBP"])
        _require_size(opened.size, needed, where, width)
        pixels = np.asarray(opened.convert("RGBA"))
    # Pillow documents OSError, but damage also raises ValueError, SyntaxError and others.
    except (FileTruncated, HeaderMalformed):
        raise
    except Exception as error:
        raise ArchiveDamaged(
            f"an image cannot be unpacked ({type(error).__name__}: {error})",
            where=where,
            expected="lossless WebP",
            hint=DOWNLOAD_HINT,
        ) from error
    return np.asarray(pixels.reshape(-1, 4)[:needed])


def _require_size(size: tuple[int, int], needed: int, where: str, width: int | None) -> None:
    pixels = size[0] * size[1]
    message = f"an image of {size[0]} × {size[1]} pixels"
    if pixels < needed:
        raise FileTruncated(message, where=where, expected=f"{needed} pixels or more")
    if pixels > most_pixels(needed) or (width is not None and size[0] != width):
        row_note = f", {width} in a row" if width is not None else ""
        raise HeaderMalformed(message, where=where, expected=f"about {needed} pixels{row_note}")
