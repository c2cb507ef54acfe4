"""COLMAP's images.txt is read by its grammar: a pose, then triples of points or an empty line."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.camera_files import open_cameras

POSES = [f"{n + 1} 1 0 0 0 {n} 0 4 1 image_{n}.jpg" for n in range(4)]


def model(folder: Path, text: str, lenses: str = "1 PINHOLE 64 48 50 50 32 24\n") -> Path:
    (folder / "cameras.txt").write_text(lenses)
    (folder / "images.txt").write_text(text)
    return folder


READABLE = {
    "empty lines": "\n\n".join(POSES),
    "empty lines and a last one": "\n\n".join(POSES) + "\n\n",
    "points": "\n1.5 2.5 -1 3 4 17\n".join(POSES) + "\n1 2 3\n",
    "windows line ends": "\r\n\r\n".join(POSES),
    "comments": "# Image list\n" + "\n# points\n\n".join(POSES),
    "more empty lines": "\n\n\n\n".join(POSES),
    "exponents": "\n1.5e2 2.5E-3 18446744073709551615\n".join(POSES),
    "spaces only": "\n   \t\n".join(POSES),
}


@pytest.mark.parametrize("name", READABLE)
def test_every_pose_becomes_a_camera(name: str, tmp_path: Path) -> None:
    file = open_cameras(model(tmp_path, READABLE[name]))
    assert [camera.name for camera in file.cameras] == [f"image_{n}.jpg" for n in range(4)]
    assert [camera.camera.view[0, 3] for camera in file.cameras] == [0, 1, 2, 3]


# A text, and the line that is no list of points.
UNREADABLE = {
    "poses without points": ("\n".join(POSES), 2),
    "the second image without points": (f"{POSES[0]}\n\n{POSES[1]}\n{POSES[2]}\n\n", 4),
    "pairs": (f"{POSES[0]}\n1 2 3 4\n", 2),
    "a word among the numbers": (f"{POSES[0]}\n1 2 x\n", 2),
    "an image whose name has spaces": (f"{POSES[0]}\n2 1 0 0 0 0 0 4 1 my nice picture.jpg", 2),
    "an image with a number as its name": (f"{POSES[0]}\n2 1 0 0 0 0 0 4 1 17", 2),
    "a fraction as the number of a point": (f"{POSES[0]}\n1 2 3.5\n", 2),
    "a comment before the next pose": (f"# list\n{POSES[0]}\n# points\n{POSES[1]}", 4),
    "not a number": (f"{POSES[0]}\n1 2 nan\n", 2),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_a_line_that_is_no_list_of_points_is_an_error_with_the_line(
    name: str, tmp_path: Path
) -> None:
    text, line = UNREADABLE[name]
    with pytest.raises(ConfigInvalid, match=f"images.txt, line {line}: .*triples") as caught:
        open_cameras(model(tmp_path, text))
    assert "two lines" in str(caught.value)


def test_no_text_loses_a_pose(tmp_path: Path) -> None:
    """Poses with and without lines of points, mixed: all of them, or an error."""
    rng = np.random.default_rng(0)
    outcomes = {True: 0, False: 0}
    for _ in range(60):
        separators = rng.choice(["\n", "\n\n", "\n1 2 3\n"], 4, p=[0.1, 0.45, 0.45])
        text = "".join(pose + separator for pose, separator in zip(POSES, separators, strict=True))
        try:
            assert len(open_cameras(model(tmp_path, text)).cameras) == 4
            outcomes[True] += 1
        except ConfigInvalid:
            assert "\n" in separators[:3]
            outcomes[False] += 1
    assert min(outcomes.values()) >= 10


def test_a_camera_defined_twice_is_refused(tmp_path: Path) -> None:
    lens = "1 PINHOLE 64 48 50 50 32 24\n"
    with pytest.raises(ConfigInvalid, match=r"cameras.txt, line 2: defines camera 1 a second"):
        open_cameras(model(tmp_path, POSES[0], lens + lens.replace("50", "60")))


def test_images_are_in_the_natural_order_of_their_names(tmp_path: Path) -> None:
    lines = [f"{n} 1 0 0 0 0 0 4 1 frame_{n}.jpg" for n in (10, 2, 1, 100, 20, 9)]
    file = open_cameras(model(tmp_path, "\n\n".join(lines)))
    assert [camera.name for camera in file.cameras] == [
        f"frame_{n}.jpg" for n in (1, 2, 9, 10, 20, 100)
    ]
