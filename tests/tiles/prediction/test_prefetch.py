"""Prefetching along a path that is known: what is to come, and no more than that."""

import numpy as np
import pytest

from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.prefetch import PathPrefetch, ViewSettings
from support.tiles.request_trees import tree_of

LEVEL = np.array([1.0, 0, 0, 0])


@pytest.mark.parametrize("is_film", [False, True])
def test_frames_that_are_drawn_are_forgotten(is_film: bool) -> None:
    """The frame of the present moment has been requested by itself."""
    tree = tree_of([-1, 0, 0, 0])
    eyes = [np.array([x, 0.0, -9.0]) for x in (0, 2, 4, 6, 8)]
    frustums = [ViewSettings().frustum(eye, LEVEL) for eye in eyes]
    times = None if is_film else [float(number) for number in range(len(eyes))]
    prefetch = PathPrefetch(tree, frustums, 0.01, times=times)
    everything = np.ones(len(tree), bool)
    for number, eye in enumerate(eyes):
        prefetch.observe(Pose(float(number), eye, LEVEL))
        assert prefetch.candidates(everything) == []
        first = number if is_film else number + 1
        assert sorted(prefetch._orders) == list(range(first, len(eyes)))
