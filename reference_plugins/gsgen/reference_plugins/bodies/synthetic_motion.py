"""Writes a synthetic motion in the layout of AMASS: a person who walks on the spot."""

__all__ = ["write_demo_motion", "write_motion"]

from pathlib import Path

import numpy as np
from jaxtyping import Float

# Joints of SMPL; the left one of each pair is at +x.
_HIP_JOINTS, _KNEE_JOINTS, _SHOULDER_JOINTS, _ELBOW_JOINTS = (1, 2), (4, 5), (16, 17), (18, 19)
_STRIDE_ANGLE, _BEND_ANGLE, _SWING_ANGLE = 0.55, 0.9, 0.6
_ARM_DOWN_ANGLE, _ELBOW_ANGLE = 1.25, 0.5  # arms hang down, slightly bent


def write_motion(path: Path, *, frames: int = 8, width: int = 156, seed: int = 0) -> Path:
    """Write a synthetic motion of two repeated steps in AMASS layout, and return the path.

    ``width`` is the count of numbers of a pose: 66, 72, 156 or 165.
    """
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, width)
    stride_phase = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    poses = 0.03 * np.sin(stride_phase[:, None] + phase[None])
    for side, sign in enumerate((1.0, -1.0)):
        step = sign * np.sin(stride_phase)
        leg_lift = np.clip(
            sign * np.cos(stride_phase), 0, None
        )  # a leg is bent while it moves forward
        _turn_joint(
            poses,
            _HIP_JOINTS[side],
            np.stack([-_STRIDE_ANGLE * step - 0.3 * leg_lift, 0 * step, 0 * step]),
        )
        _turn_joint(
            poses, _KNEE_JOINTS[side], np.stack([0.1 + _BEND_ANGLE * leg_lift, 0 * step, 0 * step])
        )
        _turn_joint(poses, _SHOULDER_JOINTS[side], _swing_arm(_SWING_ANGLE * step, sign))
        _turn_joint(
            poses,
            _ELBOW_JOINTS[side],
            np.stack([0 * step, 0 * step - sign * _ELBOW_ANGLE, 0 * step]),
        )
    np.savez(
        path,
        poses=poses,
        trans=np.stack(
            [0.02 * np.sin(stride_phase), 0.02 * np.cos(2 * stride_phase), 0 * stride_phase], axis=1
        ),
        betas=rng.normal(size=16),
        mocap_framerate=np.array(30.0),
        gender=np.array("neutral"),
    )
    return path


def write_demo_motion(folder: Path) -> list[str]:
    """Write a synthetic motion, and return the options that export an avatar with it."""
    motion = write_motion(folder / "walk.npz", frames=24)
    return ["--checkpoint", str(folder), "--motion", str(motion)]


def _turn_joint(
    poses: Float[np.ndarray, "f w"], joint: int, turn: Float[np.ndarray, "3 f"]
) -> None:
    poses[:, 3 * joint : 3 * joint + 3] += turn.T


def _swing_arm(swing_angles: Float[np.ndarray, " f"], sign: float) -> Float[np.ndarray, "3 f"]:
    """Return the axis-angle of a shoulder for a hanging arm that swings about x."""
    half_swing_angle, half_arm_angle = swing_angles / 2, -sign * _ARM_DOWN_ANGLE / 2
    # The product of two quaternions, (cos, sin, 0, 0) of the swing and (cos, 0, 0, sin).
    w = np.cos(half_swing_angle) * np.cos(half_arm_angle)
    vector = np.stack(
        [
            np.sin(half_swing_angle) * np.cos(half_arm_angle),
            -np.sin(half_swing_angle) * np.sin(half_arm_angle),
            np.cos(half_swing_angle) * np.sin(half_arm_angle),
        ]
    )
    length = np.linalg.norm(vector, axis=0)
    turn: Float[np.ndarray, "3 f"] = vector / length * 2 * np.arctan2(length, w)
    return turn
