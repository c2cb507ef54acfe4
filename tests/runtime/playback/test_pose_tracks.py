"""Poses from files of many kinds reach the input that takes them, or it is said why not."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.playback.pose_tracks import pose_tracks
from gsgen.runtime.sources.source import Source, named
from support.hostile.motions import MOTIONS, write_motion

POSE = np.random.default_rng(0).uniform(-0.4, 0.4, (5, 24, 3))


class Body(Source):
    """Enough of a source: the inputs of an avatar."""

    def __init__(self, joints: int = 24, turn: tuple[int, ...] = (3, 3), **kwargs: str) -> None:
        self.shapes = {"pose": (joints, 3), "turn": turn, "shift": (3,), "face": (10,)}
        self.inputs = (
            Input(name="pose", role="pose", convention=kwargs.get("convention", "smpl-axis-angle")),
            Input(name="turn", role="root_rotation"),
            Input(name="shift", role="root_translation"),
            Input(name="face", role="expression"),
        )

    def named(self, word: str) -> list[Input]:
        return named(self.inputs, word)

    def shape(self, name: str) -> tuple[int, ...]:
        return self.shapes[name]

    def start(self, *_: object) -> None: ...
    def finish(self) -> None: ...
    def abandon(self) -> None: ...
    def close(self) -> None: ...


def read_tracks(path: Path, body: Body | None = None) -> dict[str, np.ndarray]:
    tracks, _ = pose_tracks(str(path), body or Body())
    return {track.input_name: track.values for track in tracks}


def write(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)
    return path


def nested(path: Path) -> Path:
    path.write_text(json.dumps(POSE.tolist()), encoding="utf-8")
    return path


def plain(path: Path) -> Path:
    np.save(path, POSE)
    return path


@pytest.mark.parametrize(
    "make",
    [
        lambda folder: plain(folder / "a.npy"),
        lambda folder: nested(folder / "a.json"),
        lambda folder: write(folder / "a.npz", anything=POSE),
        lambda folder: write(folder / "a.npz", poses=POSE.reshape(5, 72), betas=np.zeros(10)),
    ],
)
def test_every_kind_of_file_gives_the_same_poses(
    tmp_path: Path, make: Callable[[Path], Path]
) -> None:
    actual = read_tracks(make(tmp_path))
    assert list(actual) == ["pose"]
    np.testing.assert_array_equal(actual["pose"], POSE)


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    for number in (10, 9, 2):
        np.save(tmp_path / f"frame_{number}.npy", np.full((24, 3), number / 100))
    assert read_tracks(tmp_path)["pose"][:, 0, 0].tolist() == [0.02, 0.09, 0.1]
    (tmp_path / "frame_11.npy").write_bytes(b"\x93NUMPY damaged")
    with pytest.raises(ConfigInvalid, match=r"frame_11\.npy: cannot be read"):
        read_tracks(tmp_path)


def test_one_pose_is_for_all_frames(tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", POSE[0])
    (track,), _ = pose_tracks(str(tmp_path / "one.npy"), Body())
    assert track.frames((24, 3)) == 1
    np.testing.assert_array_equal(track.value_at((24, 3), 7, 9), POSE[0])


def test_root_rotation_and_shift_are_read(tmp_path: Path) -> None:
    turns = Rotation.from_rotvec(np.random.default_rng(1).normal(size=(5, 3)))
    shift = np.random.default_rng(2).normal(size=(5, 3))
    path = write(tmp_path / "a.npz", poses=POSE, Th=shift, R=turns.as_matrix())
    actual = read_tracks(path)
    np.testing.assert_array_equal(actual["shift"], shift)
    np.testing.assert_array_equal(actual["turn"].reshape(5, 3, 3), turns.as_matrix())
    as_vectors = read_tracks(path, Body(turn=(3,)))["turn"]
    np.testing.assert_allclose(as_vectors, turns.as_rotvec(), atol=1e-12)
    path = write(tmp_path / "b.npz", poses=POSE, trans=shift, Rh=turns.as_rotvec())
    np.testing.assert_allclose(
        read_tracks(path)["turn"].reshape(5, 3, 3), turns.as_matrix(), atol=1e-12
    )


def test_frame_rate_is_read_from_the_file(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", poses=POSE, mocap_framerate=np.float64(60))
    assert pose_tracks(str(path), Body())[1] == 60


@pytest.mark.parametrize(
    ("axis_count", "joints", "shared"),
    [(52, 24, range(22)), (52, 55, [*range(22), *range(-30, 0)]), (22, 55, range(22)),
     (55, 52, [*range(22), *range(-30, 0)]), (24, 22, range(22))],
)  # fmt: skip
def test_poses_of_one_body_move_another(
    tmp_path: Path, axis_count: int, joints: int, shared: list[int]
) -> None:
    poses = np.random.default_rng(0).normal(size=(3, axis_count, 3))
    path = write(tmp_path / "a.npz", poses=poses.reshape(3, -1))
    result = read_tracks(path, Body(joints))["pose"]
    array = np.zeros((3, joints, 3))
    array[:, list(shared)] = poses[:, list(shared)]
    np.testing.assert_array_equal(result, array)
    with pytest.raises(
        ConfigInvalid, match=rf"holds poses of \[{3 * axis_count}\], expected \[{joints}, 3\]"
    ):
        read_tracks(path, Body(joints, convention="axis-angle"))


def test_lhm_frames_become_tracks(tmp_path: Path) -> None:
    sizes = {"root_pose": 3, "body_pose": 63, "jaw_pose": 3, "leye_pose": 3, "reye_pose": 3,
             "lhand_pose": 45, "rhand_pose": 45}  # fmt: skip
    rng = np.random.default_rng(0)
    frames = [{name: rng.normal(size=n).tolist() for name, n in sizes.items()} for _ in "ab"]
    for number, frame in enumerate(frames):
        frame |= {"trans": [number, 2.5, 3], "expr": rng.normal(size=10).tolist()}
        (tmp_path / f"{number}.json").write_text(json.dumps(frame))
    combined_path = tmp_path / "all" / "motion.json"
    combined_path.parent.mkdir()
    combined_path.write_text(json.dumps(frames))
    for path in (tmp_path, combined_path):
        actual = read_tracks(path, Body(55))
        assert actual["pose"].shape == (2, 55, 3)
        flat = np.concatenate([frames[1][name] for name in sizes])
        np.testing.assert_array_equal(actual["pose"][1].ravel(), flat)
        np.testing.assert_array_equal(actual["shift"], [[0, 2.5, 3], [1, 2.5, 3]])
        np.testing.assert_array_equal(actual["face"], [frame["expr"] for frame in frames])
    frames[0]["body_pose"] = [0.0]
    combined_path.write_text(json.dumps(frames))
    with pytest.raises(ConfigInvalid, match="frame 0, body_pose: has 1 numbers, expected 63"):
        read_tracks(combined_path, Body(55))


@pytest.mark.parametrize(
    ("content", "expected_message"),
    [
        ("{", "cannot be read"),
        ("[]", r"float64 \[0\], expected numbers"),
        ('["a"]', "expected numbers"),
        ("[[[1]]]", r"poses of \[1, 1\], expected \[24, 3\]"),
        ("[[[[1]]]]", r"has shape \[1, 1, 1, 1\], expected \[joints, 3\]"),
        ("[[1, 2], [3]]", "cannot be read"),
        ("[[NaN, 0, 0]]", "has 1 non-finite values"),
        ("{}", r"has the arrays \(none\), expected `poses` or `pose`"),
        ('{"shape": [1], "scale": [2]}', "has the arrays shape, scale, expected `poses` or `pose`"),
        (
            '{"pose": [[1, 2, 3]], "trans": [1, 2]}',
            r"trans: has shape \[2\], expected \[1, 3\]: 3 numbers",
        ),
    ],
)
def test_files_without_poses_are_refused(
    tmp_path: Path, content: str, expected_message: str
) -> None:
    path = tmp_path / "motion.json"
    path.write_text(content)
    with pytest.raises(ConfigInvalid, match=expected_message):
        read_tracks(path)


def test_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match=r"is a folder without \.npy, \.npz or \.json files"):
        read_tracks(tmp_path)


@pytest.mark.parametrize("name", [*MOTIONS, "pipe.npz", "pipe.json"])
def test_a_damaged_motion_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = write_motion(tmp_path, name)
    with pytest.raises(ConfigInvalid) as refused:
        read_tracks(path)
    assert refused.value.where.startswith((str(path), f"--pose {path}"))
    assert "\n" not in refused.value.message


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", poses=np.asarray([{}], object))
    with pytest.raises(ConfigInvalid, match="holds object, expected numbers"):
        read_tracks(path)
