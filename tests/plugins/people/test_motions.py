"""Motions of people: what is read, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsgen.reference_plugins.bodies.motions import read_motion
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.synthetic import write_motion
from plugins.people.harmful_pickles import Harmful
from support.hostile.motions import MOTIONS
from support.hostile.motions import write_motion as write_damaged_motion


@pytest.mark.parametrize("joints", [24, 55])
@pytest.mark.parametrize("width", [66, 72, 156, 165])
def test_poses_of_one_body_become_those_of_another(width: int, joints: int, tmp_path: Path) -> None:
    path = write_motion(tmp_path / "a.npz", frames=3, width=width)
    with np.load(path) as read:
        poses = read["poses"]
    motion = read_motion(path, joints)
    assert motion.pose.shape == (3, joints, 3)
    assert motion.fps == 30
    flat = motion.pose.reshape(3, -1)
    np.testing.assert_allclose(flat[:, :66], poses[:, :66])
    has_hands = width >= 156 and joints == 55
    tail = flat[:, -90:] if joints == 55 else flat[:, 66:]
    if has_hands:
        np.testing.assert_allclose(tail, poses[:, -90:])
    elif width == 72 and joints == 24:
        np.testing.assert_allclose(tail, poses[:, 66:])
    else:
        assert not tail.any()


@pytest.mark.parametrize("name", sorted({*MOTIONS, "pipe.npz"} - {"rate_is_empty.npz"}))
def test_a_damaged_motion_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = write_damaged_motion(tmp_path, name)
    with pytest.raises(CheckpointInvalid) as refused:
        read_motion(path, 24)
    assert refused.value.where.startswith(str(path))
    assert "\n" not in refused.value.message


def test_frames_of_a_folder_are_put_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (2, 10, 1):
        np.savez(
            tmp_path / f"{number}.npz",
            poses=np.full((1, 72), 0.01 * number),
            Rh=np.array([[0.0, 0.0, np.pi / 2]]),
            Th=np.array([[number, 0.0, 0.0]]),
            shapes=np.arange(10.0)[None],
        )
    motion = read_motion(tmp_path, 24)
    np.testing.assert_array_equal(motion.shift[:, 0], [1, 2, 10])
    np.testing.assert_allclose(motion.pose[2], 0.1)
    assert motion.turn is not None
    np.testing.assert_allclose(motion.turn[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(motion.shape, np.arange(10.0))


def frame(number: int) -> dict[str, Any]:
    sizes = {"root_pose": 1, "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1}
    sizes |= {"lhand_pose": 15, "rhand_pose": 15}
    values: dict[str, Any] = {
        name: np.full((size, 3), 0.1 * number + index).tolist()
        for index, (name, size) in enumerate(sizes.items())
    }
    return values | {"trans": [0, number, 0], "expr": [0.5] * 100, "betas": [9.0] * 10}


@pytest.mark.parametrize("single", [True, False])
def test_lhm_s_frames_are_read_one_by_one_or_all_together(single: bool, tmp_path: Path) -> None:
    frames = [frame(number) for number in range(3)]
    path = tmp_path / "motion.json"
    if single:
        path.write_text(json.dumps(frames))
    else:
        path = tmp_path / "smplx_params"
        path.mkdir()
        for number, contents in enumerate(frames):
            (path / f"{number:05d}.json").write_text(json.dumps(contents))
    motion = read_motion(path, 55)
    np.testing.assert_allclose(motion.pose[1, [0, 1, 22, 23, 24, 25, 40], 0], 0.1 + np.arange(7))
    np.testing.assert_array_equal(motion.shift[:, 1], [0, 1, 2])
    assert motion.expression is not None
    assert motion.expression.shape == (3, 100)
    assert motion.shape is None  # its betas are of who was filmed


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "has no frames of poses, expected at least one"),
        ("{", "cannot be read"),
        ("[3]", "frame 0: is a int"),
        ("[{}]", "root_pose is missing"),
        ('[{"root_pose": [1, 2]}]', "root_pose has 2 numbers, expected 3"),
        ('[{"root_pose": [1, 2, NaN]}]', "all finite"),
    ],
)
def test_invalid_motion_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    path.write_text(text)
    with pytest.raises(CheckpointInvalid, match=words):
        read_motion(path, 55)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({}, "has no array poses"),
        ({"poses": np.zeros((2, 70))}, "a pose has 70 numbers"),
        ({"poses": np.zeros((2, 72)), "Th": np.zeros((3, 3))}, "3 numbers for each of 2 frames"),
        ({"poses": np.full((2, 72), np.inf)}, "expected finite numbers"),
        ({"poses": np.array([object()])}, "cannot be read"),
    ],
)
def test_arrays_that_are_no_motion_are_refused(
    arrays: dict[str, np.ndarray], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "motion.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    with pytest.raises(CheckpointInvalid, match=words):
        read_motion(path, 24)


def test_frames_of_zju_mocap_are_read_out_of_their_pickles(tmp_path: Path) -> None:
    rng, frames = np.random.default_rng(0), []
    for number in (10, 9):  # in the order of numbers, not of text
        turn, translation = rng.normal(size=(1, 3)), rng.normal(size=(1, 3))
        frame = {"Rh": turn, "Th": translation, "poses": rng.normal(size=(1, 72))}
        frame["shapes"] = np.arange(10.0)[None]
        np.save(tmp_path / f"{number}.npy", frame)  # type: ignore[arg-type]
        frames.insert(0, frame)
    read = read_motion(tmp_path, 24)
    np.testing.assert_array_equal(read.pose.reshape(2, 72), [f["poses"][0] for f in frames])
    np.testing.assert_array_equal(read.shift, [f["Th"][0] for f in frames])
    assert read.turn is not None
    expected = Rotation.from_rotvec([f["Rh"][0] for f in frames]).as_matrix()
    np.testing.assert_allclose(read.turn, expected)
    assert read.shape is not None
    np.testing.assert_array_equal(read.shape, np.arange(10.0))
    motion = read_motion(tmp_path / "10.npy", 24)
    np.testing.assert_array_equal(motion.pose[0], read.pose[1])


def test_a_frame_of_zju_mocap_runs_nothing(tmp_path: Path) -> None:
    harmful_pose = {"poses": Harmful(tmp_path / "harmed")}
    np.save(tmp_path / "0.npy", harmful_pose)  # type: ignore[arg-type]
    with pytest.raises(CheckpointInvalid, match="which is not an array"):
        read_motion(tmp_path, 24)
    assert not (tmp_path / "harmed").exists()
    np.save(tmp_path / "0.npy", np.zeros(72))
    with pytest.raises(CheckpointInvalid, match="holds an array, expected a dict"):
        read_motion(tmp_path / "0.npy", 24)


def test_missing_motion_error_states_the_expected_file(tmp_path: Path) -> None:
    with pytest.raises(CheckpointInvalid, match="AMASS"):
        read_motion(tmp_path / "nowhere.npz", 24)
    with pytest.raises(CheckpointInvalid, match=r"no \.npz, \.npy or \.json"):
        read_motion(tmp_path, 24)


@pytest.mark.parametrize(
    ("rotation", "up"), [((0, 0, 0), "+y"), ((np.pi / 2, 0, 0.2), "+z"), ((np.pi, 0, 0), "-y")]
)
def test_the_upward_axis_is_that_of_upright_bodies(
    rotation: tuple[float, float, float], up: str, tmp_path: Path
) -> None:
    """AMASS recordings have z up; a person estimated from a video has the camera's axes, y down."""
    path = write_motion(tmp_path / "a.npz")
    with np.load(path) as read:
        arrays = dict(read)
    arrays["poses"][:, :3] = rotation
    np.savez(path, **arrays)
    assert read_motion(path, 24).up == up
    np.savez(path, poses=np.zeros((4, 72)), Rh=np.tile(rotation, (4, 1)), Th=np.zeros((4, 3)))
    assert read_motion(path, 24).up == up
