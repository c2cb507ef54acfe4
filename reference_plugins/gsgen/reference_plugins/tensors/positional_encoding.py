"""Encodes coordinates and times by sines and cosines of growing frequency, for networks."""

__all__ = ["POINT_OCTAVES", "encoded_size", "positional_encoding"]

import torch
from jaxtyping import Float
from torch import Tensor

POINT_OCTAVES = 10
"""Octaves of a point's encoding in the published methods."""


def encoded_size(size: int, octaves: int) -> int:
    """Return the number of columns of a positional encoding."""
    return size * (2 * octaves + 1)


def positional_encoding(values: Float[Tensor, "n k"], octaves: int) -> Float[Tensor, "n m"]:
    """Return x, sin x, cos x, sin 2x, cos 2x, … side by side, up to 2^(octaves − 1)."""
    parts = [values]
    for octave in range(octaves):
        angle = values * 2.0**octave
        parts.append(torch.cat([torch.sin(angle), torch.cos(angle)], dim=1))
    while len(parts) > 1:  # in groups: no concatenation takes more than four tensors
        parts = [torch.cat(parts[i : i + 4], dim=1) for i in range(0, len(parts), 4)]
    return parts[0]
