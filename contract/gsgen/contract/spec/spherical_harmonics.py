"""Real spherical harmonics in the sign convention of 3D Gaussian Splatting.

Source: Kerbl et al. 2023, "3D Gaussian Splatting for Real-Time Radiance Field
Rendering" (the constants of its published code), and the appendix of the glTF
extension KHR_gaussian_splatting, which lists the same polynomials.
"""

__all__ = [
    "MAX_DEGREE",
    "SH_COEFFICIENT_COUNTS",
    "SH_DC",
    "basis",
    "coefficients",
    "degree_of",
    "evaluate",
    "largest_sum",
]

import math

import numpy as np

from gsgen.contract._array_types import Float

MAX_DEGREE = 3
SH_COEFFICIENT_COUNTS = tuple((degree + 1) ** 2 for degree in range(MAX_DEGREE + 1))

# The constant basis function: colours are 0.5 + SH_DC · f_dc.
SH_DC = 0.5 * math.sqrt(1 / math.pi)
_SH_DEGREE_1 = math.sqrt(3 / (4 * math.pi))
_SH_DEGREE_2 = (0.5 * math.sqrt(15 / math.pi), 0.25 * math.sqrt(5 / math.pi))
_SH_DEGREE_3 = (
    0.25 * math.sqrt(35 / (2 * math.pi)),
    0.5 * math.sqrt(105 / math.pi),
    0.25 * math.sqrt(21 / (2 * math.pi)),
    0.25 * math.sqrt(7 / math.pi),
)


def coefficients(degree: int) -> int:
    """Return K, the number of SH coefficients up to ``degree``: (degree + 1)²."""
    return (degree + 1) ** 2


def degree_of(count: int) -> int:
    """Return the SH degree that ``count`` coefficients have.

    Raises:
        ValueError: ``count`` is not 1, 4, 9 or 16.
    """
    if count not in SH_COEFFICIENT_COUNTS:
        raise ValueError(
            f"{count} is not a number of SH coefficients: expected one of {SH_COEFFICIENT_COUNTS}"
        )
    return SH_COEFFICIENT_COUNTS.index(count)


def basis(
    directions: Float[np.ndarray, "... 3"], degree: int = MAX_DEGREE
) -> Float[np.ndarray, "... k"]:
    """Evaluate the (degree + 1)² SH basis functions at unit ``directions``, in float64."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    columns = [np.full_like(x, SH_DC)]
    if degree >= 1:
        columns += [-_SH_DEGREE_1 * y, _SH_DEGREE_1 * z, -_SH_DEGREE_1 * x]
    if degree >= 2:
        columns += [
            _SH_DEGREE_2[0] * x * y,
            -_SH_DEGREE_2[0] * y * z,
            _SH_DEGREE_2[1] * (2 * zz - xx - yy),
            -_SH_DEGREE_2[0] * x * z,
            0.5 * _SH_DEGREE_2[0] * (xx - yy),
        ]
    if degree >= 3:
        columns += [
            -_SH_DEGREE_3[0] * y * (3 * xx - yy),
            _SH_DEGREE_3[1] * x * y * z,
            -_SH_DEGREE_3[2] * y * (4 * zz - xx - yy),
            _SH_DEGREE_3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -_SH_DEGREE_3[2] * x * (4 * zz - xx - yy),
            0.5 * _SH_DEGREE_3[1] * z * (xx - yy),
            -_SH_DEGREE_3[0] * x * (xx - 3 * yy),
        ]
    return np.stack(columns, axis=-1)


def largest_sum(
    weights: Float[np.ndarray, "d k"], sh: Float[np.ndarray, "n k c"]
) -> Float[np.ndarray, " n"]:
    """Return the largest absolute SH sum of each Gaussian, over given directions and channels.

    ``weights`` are values of :func:`basis`; one matrix product serves all rows.
    """
    count, _, channels = sh.shape
    rows = np.swapaxes(sh, 1, 2).reshape(count * channels, weights.shape[1])
    color_sums = np.abs(rows @ weights.T).reshape(count, channels * len(weights))
    return np.asarray(color_sums.max(axis=1))


def evaluate(
    sh: Float[np.ndarray, "n k 3"], directions: Float[np.ndarray, "d 3"]
) -> Float[np.ndarray, "n d 3"]:
    """Return the SH colour of every Gaussian in every direction: max(0, 0.5 + Σ Y_k c_k).

    Args:
        sh: Coefficient-major coefficients, K = 1, 4, 9 or 16.
        directions: Unit vectors from the camera centre to the Gaussian, in local space.
    """
    weights = basis(directions, degree_of(sh.shape[1]))
    color = 0.5 + np.einsum("dk,nkc->ndc", weights, np.asarray(sh, np.float64))
    return np.asarray(np.maximum(color, 0.0))
