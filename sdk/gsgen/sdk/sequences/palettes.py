"""Makes the palette of SH coefficients that the rows of a clip share, as SOG files do."""

__all__ = ["make_clip_palette"]

from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.formats.sog.palette import make_palette, nearest_entries
from gsgen.sdk.sequences.clip import Palette
from gsgen.sdk.sequences.quantisation import digit_table

_ROWS_PER_ENTRY: Final = 16
_MIN_ENTRIES, _MAX_ENTRIES = 256, 1 << 14
_LARGEST_DIGIT: Final = 127
# The share of coefficients beyond which they are clipped, so that one outlier does not coarsen all.
_CLIPPED_SHARE: Final = 1e-4


def make_clip_palette(coefficients: Float32[np.ndarray, "n k"]) -> Palette | None:
    """Return the palette of SH coefficients beyond the constant term; None if all are zero.

    Args:
        coefficients: Coefficients of each row of the source, coefficient-major.
    """
    if not coefficients.any():
        return None
    size = int(np.clip(len(coefficients) // _ROWS_PER_ENTRY, _MIN_ENTRIES, _MAX_ENTRIES))
    entries = coefficients
    if len(coefficients) > size:
        entries = make_palette(coefficients, size)
    largest = float(np.quantile(np.abs(entries), 1 - _CLIPPED_SHARE)) or float(
        np.abs(entries).max()
    )
    step = largest / _LARGEST_DIGIT
    table = digit_table([np.clip(entries, -largest, largest).T], np.ones((1, 1)), [step])
    stored = table.at(np.ones(1)).T.astype(np.float32)
    return Palette(table, nearest_entries(coefficients, stored))
