"""Centres that follow the camera: each space is named, and no order of columns is blamed."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.clouds import cloud
from gsgen.contract.causes.camera_spaces import _SPACES, space_of_still_rows
from gsgen.contract.causes.explanations import explain_rows
from gsgen.contract.causes.readings import SeenRows
from gsgen.contract.spec.geometry import look_at, perspective

EYES = ([0.3, -0.4, -5.0], [4.0, 1.0, 1.0], [-1.0, -4.0, 2.0])
PROJECTION = perspective(1.0, 1.2, 0.1, 50.0).astype(np.float64)
PULLED = "moved by 0.1 of the camera's centre"
BOX = ((-1.2, -1.2, -1.2), (1.2, 1.2, 1.2))


def homogeneous(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    result = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ matrix.T
    return np.asarray(result[:, :3] / result[:, 3:])


def misplaced(space: str, points: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Return centres as a model gives them that makes the mistake of a space."""
    rotation, translation = view[:3, :3], view[:3, 3]
    center = -rotation.T @ translation
    along = "moved by the camera's centre along "
    centres = {
        **{
            f"{along}{' and '.join(axes)}": points + center * [axis in axes for axis in "xyz"]
            for axes in ("xz", "xy", "yz", "x", "y", "z")
        },
        "in camera space": homogeneous(view, points),
        "in the camera space of OpenGL": homogeneous(view, points) * [1, -1, -1],
        "in clip space": homogeneous(PROJECTION @ view, points),
        "relative to the camera's centre": points - center,
        "moved by the camera's centre": points + center,
        PULLED: points + 0.1 * center,
        "relative to the translation of the view matrix": points - translation,
        "turned into the camera's axes": points @ rotation.T,
        "moved by the inverse of the view matrix": homogeneous(np.linalg.inv(view), points),
        "": points,
    }
    return np.asarray(centres[space])


def seen(space: str, eye: list[float], points: np.ndarray) -> SeenRows:
    """Return what a camera sees of a model whose centres are in a space."""
    view = look_at(np.array(eye), np.zeros(3), np.array([0.0, -1, 0])).astype(np.float64)
    return SeenRows(
        center=np.array(eye),
        view=view,
        projection=PROJECTION,
        position=misplaced(space, points, view),
        drawn=np.ones(len(points), bool),
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("space", ["", PULLED, *_SPACES])
def test_each_space_is_named_and_no_order_of_columns(space: str, seed: int) -> None:
    """Centres outside the bounds, and covariances in their box, tempt to blame the columns."""
    gaussians = cloud(200, seed=seed)
    cameras = [seen(space, eye, gaussians.position) for eye in EYES]
    rows = np.concatenate(
        [cameras[0].position, gaussians.opacity[:, None], gaussians.covariance], axis=1
    )
    explanation = explain_rows(rows, BOX, cameras=cameras)
    assert (explanation.name if explanation else "") == space
    assert explanation is None or explanation.kind == "space"


@pytest.mark.parametrize("moves", [True, False])
def test_view_with_other_rows_does_not_mask_other_views(moves: bool) -> None:
    points = np.random.default_rng(1).normal(size=(40, 3))
    space = "in camera space" if moves else ""
    parts = (points[:30], points, points)
    cameras = [seen(space, eye, part) for eye, part in zip(EYES, parts, strict=True)]
    assert (explain_rows(np.zeros((0, 10)), cameras=cameras) is not None) == moves


def test_rows_that_move_by_design_are_in_no_space() -> None:
    """Levels of detail replace rows, so nothing makes them still."""
    rng = np.random.default_rng(2)
    cameras = [seen("", eye, rng.normal(size=(40, 3))) for eye in EYES]
    assert explain_rows(np.zeros((0, 10)), cameras=cameras) is None


def test_an_order_that_hides_the_content_from_all_cameras_loses() -> None:
    """Rows read in an order that fits the numbers, but stands behind every camera, are no cause."""
    gaussians = cloud(200, seed=3)
    rows = np.concatenate(
        [gaussians.position, gaussians.covariance, gaussians.opacity[:, None]], axis=1
    )
    assert explain_rows(rows) is not None
    away = np.diag([1.0, 1, -1, 1])
    away[2, 3] = -9  # looks away from everything near the origin
    hidden = SeenRows(
        center=np.array([0.0, 0, -9]),
        view=away,
        projection=None,
        position=rows[:, :3],
        drawn=np.ones(len(rows), bool),
    )
    assert explain_rows(rows, cameras=[hidden, hidden]) is None


@pytest.mark.parametrize("share", [0.0, 0.06, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("space", _SPACES)
def test_a_part_of_the_rows_may_follow_the_camera(space: str, share: float) -> None:
    """Actors in camera space stand before a static background, in any part of the rows."""
    points = cloud(200, seed=3).position
    follows = np.random.default_rng(3).permutation(200) < 200 * share
    cameras = []
    for eye in EYES:
        camera = seen(space, eye, points)
        position = np.where(follows[:, None], camera.position, points)
        cameras.append(replace(camera, position=position))
    explanation = space_of_still_rows(cameras)
    assert (explanation.name if explanation else "") == (space if share else "")


def test_rows_that_are_in_another_order_follow_no_camera() -> None:
    points = cloud(200, seed=4).position
    random = np.random.default_rng(4)
    cameras = [
        replace(seen("", eye, points), position=points[random.permutation(200)]) for eye in EYES
    ]
    assert space_of_still_rows(cameras) is None
