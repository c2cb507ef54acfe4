"""Affine transforms from an object's local space to the world."""

__all__ = ["identity", "moved", "require_affine"]

from typing import Final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.errors import SceneInvalid

# The inverse of a worse matrix would lose more digits than float32 has.
_MAX_CONDITION_NUMBER: Final = 1e6


def identity() -> Float[np.ndarray, "4 4"]:
    """Return the identity transform, [4, 4]."""
    return np.eye(4)


def moved(
    transform: Float[np.ndarray, "4 4"], origin: tuple[float, float, float]
) -> Float[np.ndarray, "4 4"]:
    """Return a local → world transform for positions that are relative to a local origin."""
    if not any(origin):
        return transform
    matrix = transform.copy()
    matrix[:3, 3] += matrix[:3, :3] @ origin
    return matrix


def require_affine(matrix: Float[np.ndarray, "4 4"], where: str = "transform") -> None:
    """Raise if a local → world matrix is not affine or not invertible.

    Args:
        matrix: Local → world, acting on column vectors.
        where: Location in errors.

    Raises:
        SceneInvalid: The matrix is not 4 × 4, not finite, not affine, or singular.
    """
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise SceneInvalid(
            f"the matrix is {matrix.tolist()}, expected 4 rows of 4 finite numbers", where=where
        )
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise SceneInvalid(
            f"the matrix has the last row {matrix[3].tolist()}, expected 0 0 0 1", where=where
        )
    sizes = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    if not sizes[2] * _MAX_CONDITION_NUMBER > sizes[0]:
        raise SceneInvalid(
            f"the matrix is singular: it scales by {', '.join(f'{size:.3g}' for size in sizes)}",
            where=where,
            hint="Use a scale other than zero along every axis.",
        )
