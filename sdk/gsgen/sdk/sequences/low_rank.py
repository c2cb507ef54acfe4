"""Finds the few components whose weighted sums are the values of many rows in all frames.

The singular vectors over the frames are the eigenvectors of the Gram matrix Y Yᵀ [F, F] (Eckart
and Young 1936), which is summed over blocks of rows.
"""

__all__ = ["Basis", "find_basis"]

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Orthonormal weights over the frames, most important first, and the error that they leave.

    Attributes:
        weights: Weight of each component in each frame.
        residual: Largest root mean square error of a frame with the first r components, for r = 0
            to the number of components.
    """

    weights: Float64[np.ndarray, "f r"]
    residual: Float64[np.ndarray, " r1"]

    def rank(self, tolerance: float) -> int:
        """Return the smallest number of components whose error is at most the tolerance."""
        is_enough = self.residual <= tolerance
        return int(is_enough.argmax()) if is_enough.any() else len(self.residual) - 1


def find_basis(gram: Float64[np.ndarray, "f f"], count: int) -> Basis:
    """Return the best weights over the frames for values with a Gram matrix.

    Args:
        gram: Sum over all values of the products of two frames.
        count: Number of values of a frame.
    """
    energies, vectors = np.linalg.eigh(gram)
    energies, vectors = np.maximum(energies[::-1], 0), vectors[:, ::-1]
    # The squared error of frame k without component j is λ_j v_kj².
    parts = energies * vectors * vectors
    left = np.concatenate([np.cumsum(parts[:, ::-1], axis=1)[:, ::-1], np.zeros((len(gram), 1))], 1)
    return Basis(vectors, np.sqrt(left.max(axis=0) / max(count, 1)))
