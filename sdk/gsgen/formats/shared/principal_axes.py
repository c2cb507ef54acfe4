"""Decomposes covariances of many Gaussians into scales and rotations, by NumPy on all at once."""

__all__ = ["scales_and_quaternions", "variances_and_quaternions"]

from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64

_CHUNK_ROWS: Final = 1 << 13  # at a time, which stay in the cache
_SMALLEST_DIVISOR: Final = 1e-150  # in place of 0 below a fraction: its square is a float64, too
# 2 cos(arccos(r) / 3) for r from 0 to 1, to 7.3e-5: a cubic polynomial, the constant term first
_ROOT_COEFFICIENTS: Final = (1.73212365, 0.33080901, -0.08176291, 0.01888736)
_NEWTON_STEPS: Final = 2  # to 4.6e-9, then to the rounding of float64
# Of upper triangles xx xy xz yy yz zz: those of the diagonal and those beside it, each followed by
# its first two again.
_CYCLIC_INDICES: Final = [0, 3, 5, 0, 3, 4, 2, 1, 4, 2]
_SWAP_AXES: Final = (2, 0, 2)  # the axes about which swaps sort three scales
# For each axis r, (w, q) and (r, p): a turn about it mixes w with r, and q with p, where p and q are
# the axes that follow r.
_QUATERNION_PAIRS: Final = (
    (slice(0, None, 3), slice(1, 3)),
    (slice(0, 2), slice(2, 4)),
    (slice(0, None, 2), slice(3, None, -2)),
)

Column = Float64[np.ndarray, " n"]
Vectors = Float64[np.ndarray, "3 n"]
Quaternions = Float32[np.ndarray, "4 n"]
Floats = Float32[np.ndarray, " n"]


def scales_and_quaternions(
    covariance: Float[np.ndarray, "n 6"],
) -> tuple[Float64[np.ndarray, "n 3"], Float32[np.ndarray, "n 4"]]:
    """Decompose covariances into standard deviations and quaternions.

    Scales are in scene units, and 0 where rounding made an eigenvalue negative; see
    :func:`variances_and_quaternions`.
    """
    variances, quaternions = variances_and_quaternions(covariance)
    return np.sqrt(np.maximum(variances, 0)).T.copy(), quaternions


def variances_and_quaternions(
    covariance: Float[np.ndarray, "n 6"],
) -> tuple[Float64[np.ndarray, "3 n"], Float32[np.ndarray, "n 4"]]:
    """Decompose covariances into variances along their axes, and quaternions.

    The variances ascend. Of the quaternions that differ by the signs of two axes, the one with the
    smallest angle is returned. Each row's result depends on the row alone, bit for bit.

    Args:
        covariance: Upper triangles xx xy xz yy yz zz, in squared scene units; finite.

    Returns:
        Variances in squared scene units, which rounding may have made negative, a column for each
        row; and unit quaternions (w, x, y, z) whose w is positive, and the largest component.
    """
    variances = np.empty((3, len(covariance)))
    quaternions = np.empty((len(covariance), 4), np.float32)
    for start in range(0, len(covariance), _CHUNK_ROWS):
        part = slice(start, start + _CHUNK_ROWS)
        diagonal, quaternion = _diagonalize_covariance(
            covariance[part].T.astype(np.float64, order="C")
        )
        _sort_axes(diagonal, quaternion)
        _choose_smallest_rotation_form(quaternion)
        variances[:, part] = diagonal
        for component in range(4):  # one after the other, several times as fast as turn.T
            quaternions[part, component] = quaternion[component]
    return variances, quaternions


def _diagonalize_covariance(covariance: Float64[np.ndarray, "6 n"]) -> tuple[Vectors, Quaternions]:
    """Return eigenvalues, and eigenvectors as quaternions that are not normalised.

    1. The eigenvalue that is farthest from the two others has a well-conditioned eigenvector v.
    2. The smallest rotation that takes z to v leaves a 2×2 matrix of the x and y axes.
    3. One Jacobi rotation about z makes that diagonal.
    """
    xx, xy, xz, yy, yz, zz = covariance
    trace = xx + yy + zz
    axis, third_eigenvalue = _separate_principal_axis(covariance, trace * (1 / 3))
    # The rotation 1 + vz − vy i + vx j has the columns u, t and v.
    vx, vy, vz = axis
    w = 1 + vz
    x_share, y_share = vx / w, vy / w
    ux, uy = 1 - vx * x_share, -vy * x_share
    ty = 1 - vy * y_share
    # The covariance times u = (ux, uy, −vx)
    x = xx * ux + xy * uy - xz * vx
    y = xy * ux + yy * uy - yz * vx
    z = xz * ux + yz * uy - zz * vx
    first_diagonal = ux * x + uy * y - vx * z
    off_diagonal = uy * x + ty * y - vy * z
    second_diagonal = trace - third_eigenvalue
    second_diagonal -= first_diagonal
    # tan φ = ± 2 b / (|d| + √(d² + 4 b²)): the smaller angle, 0 where there is nothing to do
    difference, doubled_off_diagonal = second_diagonal - first_diagonal, off_diagonal + off_diagonal
    length = np.sqrt(
        difference * difference + doubled_off_diagonal * doubled_off_diagonal
    ) + np.abs(difference)
    tangent = doubled_off_diagonal / np.copysign(np.maximum(length, _SMALLEST_DIVISOR), difference)
    shift = tangent * off_diagonal
    variances = np.stack([first_diagonal - shift, second_diagonal + shift, third_eigenvalue])
    tangent /= np.sqrt(tangent * tangent + 1) + 1  # of φ / 2
    # Quaternions are float32 from here on, of which half as many bytes are moved.
    vx, vy, vz = axis.astype(np.float32)
    w, half_angle_tangent = 1 + vz, tangent.astype(np.float32)
    quaternion = np.stack(
        [w, -vy - half_angle_tangent * vx, vx - half_angle_tangent * vy, -half_angle_tangent * w]
    )
    return variances, quaternion


def _separate_principal_axis(
    covariance: Float64[np.ndarray, "6 n"], mean: Column
) -> tuple[Vectors, Column]:
    """Return the eigenvector whose eigenvalue is farthest from the others, and that eigenvalue.

    The eigenvalues are mean + spread β, for the roots β of β³ − 3β − det B, where B is the
    covariance minus its mean, divided by its spread. The farthest root is at least √3, or at most
    −√3 (O. K. Smith, "Eigenvalues of a symmetric 3×3 matrix", 1961). The columns of the adjugate of
    B − β, which is adj B + βB + β², are multiples of the eigenvector. Its z is not negative.
    """
    cyclic_covariances = covariance[_CYCLIC_INDICES].reshape(2, 5, -1)
    cyclic_covariances[0] -= mean
    squares = np.square(cyclic_covariances[:, :3])
    squares[0] += squares[1]
    squares[0] += squares[1]
    deviation = np.sqrt(squares[0].sum(axis=0) * (1 / 6))
    cyclic_covariances *= 1 / np.maximum(deviation, _SMALLEST_DIVISOR)
    upper = cyclic_covariances[:, :3]  # of B: the diagonal, and what is beside it
    adjugate = cyclic_covariances[:, 1:4] * cyclic_covariances[:, 2:]
    adjugate -= upper[1] * upper[::-1]
    products = upper * adjugate
    determinant = products[0, 0] + products[1, 1] + products[1, 2]
    root = np.copysign(_farthest_root(np.abs(determinant)), determinant)
    adjugate += upper * root
    adjugate[0] += root * root
    # The column with the largest entry of the diagonal, by factors of 0 and 1
    xx, yy, zz, yz, xz, xy = adjugate.reshape(6, -1)
    is_z = (zz > np.maximum(xx, yy)).astype(np.float64)
    is_y = (yy > xx) * (1 - is_z)
    is_x = 1 - is_y - is_z
    axis = np.stack(
        [
            xx * is_x + xy * is_y + xz * is_z,
            xy * is_x + yy * is_y + yz * is_z,
            xz * is_x + yz * is_y + zz * is_z,
        ]
    )
    axis /= np.copysign(np.sqrt(np.square(axis).sum(axis=0)), axis[2])
    return axis, mean + deviation * root


def _farthest_root(determinant: Column) -> Column:
    """Return the root from √3 to 2 of β³ − 3β − ``determinant``, which is 0 to 2.

    Newton's method, whose slope is at least 6 there, from a polynomial.
    """
    half_determinant = 0.5 * determinant
    root = _ROOT_COEFFICIENTS[3] * half_determinant
    for coefficient in _ROOT_COEFFICIENTS[2:0:-1]:
        root += coefficient
        root *= half_determinant
    root += _ROOT_COEFFICIENTS[0]
    for _ in range(_NEWTON_STEPS):
        square = root * root
        step = square - 3
        step *= root
        step -= determinant
        square -= 1
        square *= 3
        step /= square
        root -= step
    return root


def _rotate_about_axis(
    quaternion: Quaternions, axis: int, sine: Floats, cosine: Floats | None = None
) -> None:
    """Rotate quaternions by −θ about one of their own axes: by a factor cos θ/2 − sin θ/2 e.

    Without a cosine it is 1, ``sine`` is tan θ/2, and the result is not normalised.
    """
    left, right = (quaternion[pair] for pair in _QUATERNION_PAIRS[axis])
    left_change, right_change = sine * right, sine * left
    if cosine is not None:
        quaternion *= cosine
    left += left_change
    right -= right_change


def _sort_axes(variances: Vectors, quaternion: Quaternions) -> None:
    """Sort eigenvalues in place by swaps of two axes, which are quarter turns about the third."""
    for axis in _SWAP_AXES:
        low, high = variances[(axis + 1) % 3], variances[(axis + 2) % 3]
        swapped_mask = (low > high).astype(np.float32)  # 0 or 1: tan 0° or tan 45°
        smaller = np.minimum(low, high)
        np.maximum(low, high, out=high)
        low[:] = smaller
        _rotate_about_axis(quaternion, axis, swapped_mask)


def _choose_smallest_rotation_form(quaternion: Quaternions) -> None:
    """Rotate the axes of ellipsoids by half turns until w is the quaternions' largest component.

    Half turns about own axes keep the covariance. The quaternions are normalised, in place.
    """
    # 1. Where y or z is the largest, a half turn about y makes it w or x.
    length = np.abs(quaternion)
    is_beyond_half_turn = np.maximum(length[2], length[3]) > np.maximum(length[0], length[1])
    sine = is_beyond_half_turn.astype(np.float32)
    _rotate_about_axis(quaternion, 1, sine, 1 - sine)
    # 2. Where x is larger than w, a half turn about x exchanges them.
    sine = (np.abs(quaternion[1]) > np.abs(quaternion[0])).astype(np.float32)
    _rotate_about_axis(quaternion, 0, sine, 1 - sine)
    quaternion /= np.copysign(np.sqrt((quaternion * quaternion).sum(axis=0)), quaternion[0])
