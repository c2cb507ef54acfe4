"""Colours of sampled Gaussians as a viewer shows them, without the view-dependent part."""

__all__ = ["SH_OFFSET", "displayed_colors"]

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.spec.spherical_harmonics import SH_DC

# The offset that viewers add to the sum of SH.
SH_OFFSET = 0.5


def displayed_colors(sample: DrawnSample) -> Float[np.ndarray, "e 3"] | None:
    """Return the unclamped RGB of sampled Gaussians; None if the appearance cannot be read."""
    if sample.even_color is None or sample.emission.declared is None:
        return None
    color = sample.even_color[:, :3]
    return SH_OFFSET + SH_DC * color if sample.emission.is_sh else color
