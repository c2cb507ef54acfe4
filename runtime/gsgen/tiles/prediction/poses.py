"""Camera poses over time, and interpolation between them."""

__all__ = ["Pose", "interpolate", "matrix_quaternion"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import quaternion_product, rotation_quaternion, rotation_vector

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
