"""Translates, rotates and scales splats, including their spherical harmonics."""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import quaternion_product, rotation_matrix
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.harmonics import rotate_sh
from gsgen.formats.shared.origins import near_zero
from gsgen.formats.shared.splats import Splats

Vector = tuple[float, float, float]


def translated(splats: Splats, offset: Vector) -> Splats:
    """Return ``splats`` moved by ``offset``, in scene units."""
    x, y, z = (float(start + step) for start, step in zip(splats.origin, offset, strict=True))
    moved = near_zero(replace(splats, origin=(x, y, z)))
    # Rounding of the sum counts only where the positions of the file needed an origin.
    return moved if any(splats.origin) else replace(moved, rounding=splats.rounding)


def scaled(splats: Splats, factor: float) -> Splats:
    """Return ``splats`` with the positions of the file, and sizes, multiplied by ``factor``.

    Raises:
        ValueInvalid: ``factor`` is not a finite number above 0.
    """
    if not 0 < factor < math.inf:
        raise ValueInvalid(
            f"the factor is {factor:g}", where="scale", expected="a finite number above 0"
        )
    return replace(
        splats,
        position=(splats.position * np.float64(factor)).astype(np.float32),
        log_scale=(splats.log_scale + math.log(factor)).astype(np.float32),
        origin=_vector(factor * np.asarray(splats.origin)),
        rounding=factor * splats.rounding,
    )


def rotated(splats: Splats, angles: Vector) -> Splats:
    """Return ``splats`` rotated about 0, 0, 0 of the file, including their spherical harmonics.

    Args:
        splats: The splats.
        angles: Degrees about the axes x, y and z, which do not move, in this order.
    """
    quaternion = np.array([1.0, 0, 0, 0])
    for axis, angle in enumerate(angles):
        half_angle = math.radians(angle) / 2
        step = np.zeros(4)
        step[[0, 1 + axis]] = math.cos(half_angle), math.sin(half_angle)
        quaternion = quaternion_product(step, quaternion[None])[0]
    matrix = rotation_matrix(quaternion[None])[0]
    return replace(
        splats,
        position=(splats.position @ matrix.T).astype(np.float32),
        rotation=quaternion_product(quaternion, splats.rotation).astype(np.float32),
        sh=rotate_sh(splats.sh, matrix),
        origin=_vector(matrix @ splats.origin),
    )


def _vector(numbers: Float64[np.ndarray, "3"]) -> Vector:
    x, y, z = (float(number) + 0.0 for number in numbers)  # no -0
    return x, y, z
