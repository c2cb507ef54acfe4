"""Rotations and covariances of Gaussians in float64, the reference for other implementations."""

__all__ = [
    "COVARIANCE_INDEX",
    "PSD_FLOOR",
    "PSD_SLACK",
    "clearly_positive",
    "covariance_upper",
    "look_at",
    "perspective",
    "quaternion_product",
    "rotation_matrix",
    "smallest_eigenvalue",
    "symmetric",
]

import numpy as np

from gsgen.contract._array_types import Bool, Float

# The upper triangle xx xy xz yy yz zz, as (row, column) of the 3×3 matrix.
COVARIANCE_INDEX = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))

# Negative eigenvalues within rounding, by item size: relative to the trace, and absolute for
# three entries that are each off by half of the smallest float16 step, 2⁻²⁴.
PSD_SLACK = {2: 2.0**-10, 4: 1e-5}
PSD_FLOOR = {2: 3 * 2.0**-25, 4: 0.0}
# The rounding error of a determinant in float32, relative to its largest terms, and the size
# below which terms lose bits.
_DET_RELATIVE_ERROR = np.float32(2e-6)
_DET_FLOOR = np.float32(1e-30)


def rotation_matrix(quaternion: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the rotation matrices of quaternions (w, x, y, z), which need not be normalised.

    A zero quaternion has no direction; it gives the identity, as w = 1 would. One that holds
    NaN gives NaN.
    """
    matrices = np.empty((len(quaternion), 3, 3))
    for i, row in enumerate(_rotation_elements(quaternion)):
        for j, element in enumerate(row):
            matrices[:, i, j] = element
    return matrices


def _rotation_elements(quaternion: Float[np.ndarray, "n 4"]) -> list[list[Float[np.ndarray, " n"]]]:
    """Return the elements of rotation matrices, each as one array over all quaternions."""
    q = np.array(np.transpose(quaternion), np.float64, order="C")  # whole columns are fast
    norm = np.sqrt((q * q).sum(axis=0))
    is_zero = norm == 0
    q /= np.where(is_zero, 1, norm)
    q[0, is_zero] = 1
    w, x, y, z = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def quaternion_product(
    left: Float[np.ndarray, "4"], right: Float[np.ndarray, "*n 4"]
) -> Float[np.ndarray, "*n 4"]:
    """Return the Hamilton products of quaternions (w, x, y, z): rotate by ``right``, then ``left``."""
    w, x, y, z = left
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(right.astype(np.float64) @ matrix.T)


def rotation_vector(quaternion: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3"]:
    """Return axis times angle, in radians and at most π, of quaternions (w, x, y, z) of either sign.

    Source: J. Solà 2017, "Quaternion kinematics for the error-state Kalman filter", equation 105a.
    """
    quaternion = np.where(quaternion[..., :1] < 0, -quaternion, quaternion).astype(np.float64)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, quaternion[..., :1])
    return np.asarray(angle / np.maximum(sine, np.finfo(np.float64).tiny) * quaternion[..., 1:])


def rotation_quaternion(vector: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 4"]:
    """Return unit quaternions (w, x, y, z) of axes times angles, in radians."""
    half_angle = np.linalg.norm(vector, axis=-1, keepdims=True).astype(np.float64) / 2
    # sin(x) / x without a division by 0; NumPy's sinc has π in it.
    return np.concatenate([np.cos(half_angle), vector * np.sinc(half_angle / np.pi) / 2], axis=-1)


def covariance_upper(
    scale: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 6"]:
    """Return the upper triangle of Σ = R S Sᵀ Rᵀ (Kerbl et al. 2023, equation 6).

    Args:
        scale: Linear standard deviations along the local axes.
        rotation: Quaternions (w, x, y, z), normalised here.
    """
    axes = np.array(np.transpose(scale), np.float64, order="C")
    m = [
        [element * axis for element, axis in zip(row, axes, strict=True)]
        for row in _rotation_elements(rotation)
    ]
    upper = np.empty((len(scale), 6))
    for column, (i, j) in enumerate(zip(*COVARIANCE_INDEX, strict=True)):
        upper[:, column] = m[i][0] * m[j][0] + m[i][1] * m[j][1] + m[i][2] * m[j][2]
    return upper


def symmetric(upper: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the symmetric 3×3 matrices of upper triangles xx xy xz yy yz zz."""
    return np.asarray(upper, np.float64)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


def smallest_eigenvalue(upper: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, " n"]:
    """Return the smallest eigenvalue of symmetric 3×3 matrices, by the closed formula.

    Source: O. K. Smith 1961, "Eigenvalues of a symmetric 3 × 3 matrix".
    """
    xx, xy, xz, yy, yz, zz = np.asarray(upper, np.float64).T
    mean = (xx + yy + zz) / 3
    off_diagonal_sum = xy * xy + xz * xz + yz * yz
    spread = np.sqrt(
        ((xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2 * off_diagonal_sum) / 6
    )
    nonzero_spread = np.where(spread > 0, spread, 1)
    a, b, c = (
        (xx - mean) / nonzero_spread,
        (yy - mean) / nonzero_spread,
        (zz - mean) / nonzero_spread,
    )
    d, e, f = xy / nonzero_spread, xz / nonzero_spread, yz / nonzero_spread
    half_determinant = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    angle = np.arccos(np.clip(half_determinant, -1, 1)) / 3
    return np.asarray(mean + 2 * spread * np.cos(angle + 2 * np.pi / 3))


def clearly_positive(upper: Float[np.ndarray, "6 n"], slack: float) -> Bool[np.ndarray, " n"]:
    """Return the mask of symmetric matrices that clearly pass Sylvester's criterion, with slack.

    Args:
        upper: Columns xx xy xz yy yz zz in float32.
        slack: Addition to the diagonal, as a share of the trace.
    """
    xx, xy, xz, yy, yz, zz = upper
    diagonal_slack = np.float32(slack) * (xx + yy + zz)
    a, b, c = xx + diagonal_slack, yy + diagonal_slack, zz + diagonal_slack
    minor = a * b - xy * xy
    subtracted_terms = a * yz * yz + b * xz * xz
    det = c * minor - subtracted_terms + 2 * xy * xz * yz
    det_error = np.maximum(_DET_RELATIVE_ERROR * (a * b * c + subtracted_terms), _DET_FLOOR)
    return np.asarray((a > 0) & (minor > 0) & (det > det_error))


def look_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return the world→camera matrix of an OpenCV camera (+x right, +y down, +z forward).

    Args:
        eye: The camera centre, in world units.
        target: The point it looks at; must differ from ``eye``.
        up: The world's upward direction; need be neither unit nor orthogonal.
    """
    forward = np.asarray(target, np.float64) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(up):  # looking along `up`
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])  # any will do
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    view = np.eye(4)
    view[:3, :3] = rotation
    view[:3, 3] = -rotation @ eye
    return view


def perspective(fov_x: float, aspect: float, near: float, far: float) -> Float[np.ndarray, "4 4"]:
    """Return the camera→clip matrix of an OpenCV camera, depth 0..1 (column vectors).

    Args:
        fov_x: Horizontal field of view, in radians.
        aspect: Width over height.
        near: Distance of the near plane, > 0.
        far: Distance of the far plane, > ``near``.
    """
    focal = 1 / np.tan(fov_x / 2)
    matrix = np.zeros((4, 4))
    matrix[0, 0] = focal
    matrix[1, 1] = -focal * aspect  # clip space has +y up, the camera +y down
    matrix[2, 2] = far / (far - near)
    matrix[2, 3] = -near * far / (far - near)
    matrix[3, 2] = 1
    return matrix
