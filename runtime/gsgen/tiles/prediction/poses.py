"""Camera poses over time: differences of rotations, and interpolation."""

__all__ = ["Pose", "interpolate", "matrix_quaternion", "rotation_quaternion", "rotation_vector"]

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import quaternion_product

Quaternion = Float64[np.ndarray, " 4"]
Vector = Float64[np.ndarray, " 3"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A camera's position and rotation at one time.

    Attributes:
        time: In seconds.
        position: Camera centre, in the root frame.
        quaternion: Camera → root frame, (w, x, y, z), unit length; OpenCV axes.
        focal: Focal length as that of the frustum; None where it does not change.
    """

    time: float
    position: Vector
    quaternion: Quaternion
    focal: float | None = None


def matrix_quaternion(rotation: Float64[np.ndarray, "3 3"]) -> Quaternion:
    """Return the unit quaternion of a rotation matrix (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    symmetric_matrix = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    quaternion = np.linalg.eigh(symmetric_matrix)[1][:, -1]
    return np.asarray(quaternion if quaternion[0] >= 0 else -quaternion)


def rotation_vector(quaternion: Quaternion) -> Vector:
    """Return a quaternion's axis × angle in radians, at most π: the same for q and −q."""
    if quaternion[0] < 0:
        quaternion = -quaternion
    sine = float(np.linalg.norm(quaternion[1:]))
    if sine < 1e-12:
        return 2 * quaternion[1:]
    return np.asarray(quaternion[1:] * (2 * np.arctan2(sine, quaternion[0]) / sine))


def rotation_quaternion(vector: Vector) -> Quaternion:
    """Return the unit quaternion of a rotation vector, axis × angle in radians."""
    x, y, z = vector.tolist()
    angle = math.hypot(x, y, z)
    scale = 0.5 if angle < 1e-12 else math.sin(angle / 2) / angle
    quaternion = (math.cos(angle / 2), x * scale, y * scale, z * scale)
    return np.array(quaternion) / math.hypot(*quaternion)


def interpolate(poses: Sequence[Pose], time: float) -> Pose:
    """Interpolate a camera pose at a time; the first and the last pose hold outside the path.

    Positions go straight, rotations at constant speed the shorter way round.
    """
    if time <= poses[0].time or len(poses) == 1:
        return Pose(time, poses[0].position, poses[0].quaternion)
    if time >= poses[-1].time:
        return Pose(time, poses[-1].position, poses[-1].quaternion)
    next_index = next(index for index, pose in enumerate(poses) if pose.time >= time)
    low, high = poses[next_index - 1], poses[next_index]
    share = (time - low.time) / (high.time - low.time)
    inverse = low.quaternion * [1, -1, -1, -1]
    turn = rotation_vector(quaternion_product(high.quaternion, inverse))
    quaternion = quaternion_product(rotation_quaternion(turn * share), low.quaternion)
    return Pose(time, low.position + share * (high.position - low.position), quaternion)
