"""Recordings of people become camera paths: who looks ahead in Unity looks ahead here."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_matrix
from support.tiles.recordings import recordings

# A quarter turn to the right about Unity's y: from z ahead to x.
RIGHT = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A file of each format, of somebody at (1, 2, 3) who looks along Unity's x."""
    numbers = ",".join(map(str, (1.0, 2.0, 3.0, *RIGHT)))
    (tmp_path / "interpolated").mkdir()
    rows = "\n".join(f"{index * 5e6},{numbers}" for index in range(2000))
    (tmp_path / "interpolated" / "User1.csv").write_text("timestamp,x,y,z,qx,qy,qz,qw\n" + rows)
    (tmp_path / "dataset").mkdir()
    frames = [*range(70), *range(90, 170), *range(300, 310)]
    rows = "\n".join(f"{frame},{numbers}" for frame in frames) + "\n9,,,\n"
    (tmp_path / "dataset" / "sequence1.csv").write_text("frame,x,y,z,qx,qy,qz,qw\n" + rows)
    names = "HeadPosX,HeadPosY,HeadPosZ,HeadOrientationX,HeadOrientationY,HeadOrientationZ,HeadOrientationW"
    rows = "\n".join(f"{7 + index / 72},{numbers}" for index in range(72 * 10))
    (tmp_path / "sample_movement_data.csv").write_text(f"time,{names}\n{rows}\n")
    return tmp_path


def test_each_format_is_read_at_ten_poses_a_second(folder: Path) -> None:
    paths = recordings(folder)
    # A part of fewer than 60 poses between gaps is left out.
    assert list(paths) == ["User1", "sequence1-0", "sequence1-1", "sample_movement_data"]
    assert [len(path) for path in paths.values()] == [100, 70, 80, 100]
    for path in paths.values():
        assert [pose.time for pose in path[:3]] == pytest.approx([0, 0.1, 0.2])
        right, down, forward = rotation_matrix(path[0].quaternion[None])[0].T
        np.testing.assert_allclose(path[0].position, [1, 3, 2])  # Unity's y is up: z here
        np.testing.assert_allclose(forward, [1, 0, 0], atol=1e-9)
        np.testing.assert_allclose(down, [0, 0, -1], atol=1e-9)
        np.testing.assert_allclose(np.cross(right, down), forward, atol=1e-9)
