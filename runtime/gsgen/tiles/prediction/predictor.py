"""Predictors of camera poses: where will the camera be?"""

__all__ = ["ConstantVelocity", "Predictor"]

import math
from collections import deque
from collections.abc import Sequence
from typing import Final, Protocol, final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import quaternion_product, rotation_quaternion, rotation_vector
from gsgen.tiles.prediction.poses import Pose

VELOCITY_WINDOW: Final = 0.5
"""Seconds of the past from which constant velocity is taken."""
TURN_SECONDS: Final = 0.4
"""After this time a predicted turn has 1 − 1/e of the angle at which it ends.

Heads and mice turn in short bursts: at a constant rate, the cameras of people are predicted to look
83° off after two seconds.
"""


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

    def predict(self, seconds_ahead: Sequence[float]) -> list[Pose]:
        """Return the predicted poses, in seconds after the last frame; none after too few frames."""
        ...


@final
class ConstantVelocity:
    """Predicts that the camera keeps the velocity of the last half second, and stops to turn.

    After s seconds it has turned by rate × τ (1 − exp(−s / τ)), with τ of :data:`TURN_SECONDS`.
    """

    name = "constant-velocity"
    reach = 10.0

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque()

    def observe(self, pose: Pose) -> None:
        """Record the camera pose of a frame."""
        self._poses.append(pose)
        while len(self._poses) > 2 and self._poses[1].time < pose.time - VELOCITY_WINDOW:
            self._poses.popleft()

    def predict(self, seconds_ahead: Sequence[float]) -> list[Pose]:
        """Return the predicted camera poses, in seconds after the last frame."""
        if len(self._poses) < 2 or self._poses[-1].time <= self._poses[0].time:
            return []
        last = self._poses[-1]
        velocity, rate = _pose_velocity(self._poses[0], last)
        return [
            Pose(
                last.time + seconds,
                last.position + velocity * seconds,
                quaternion_product(
                    rotation_quaternion(-rate * TURN_SECONDS * math.expm1(-seconds / TURN_SECONDS)),
                    last.quaternion,
                ),
            )
            for seconds in seconds_ahead
        ]


def _pose_velocity(
    first: Pose, last: Pose
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
    """Return the mean velocity and rotation rate between two poses, in the tileset's root frame."""
    seconds = last.time - first.time
    inverse = first.quaternion * [1, -1, -1, -1]
    turn = rotation_vector(quaternion_product(last.quaternion, inverse))
    return (last.position - first.position) / seconds, turn / seconds
