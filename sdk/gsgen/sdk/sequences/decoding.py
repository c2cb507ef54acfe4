"""Decodes a moment of a clip in float64, to compare models and sources with it."""

__all__ = ["decode_moment"]

import numpy as np
from jaxtyping import Float64

from gsgen.sdk.sequences.clip import Clip, RowGroup, knot_weights, sizes_of
from gsgen.sdk.sequences.frame_store import covariance_of


def decode_moment(
    clip: Clip, time: float
) -> tuple[Float64[np.ndarray, "n 10"], Float64[np.ndarray, "n c"]]:
    """Return the packed rows and the appearance of a clip at a time in [0, 1]."""
    weights = knot_weights(time, clip.frames, clip.knots)
    rows = np.concatenate([_group_rows(group, weights) for group in clip.groups])
    color = np.concatenate([group.color.at(weights).T for group in clip.groups])
    if clip.space == "rgb":
        color = color.clip(0, 1)
    if clip.palette is not None:
        entries = clip.palette.entries.at(np.ones(1)).T
        color = np.concatenate([color, entries[clip.palette.labels]], axis=1)
    return rows, color


def _group_rows(group: RowGroup, weights: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, "n 10"]:
    size = sizes_of(group.size, group.size_unit)
    position = group.place.at(weights)
    if group.motion is not None:
        position = position + group.motion.at(weights) * size
    opacity = (group.opacity.at(weights) + 0.5).clip(0, 1)
    return np.concatenate([position, opacity, covariance_of(group.factors.at(weights) * size)]).T
