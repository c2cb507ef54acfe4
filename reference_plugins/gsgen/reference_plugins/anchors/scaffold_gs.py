"""Scaffold-GS: networks decode anchors to Gaussians for each camera.

Lu et al. 2024, "Scaffold-GS: Structured 3D Gaussians for View-Adaptive Rendering", section 3.2:
centres μ_k = x + O_k · l, opacities α = F_α(f, δ, d), the same form for colour, rotation and
scale, and the feature bank, whose weights are softmax(F_w(δ, d)).
"""

__all__ = ["ScaffoldGS"]

from typing import final

from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.anchors.anchor_generator import AnchorGenerator


@final
class ScaffoldGS(AnchorGenerator):
    """Scaffold-GS as a generator model whose anchors are visible from every camera."""

    def visible_share(self, centre: Float[Tensor, "1 3"]) -> None:
        """Return None, because every anchor of Scaffold-GS is fully visible from all cameras."""
        return
