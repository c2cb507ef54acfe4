"""Prefetching along a path that is known: what is to come, and no more than that."""

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_quaternion
from gsgen.tiles.prediction.poses import Pose, matrix_quaternion
from gsgen.tiles.prediction.prefetch import PathPrefetch, ViewSettings
from support.tiles.request_trees import tree_of

LEVEL = np.array([1.0, 0, 0, 0])


def turned(degrees: float) -> np.ndarray:
    return rotation_quaternion(np.radians([0.0, degrees, 0.0]))


@pytest.mark.parametrize("is_film", [False, True])
@pytest.mark.parametrize(
    "path",
    [
        [(np.array([x, 0.0, -9.0]), LEVEL, 50) for x in (0, 2, 4, 6, 8)],
        [(np.array([0.0, 0.0, -9.0]), turned(angle), 50) for angle in (0, 0.01, 5, 80, 170)],
        [(np.array([0.0, 0.0, -9.0]), LEVEL, angle) for angle in (50, 49.99, 40, 20, 60)],
    ],
    ids=["moving", "turning", "zooming"],
)
def test_frames_that_are_drawn_are_forgotten(
    path: list[tuple[np.ndarray, np.ndarray, float]], is_film: bool
) -> None:
    """The frame of the present moment has been requested by itself."""
    tree = tree_of([-1, 0, 0, 0])
    frustums = [
        ViewSettings(fov_y=angle).frustum(Pose(0.0, eye, turn)) for eye, turn, angle in path
    ]
    times = None if is_film else [float(number) for number in range(len(path))]
    prefetch = PathPrefetch(tree, frustums, 0.01, times=times)
    everything = np.ones(len(tree), bool)
    for number, frustum in enumerate(frustums):
        quaternion = matrix_quaternion(frustum.rotation.T)
        prefetch.observe(Pose(float(number), frustum.eye, quaternion, frustum.focal))
        assert prefetch.candidates(everything) == []
        first = number if is_film else number + 1
        assert sorted(prefetch._orders) == list(range(first, len(path)))
