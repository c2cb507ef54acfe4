"""Every wrong reading of a joint's numbers is named from the rotations that it gives."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsgen.contract.causes.pose_readings import (
    affine_motion,
    angles_of,
    covariance_errors,
    explain_turns,
    rigid_motion,
)

READINGS = {
    "radians were taken for degrees": lambda v: Rotation.from_rotvec(v, degrees=True),
    "radians were multiplied by 180/π": lambda v: Rotation.from_rotvec(v * 180 / np.pi),
    "rotations were inverted": lambda v: Rotation.from_rotvec(v).inv(),
    "angles were halved": lambda v: Rotation.from_rotvec(v / 2),
    "angles were doubled": lambda v: Rotation.from_rotvec(2 * v),
    "the numbers were Euler angles, R = Rz Ry Rx": lambda v: Rotation.from_euler("xyz", v),
    "the numbers were Euler angles, R = Rx Ry Rz": lambda v: Rotation.from_euler("XYZ", v),
    "the numbers were Euler angles, R = Ry Rx Rz": lambda v: Rotation.from_euler(
        "zxy", v[[2, 0, 1]]
    ),
    "axes were read as x −y −z": lambda v: Rotation.from_rotvec(v * [1, -1, -1]),
    "axes were read as z x y": lambda v: Rotation.from_rotvec(v[[2, 0, 1]]),
}


def rotation_vectors(seed: int, count: int = 6) -> np.ndarray:
    """Random rotation vectors of 0.5 to 1 radians, [count, 3]."""
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes * rng.uniform(0.5, 1.0, (count, 1)))


def quaternion(vector: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_rotvec(vector).as_quat(scalar_first=True))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", READINGS)
def test_a_wrong_reading_is_named(name: str, seed: int) -> None:
    turns = [(v, READINGS[name](v).as_matrix()) for v in rotation_vectors(seed)]
    explanation = explain_turns(turns)
    assert explanation is not None
    assert (explanation[0].name, explanation[1]) == (name, 1.0)
    assert explanation[0].is_certain is not name.startswith("axes")


@pytest.mark.parametrize("seed", range(3))
def test_quaternions_with_w_last_are_named(seed: int) -> None:
    # (w, x, y, z) taken for (x, y, z, w); at rest, each joint is half a turn about x.
    at_rest = Rotation.from_quat([1.0, 0, 0, 0])
    turns = []
    for number, vector in enumerate(rotation_vectors(seed)):
        values = quaternion(vector)
        seen = Rotation.from_quat(values) * at_rest.inv()
        frame = at_rest if number % 2 else Rotation.identity()  # that of the joint's parents
        turns.append((values, (frame * seen * frame.inv()).as_matrix()))
    explanation = explain_turns(turns)
    assert explanation is not None
    assert explanation[0].name == "quaternions w x y z were read as x y z w"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("numbers", [lambda v: v, quaternion], ids=["axis-angle", "quaternion"])
def test_right_and_arbitrary_turns_have_no_explanation(numbers, seed: int) -> None:  # type: ignore[no-untyped-def]
    vectors = rotation_vectors(seed)
    right = [(numbers(v), Rotation.from_rotvec(v).as_matrix()) for v in vectors]
    frames = Rotation.random(len(vectors), random_state=seed)
    own_frames = [
        (numbers(v), (f * Rotation.from_rotvec(v) * f.inv()).as_matrix())
        for v, f in zip(vectors, frames, strict=True)
    ]
    assert explain_turns(right) is None
    assert explain_turns(own_frames) is None  # rest frames of a rig's own
    assert explain_turns([]) is None


@pytest.mark.parametrize("angle", [1e-7, 1e-3, 1.0, np.pi])
def test_angles_and_motions_of_random_points(angle: float) -> None:
    rng = np.random.default_rng(1)
    rotation = Rotation.from_rotvec(angle * np.array([2.0, 3.0, 6.0]) / 7).as_matrix()
    assert angles_of(rotation) == pytest.approx(angle, rel=1e-6)
    points, offset = rng.standard_normal((20, 3)), rng.standard_normal(3)
    fitted, moved = rigid_motion(points, points @ rotation.T + offset)
    np.testing.assert_allclose(fitted, rotation, atol=1e-12)
    np.testing.assert_allclose(moved, offset, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_a_matrix_of_small_angles_is_named(seed: int) -> None:
    rest = np.random.default_rng(seed).standard_normal((12, 3))
    turns = [(v, affine_motion(rest, rest + np.cross(v, rest))[0]) for v in rotation_vectors(seed)]
    explanation = explain_turns(turns)
    assert explanation is not None
    assert "small angles" in explanation[0].name


@pytest.mark.parametrize("follows", [0, 1, 2], ids=["turned", "still", "backwards"])
def test_covariances_are_compared_with_each_way_to_turn(follows: int) -> None:
    rng = np.random.default_rng(3)
    rotation, upper = Rotation.random(random_state=3).as_matrix(), np.triu_indices(3)
    factors = rng.standard_normal((40, 3, 3))
    before = factors @ factors.transpose(0, 2, 1)
    turn = (rotation, np.eye(3), rotation.T)[follows]
    after = np.einsum("ij,njk,lk->nil", turn, before, turn)
    ball = np.eye(3)[None]  # has no direction, and is left out
    packed = [np.concatenate([part, ball])[:, *upper] for part in (before, after)]
    errors = covariance_errors(rotation, *packed)
    assert errors.shape == (3, 40)
    assert errors[follows].max() < 1e-12
    assert np.delete(errors, follows, axis=0).min() > 0.05
