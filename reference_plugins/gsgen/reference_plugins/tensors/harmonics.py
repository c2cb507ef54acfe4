"""Evaluates spherical harmonics as one sum of tensors per coefficient."""

__all__ = ["harmonic_sum", "max_brightness"]

import math
from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def harmonic_sum(
    coefficients: Sequence[Float[Tensor, "n c *m"]], direction: Float[Tensor, "n 3 *m"]
) -> Float[Tensor, "n c *m"]:
    """Evaluate spherical harmonics in a unit direction (degree 0 to 4, signs as in 3DGS)."""
    x, y, z = direction[:, 0:1], direction[:, 1:2], direction[:, 2:3]
    basis_values = _basis_functions(x, y, z)
    total = coefficients[0] * next(basis_values)
    for coefficient, function in zip(coefficients[1:], basis_values, strict=False):
        total = total + coefficient * function
    return total


def _basis_functions(x: Tensor, y: Tensor, z: Tensor) -> Iterator[Tensor | float]:
    """Yield the real SH basis functions in the order of 3DGS and, of degree 4, of PlenOctrees."""
    xx, yy, zz = x * x, y * y, z * z
    yield 0.28209479177387814
    yield -0.4886025119029199 * y
    yield 0.4886025119029199 * z
    yield -0.4886025119029199 * x
    yield 1.0925484305920792 * (x * y)
    yield -1.0925484305920792 * (y * z)
    yield 0.31539156525252005 * (2 * zz - xx - yy)
    yield -1.0925484305920792 * (x * z)
    yield 0.5462742152960396 * (xx - yy)
    yield -0.5900435899266435 * (y * (3 * xx - yy))
    yield 2.890611442640554 * (x * y * z)
    yield -0.4570457994644658 * (y * (4 * zz - xx - yy))
    yield 0.3731763325901154 * (z * (2 * zz - 3 * xx - 3 * yy))
    yield -0.4570457994644658 * (x * (4 * zz - xx - yy))
    yield 1.445305721320277 * (z * (xx - yy))
    yield -0.5900435899266435 * (x * (xx - 3 * yy))
    yield 2.5033429417967046 * (x * y * (xx - yy))
    yield -1.7701307697799304 * (y * z * (3 * xx - yy))
    yield 0.9461746957575601 * (x * y * (7 * zz - 1))
    yield -0.6690465435572892 * (y * z * (7 * zz - 3))
    yield 0.10578554691520431 * (zz * (35 * zz - 30) + 3)
    yield -0.6690465435572892 * (x * z * (7 * zz - 3))
    yield 0.47308734787878004 * ((xx - yy) * (7 * zz - 1))
    yield -1.7701307697799304 * (x * z * (xx - 3 * yy))
    yield 0.6258357354491761 * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))


def max_brightness(coefficients: Float[Tensor, "n k 3"]) -> float:
    """Return an upper bound of the Gaussians' RGB in any direction, rounded up to a tenth.

    For each degree l, |Σ Y c| ≤ ‖c‖ √((2l + 1) / 4π).
    """
    total = torch.full_like(coefficients[:, 0], 0.5)
    for degree in range(math.isqrt(coefficients.shape[1])):
        part = coefficients[:, degree**2 : (degree + 1) ** 2]
        total = total + part.norm(dim=1) * math.sqrt((2 * degree + 1) / (4 * math.pi))
    return max(1.0, math.ceil(10 * float(total.max())) / 10)
