"""Compare an image with what a method's own code computed: some of its numbers, evenly spread."""

from pathlib import Path

import numpy as np

# Shares of the range of images: of float32 in another order, and how much better than a tolerance.
ALLOWED, MARGIN = 2e-5, 3


def image_error(
    path: Path, image: np.ndarray, *, limits: tuple[float, float] | None = None
) -> float:
    """Return the largest difference of an image from a golden, which ``limits`` clip.

    The golden may have more rows and columns, which are left out.
    """
    golden = np.load(path)
    shape = tuple(golden["shape"])
    batch, channel, row, column = np.unravel_index(golden["index"], shape)
    inside = (row < image.shape[2]) & (column < image.shape[3])
    assert shape[2] - image.shape[2] in range(8)
    assert shape[3] - image.shape[3] in range(8)
    expected = golden["values"][inside].astype(np.float64)
    expected = expected if limits is None else np.clip(expected, *limits)
    places = batch[inside], channel[inside], row[inside], column[inside]
    return float(np.abs(image[places].astype(np.float64) - expected).max())


def assert_image_golden(
    path: Path,
    image: np.ndarray,
    allowed: float = ALLOWED,
    *,
    limits: tuple[float, float] | None = None,
) -> None:
    """Demand that an image agrees with a golden."""
    error = image_error(path, image, limits=limits)
    assert error <= allowed, error
