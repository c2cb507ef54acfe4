"""The value that a runtime feeds to an input as long as it has no other one."""

__all__ = ["default_tensor"]

import numpy as np

from gsgen.contract.spec.fields.roles import MATRIX_ROLES
from gsgen.contract.spec.manifest import Input


def default_tensor(declared: Input, shape: tuple[int, ...]) -> np.ndarray:
    """Return the default value that the generator contract defines for the role of an input.

    The manifest's specification defines it under "default"; matrices are as in mathematics.

    Raises:
        ValueError: The declared default has another number of elements than ``shape``.
    """
    default = declared.default
    if default is None:
        low = declared.range[0] if declared.range else 0.0
        default = "identity" if declared.role in MATRIX_ROLES else low
    if default == "zeros":
        return np.zeros(shape)
    if default == "identity":
        return _identity_values(declared.role, shape)
    values = np.asarray(default, np.float64)
    if values.ndim and values.size != np.prod(shape):
        raise ValueError(f"default has {values.size} numbers, expected {int(np.prod(shape))}")
    return values.reshape(shape) if values.ndim else np.full(shape, values)


def _identity_values(role: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return the identity transform in a given shape: a matrix, quaternions or rotation vectors."""
    if role != "pose" and len(shape) >= 2 and shape[-1] == shape[-2]:
        return np.broadcast_to(np.eye(shape[-1]), shape).copy()
    identity_values = np.zeros(shape)  # rotation vectors
    if shape[-1:] == (4,):
        identity_values[..., 0] = 1.0  # quaternions (w, x, y, z)
    return identity_values
