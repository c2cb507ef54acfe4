"""The mathematics that generators share, in torch, in forms that survive export.

Two hazards shape these functions. The exporter removes ``x + c`` for c below 1e-8, so an epsilon
that guards a norm disappears: a clamp under the square root stays. And boolean indexing gives
shapes that depend on data, which graph capture refuses: masks multiply instead.
"""

__all__ = ["covariance_upper", "quaternion_to_matrix", "safe_normalize"]

import torch
from jaxtyping import Float
from torch import Tensor

_TINY = 1e-24


def safe_normalize(
    vector: Float[Tensor, "... k"], *, smallest: float = _TINY
) -> Float[Tensor, "... k"]:
    """Return ``vector`` at unit length; the zero vector stays zero instead of becoming NaN.

    Args:
        vector: Any vectors, along the last axis.
        smallest: Lower bound of the squared length, above float32's smallest normal 1.2e-38.
    """
    squared = (vector * vector).sum(dim=-1, keepdim=True)
    return vector * torch.rsqrt(squared.clamp(min=smallest))


def quaternion_to_matrix(quaternion: Float[Tensor, "... 4"]) -> Float[Tensor, "... 3 3"]:
    """Turn quaternions (w, x, y, z), normalised here, into rotation matrices."""
    w, x, y, z = safe_normalize(quaternion).unbind(dim=-1)
    entries = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )
    return torch.stack(entries, dim=-1).reshape(*quaternion.shape[:-1], 3, 3)


def covariance_upper(
    scale: Float[Tensor, "n 3"], rotation: Float[Tensor, "n 4"]
) -> Float[Tensor, "n 6"]:
    """Return xx xy xz yy yz zz of Σ = R S Sᵀ Rᵀ (Kerbl et al. 2023, equation 6).

    Args:
        scale: Linear standard deviations along the local axes.
        rotation: Quaternions (w, x, y, z), normalised here.

    Written out entry by entry: six dot products of rows of R S, and no batched 3×3 product,
    which costs more than twice the arithmetic.
    """
    rows = (quaternion_to_matrix(rotation) * scale[:, None, :]).unbind(dim=1)
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    return torch.stack([(rows[a] * rows[b]).sum(dim=-1) for a, b in pairs], dim=-1)
