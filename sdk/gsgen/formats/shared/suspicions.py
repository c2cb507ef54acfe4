"""Looks for values that are valid and probably wrong: activated scales and opacities."""

__all__ = ["SAMPLED_ROWS", "suspicions", "warn_of_suspicions"]

import math
import os
import warnings
from typing import Final

import numpy as np

from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splat_values import valid_rows
from gsgen.formats.shared.splats import Splats

SAMPLED_ROWS: Final = 1 << 13
"""The rows that are looked at, evenly spread over the file."""

_MIN_ROW_COUNT: Final = 16
_MIN_OPACITY_SPREAD: Final = 0.5  # between the lowest and the highest
_MAX_SIZE_IN_SPACINGS: Final = 3.0  # the usual size of splats, in distances between them


def suspicions(splats: Splats, count: int | None = None) -> list[str]:
    """Return what the values of splats look like if they are probably wrong; usually nothing.

    Args:
        splats: The splats, or a sample of them.
        count: The number of all splats, if these are a sample.
    """
    count = len(splats) if count is None else count
    sample = splats[:: max(1, len(splats) // SAMPLED_ROWS)]
    sample = sample[valid_rows(sample)]
    if len(sample) < _MIN_ROW_COUNT:
        return []
    messages = []
    if _has_activated_scales(sample, count):
        messages.append(
            "all scales are positive: linear, not logarithms? (Splats are far larger "
            "than the distances between them, as if exp was applied twice.)"
        )
    opacity = sample.logit_opacity
    # Opacities of a trained scene are spread; nearly equal ones may be meant.
    if 0 <= opacity.min() < opacity.max() - _MIN_OPACITY_SPREAD and opacity.max() <= 1:
        messages.append(
            "all opacities lie from 0 to 1: activated, not logits? (The picture is half "
            "transparent, as if the sigmoid was applied twice.)"
        )
    return messages


def _has_activated_scales(sample: Splats, count: int) -> bool:
    """Return whether scales look like sizes where logarithms belong.

    All are positive then, and their exponentials exceed the distance of neighbours on a surface
    of the scene's extent.
    """
    if sample.log_scale.min() < 0 or sample.log_scale.max() <= 0:
        return False
    low, high = np.percentile(sample.position, [2, 98], axis=0)
    spacing = float(np.linalg.norm(high - low)) / math.sqrt(count)
    return float(np.exp(np.median(sample.log_scale))) > _MAX_SIZE_IN_SPACINGS * spacing


def warn_of_suspicions(
    splats: Splats, path: str | os.PathLike[str], count: int | None = None
) -> None:
    """Warn if the values of a file's splats are probably wrong."""
    for message in suspicions(splats, count):
        warnings.warn(f"{os.fspath(path)}: {message}", FormatWarning, stacklevel=2)
