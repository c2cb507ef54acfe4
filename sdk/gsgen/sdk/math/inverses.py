"""Inverse matrices in closed form: ONNX has no operator for them."""

__all__ = ["inverse_3x3"]

import torch
from jaxtyping import Float
from torch import Tensor

# Determinants below this size count as zero.
_MIN_DETERMINANT = 1e-30


def inverse_3x3(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 3 3"]:
    """Return the inverses of 3×3 matrices, by cofactors.

    The contract runs every model with all inputs zero, too, where ``torch.linalg.inv`` of a view
    matrix raises. Of a singular matrix, this function returns the adjugate, which is finite.
    """
    a, b, c = matrix.unbind(dim=-2)
    # The columns of the adjugate are cross products of the rows.
    columns = [_cross_product(b, c), _cross_product(c, a), _cross_product(a, b)]
    determinant = (a * columns[0]).sum(dim=-1)[..., None, None]
    is_singular = determinant.abs() < _MIN_DETERMINANT
    divisor = torch.where(is_singular, torch.ones_like(determinant), determinant)
    return torch.stack(columns, dim=-1) / divisor


def _cross_product(a: Float[Tensor, "*n 3"], b: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    (ax, ay, az), (bx, by, bz) = a.unbind(dim=-1), b.unbind(dim=-1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=-1)
