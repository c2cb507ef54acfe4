"""The data class of Gaussians to be merged, sorted along Morton's curve."""

__all__ = ["Mixture", "concatenate", "surface_area"]

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt64

_THOMSEN_EXPONENT: Final = 1.6075


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mixture:
    """Gaussians to be merged, sorted by Morton code.

    Attributes:
        code: Morton codes; a merged Gaussian has the code of its first member, so that it stays
            in the cells of its members regardless of how its centre is rounded.
        mean: Centres, in scene units.
        covariance: Upper triangles xx xy xz yy yz zz.
        scale: Standard deviations along the axes of ``rotation``, in scene units.
        rotation: Unit quaternions (w, x, y, z).
        opacity: In [0, 1].
        sh: Spherical harmonics, coefficient-major.
    """

    code: UInt64[np.ndarray, " n"]
    mean: Float64[np.ndarray, "n 3"]
    covariance: Float64[np.ndarray, "n 6"]
    scale: Float64[np.ndarray, "n 3"]
    rotation: Float32[np.ndarray, "n 4"]
    opacity: Float64[np.ndarray, " n"]
    sh: Float32[np.ndarray, "n k 3"]

    def __len__(self) -> int:
        return len(self.code)

    @property
    def mass(self) -> Float64[np.ndarray, " n"]:
        """The weight of each Gaussian in its cluster: opacity times surface area."""
        return np.asarray(self.opacity * surface_area(self.scale))

    def rows(self, index: "np.ndarray | slice") -> "Mixture":
        """Return the Gaussians at the given row indices."""
        return Mixture(**{name: getattr(self, name)[index] for name in self.__slots__})


def concatenate(parts: Sequence[Mixture]) -> Mixture:
    """Join sets of Gaussians and sort them by Morton code; equal codes keep their order."""
    names = Mixture.__slots__
    joined_mixture = Mixture(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )
    if len(parts) == 1 or bool((joined_mixture.code[1:] >= joined_mixture.code[:-1]).all()):
        return joined_mixture
    return joined_mixture.rows(np.argsort(joined_mixture.code, kind="stable"))


def surface_area(scale: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Return the surface areas of one-standard-deviation ellipsoids (Thomsen 2004)."""
    a, b, c = np.asarray(scale, np.float64).T
    largest = np.maximum(np.maximum(a, b), c)
    unit = np.where(largest > 0, largest, 1.0)  # powers of tiny numbers would vanish
    a, b, c = (np.power(axis / unit, _THOMSEN_EXPONENT) for axis in (a, b, c))
    mean = (a * b + a * c + b * c) / 3
    return np.asarray(4 * math.pi * unit**2 * np.power(mean, 1 / _THOMSEN_EXPONENT))
