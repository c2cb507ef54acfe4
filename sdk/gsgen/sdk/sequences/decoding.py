"""Decodes a moment of a clip in float64, to compare models and sources with it."""

__all__ = ["decode_moment"]

import numpy as np
from jaxtyping import Float64

from gsgen.sdk.sequences.clip import SIZE_STEP, Clip, RowGroup, knot_weights


def decode_moment(
    clip: Clip, time: float
) -> tuple[Float64[np.ndarray, "n 10"], Float64[np.ndarray, "n c"]]:
    """Return the packed rows and the appearance of a clip at a time in [0, 1]."""
    weights = knot_weights(time, clip.frames, loop=clip.loop)
    rows = np.concatenate([_group_rows(group, weights) for group in clip.groups])
    color = np.concatenate([group.color.at(weights).T for group in clip.groups])
    if clip.space == "rgb":
        color = color.clip(0, 1)
    if clip.palette is not None:
        entries = clip.palette.entries.at(np.ones(1)).T
        color = np.concatenate([color, entries[clip.palette.labels]], axis=1)
    return rows, color


def _group_rows(group: RowGroup, weights: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, "n 10"]:
    size = group.size_unit * np.exp(SIZE_STEP * (group.size.astype(np.float64) - 128))
    position = group.place.at(weights)
    if group.motion is not None:
        position = position + group.motion.at(weights) * size
    l00, l10, l20, l11, l21, l22 = group.factors.at(weights) * size
    return np.stack(
        [
            *position,
            (group.opacity.at(weights)[0] + 0.5).clip(0, 1),
            l00 * l00,
            l00 * l10,
            l00 * l20,
            l10 * l10 + l11 * l11,
            l10 * l20 + l11 * l21,
            l20 * l20 + l21 * l21 + l22 * l22,
        ],
        axis=1,
    )
