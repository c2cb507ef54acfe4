"""Predictors of camera poses: where will the camera be, and how certain is that?"""

__all__ = ["ConstantVelocity", "Prediction", "Predictor"]

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol, final

import numpy as np
from jaxtyping import Float64

from gsgen.tiles.prediction.poses import (
    Pose,
    quaternion_product,
    rotation_quaternion,
    rotation_vector,
)

WINDOW: Final = 0.5
"""Seconds of the past from which constant velocity is taken."""

_DRIFT: Final = 0.15  # standard deviation of a velocity, as a share of it
_LEAST_DEVIATION: Final = 1e-6


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prediction:
    """Predicted camera poses, one per row, with their uncertainty.

    Attributes:
        position: Camera centres in the root frame, [k, 3].
        quaternion: Camera → root frame, (w, x, y, z), unit length, [k, 4].
        deviation: Standard deviations, [k, 6]: of the centre along the root frame's axes, then of
            the rotation about them, in radians; all above 0.
    """

    position: Float64[np.ndarray, "k 3"]
    quaternion: Float64[np.ndarray, "k 4"]
    deviation: Float64[np.ndarray, "k 6"]


class Predictor(Protocol):
    """Protocol: predicts camera poses from the poses of past frames.

    Attributes:
        name: For messages.
        reach: Seconds ahead that it can tell.
    """

    name: str
    reach: float

    def observe(self, pose: Pose) -> None:
        """Record the camera pose of a frame; times ascend."""
        ...

    def predict(self, ahead: Sequence[float]) -> Prediction | None:
        """Return predicted camera poses after the last frame; None if too few frames are known."""
        ...


@final
class ConstantVelocity:
    """Predicts that the camera keeps the velocity and rotation rate of the last half second."""

    name = "constant-velocity"
    reach = 10.0

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque()

    def observe(self, pose: Pose) -> None:
        """Record the camera pose of a frame."""
        self._poses.append(pose)
        while len(self._poses) > 2 and self._poses[1].time < pose.time - WINDOW:
            self._poses.popleft()

    def predict(self, ahead: Sequence[float]) -> Prediction | None:
        """Return the predicted camera poses, in seconds after the last frame."""
        if len(self._poses) < 2 or self._poses[-1].time <= self._poses[0].time:
            return None
        first, last = self._poses[0], self._poses[-1]
        middle = self._poses[len(self._poses) // 2]
        velocity, rate = _velocity(first, last)
        change, rate_change = np.zeros(3), np.zeros(3)
        if first.time < middle.time < last.time:
            early, late = _velocity(first, middle), _velocity(middle, last)
            half = (last.time - first.time) / 2
            change, rate_change = (late[0] - early[0]) / half, (late[1] - early[1]) / half
        times = np.array(ahead, np.float64)[:, None]
        # What half of the acceleration that is seen would add, if it went on.
        spread = _DRIFT * np.linalg.norm(velocity) * times + np.abs(change) * times**2 / 4
        turn_spread = _DRIFT * np.linalg.norm(rate) * times + np.abs(rate_change) * times**2 / 4
        return Prediction(
            position=last.position + velocity * times,
            quaternion=np.array(
                [quaternion_product(rotation_quaternion(rate * t), last.quaternion) for t in ahead]
            ),
            deviation=np.maximum(np.hstack([spread, turn_spread]), _LEAST_DEVIATION),
        )


def _velocity(
    first: Pose, last: Pose
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
    """Return the mean velocity and rotation rate between two poses, in the tileset's root frame."""
    seconds = last.time - first.time
    inverse = first.quaternion * [1, -1, -1, -1]
    turn = rotation_vector(quaternion_product(last.quaternion, inverse))
    return (last.position - first.position) / seconds, turn / seconds
