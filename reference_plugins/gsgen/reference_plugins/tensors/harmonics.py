"""Evaluates spherical harmonics as one sum of tensors per coefficient."""

__all__ = ["harmonic_sum"]

from collections.abc import Iterator, Sequence

from jaxtyping import Float
from torch import Tensor


def harmonic_sum(
    coefficients: Sequence[Float[Tensor, "n c"]], direction: Float[Tensor, "n 3"]
) -> Float[Tensor, "n c"]:
    """Evaluate spherical harmonics in a direction (degree 0 to 3, signs as in 3DGS)."""
    x, y, z = direction[:, 0:1], direction[:, 1:2], direction[:, 2:3]
    basis_values = _basis_functions(x, y, z)
    total = coefficients[0] * next(basis_values)
    for coefficient, function in zip(coefficients[1:], basis_values, strict=False):
        total = total + coefficient * function
    return total


def _basis_functions(x: Tensor, y: Tensor, z: Tensor) -> Iterator[Tensor | float]:
    """Yield the real SH basis functions in the order of 3DGS (Kerbl et al. 2023, its code)."""
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
