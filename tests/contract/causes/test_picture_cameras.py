"""Cameras and lenses of pictures that a model takes otherwise than declared: each reading is named."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.causes import picture_cameras
from gsgen.contract.causes.picture_cameras import (
    _LENSES,
    _READINGS,
    _STAYING,
    PosedRows,
    is_equivariant,
    is_translated_otherwise,
    own_pixels,
    reading_of_cameras,
    reading_of_lenses,
)
from gsgen.contract.spec.geometry import look_at, rotation_matrix

SIZE = (12, 8)
MOTION = np.eye(4)
MOTION[:3, :3] = rotation_matrix(np.array([[0.92, 0.2, -0.28, 0.19]]))[0]
MOTION[:3, 3] = (0.4, -0.3, 0.5)
# One of the three cameras moves.
ALONE = [np.stack([MOTION if k == number else np.eye(4) for k in range(3)]) for number in range(3)]


def placed(reading: str, views: np.ndarray, number: int, local: np.ndarray) -> np.ndarray:
    """Return where a model that makes a mistake places points of a picture's camera."""
    rotation, t = views[number, :3, :3], views[number, :3, 3]
    centers = np.stack([-view[:3, :3].T @ view[:3, 3] for view in views])
    center, away = centers[number], centers - centers.mean(axis=0)
    distances, from_middle = (np.linalg.norm(points, axis=1) for points in (centers, away))

    def turned(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("ij,nj->ni", matrix, points))

    ray = turned(rotation.T, local)
    _, found, axes = reading.partition("other axes, ")
    if found:
        signs = [-1 if axis.startswith("−") else 1 for axis in axes.split()]
        return np.asarray((ray + center)[:, ["xyz".index(a[-1]) for a in axes.split()]] * signs)
    positions: dict[str, np.ndarray] = {
        "": turned(rotation.T, local - t),
        "the matrices were taken for camera-to-world": turned(rotation, local) + t,
        "the matrices were read transposed, in the other memory order": turned(rotation, local),
        "the translation has the other sign": turned(rotation.T, local + t),
        "the translation was taken for the camera's centre": turned(rotation.T, local) + t,
        "the translation was left out": turned(rotation.T, local),
        "the rotation was inverted": turned(rotation, local - t),
        "the rotation was inverted about the camera's centre": turned(rotation, local) + center,
        "the rotation was left out": local + center,
        "the translation alone was subtracted": local - t,
        _STAYING: local,
        "the cameras' distances from the origin were divided by their mean": ray
        + center / distances.mean(),
        "the cameras' distances from the origin were divided by the largest": ray
        + center / distances.max(),
        "the cameras' distances from the origin were divided by that of the first": ray
        + center / distances[0],
        "each camera was moved to the distance 1 from the origin": ray + center / distances[number],
        "the distance between the first two cameras was taken for 1": ray
        + center / np.linalg.norm(centers[1] - centers[0]),
        "the mean of the cameras' centres was taken for the origin": ray + away[number],
        "the cameras' centres were divided by their mean distance from their middle": ray
        + away[number] / from_middle.mean(),
        "the cameras' centres were divided by their largest distance from their middle": ray
        + away[number] / from_middle.max(),
    }
    return positions[reading]


def lens_of(focal: tuple[float, float], middle: tuple[float, float]) -> np.ndarray:
    return np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1.0]])


LENS, OTHER_LENS = lens_of((11.0, 11.0), (6.0, 4.0)), lens_of((13.75, 8.8), (7.5, 2.5))


def taken(reading: str, lens: np.ndarray) -> np.ndarray:
    """Return the pinhole matrix that a model with a mistake works with."""
    fx, fy, cx, cy = lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2]
    width, height = SIZE
    return {
        "the intrinsics were taken for fractions of the picture's width and height": lens_of(
            (width * fx, height * fy), (width * cx, height * cy)
        ),
        "the intrinsics were taken for those of pixels from −1 to 1": lens_of(
            (width / 2 * fx, height / 2 * fy), (width / 2 * (cx + 1), height / 2 * (cy + 1))
        ),
        "the intrinsics were read transposed": lens_of((fx, fy), (0, 0)),
        "the focal lengths were exchanged": lens_of((fy, fx), (cx, cy)),
        "the coordinates of the principal point were exchanged": lens_of((fx, fy), (cy, cx)),
        "the focal length of the width was taken for both axes": lens_of((fx, fx), (cx, cy)),
        "the principal point was taken for the middle of the picture": lens_of(
            (fx, fy), (width / 2, height / 2)
        ),
    }.get(reading, lens)


AXES = {name: entry[2] for name, entry in _LENSES.items() if len(entry) > 2}


def posed(
    seed: int, motion: np.ndarray, lens: np.ndarray, cameras: str = "", lenses: str = ""
) -> PosedRows:
    """Return the rows of three pictures as a model with mistakes in cameras and lenses places them."""
    random = np.random.default_rng(seed)
    width, height = SIZE
    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    eyes, targets = (
        random.uniform((-4, -4, -10), (4, 4, -2), (3, 3)),
        random.uniform(-0.5, 0.5, (3, 3)),
    )
    eyes = eyes[
        np.argsort(np.linalg.norm(eyes, axis=1))[[1, 0, 2]]
    ]  # the first is not the farthest
    views = np.stack(
        [look_at(eye, at, np.array([0.0, -1, 0])) for eye, at in zip(eyes, targets, strict=True)]
    ) @ np.linalg.inv(motion)
    rows = []
    for number in range(len(views)):
        rays = pixels @ np.linalg.inv(taken(lenses, lens)).T * AXES.get(lenses, (1, 1, 1))
        local = rays * random.uniform(1.5, 2.5, (len(rays), 1))
        rows.append(placed(cameras, views, number, local))
    position = np.concatenate(rows).astype(np.float32).astype(np.float64)
    return PosedRows(
        position=position, views=views, lenses=np.stack([lens] * len(views)), size=SIZE
    )


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["", *_READINGS])
def test_each_reading_of_cameras_is_named(name: str, seed: int) -> None:
    base, moved, other = (
        posed(seed, motion, lens, cameras=name)
        for motion, lens in ((np.eye(4), LENS), (MOTION, LENS), (np.eye(4), OTHER_LENS))
    )
    alone = [(base, posed(seed, motions, LENS, cameras=name)) for motions in ALONE]
    reading = reading_of_cameras(base, moved, (base, other), alone)
    assert is_equivariant(base, moved) == (name == "")
    assert (reading.name if reading else "") == name
    assert reading is None or reading.declared > 0.9


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["", *_LENSES])
def test_each_reading_of_lenses_is_named(name: str, seed: int) -> None:
    base, other = (posed(seed, np.eye(4), lens, lenses=name) for lens in (LENS, OTHER_LENS))
    reading = reading_of_lenses(base, other)
    assert (reading.name if reading else "") == name


@pytest.mark.parametrize("seed", range(2))
def test_rows_that_follow_no_reading_are_not_blamed(seed: int) -> None:
    """Networks that look at the cameras, templates, and rows of a few pixels fit no reading."""
    random = np.random.default_rng(seed)
    base, moved, other = (
        posed(seed, motion, lens)
        for motion, lens in ((np.eye(4), LENS), (MOTION, LENS), (np.eye(4), OTHER_LENS))
    )
    noise = random.normal(0, 0.05, moved.position.shape)
    loose = replace(moved, position=moved.position + noise)
    assert reading_of_cameras(base, loose, (base, other)) is None
    assert not is_translated_otherwise(base, loose)
    shifted = replace(other, position=other.position + noise)
    assert reading_of_lenses(base, shifted) is None
    assert own_pixels(base, shifted) is None
    # A template stays where it is, whatever the cameras.
    template = [replace(rows, position=base.position) for rows in (moved, other)]
    assert reading_of_cameras(base, template[0], (base, template[1])) is None
    few = [
        replace(rows, position=rows.position[:12])
        for rows in (base, posed(seed, MOTION, LENS, "the translation was left out"))
    ]
    assert reading_of_cameras(few[0], few[1]) is None


def test_a_far_row_hides_no_motion_of_near_ones() -> None:
    """The sky makes the spread of all rows large."""
    base, moved = (posed(3, motion, LENS) for motion in (np.eye(4), MOTION))
    far = base.position.copy()
    far[0] = 1e4
    template = replace(base, position=far), replace(moved, position=far)
    assert not is_equivariant(*template)
    assert reading_of_cameras(*template) is None


def test_rows_that_turn_and_are_moved_elsewhere_are_noticed() -> None:
    base, moved = (posed(1, motion, LENS) for motion in (np.eye(4), MOTION))
    assert not is_translated_otherwise(base, moved)
    # Half of the first picture's rows are left out: pictures need not have as many rows.
    base, moved = (replace(rows, position=rows.position[48:]) for rows in (base, moved))
    parked, later = (replace(rows, position=rows.position.copy()) for rows in (base, moved))
    parked.position[-40:] = later.position[-40:] = (0.5, 0.5, 0.5)
    assert not is_translated_otherwise(parked, later)
    elsewhere = replace(moved, position=moved.position + np.array([0.3, 0, 0.2]))
    assert reading_of_cameras(base, elsewhere) is None
    assert is_translated_otherwise(base, elsewhere)


@pytest.mark.parametrize("seed", range(2))
def test_rows_are_found_at_the_middles_of_their_own_pixels(seed: int) -> None:
    base, other = (posed(seed, np.eye(4), lens) for lens in (LENS, OTHER_LENS))
    own = own_pixels(base, other)
    assert own is not None
    picture, place = own
    width, height = SIZE
    np.testing.assert_array_equal(picture, np.repeat([0, 1, 2], width * height))
    number = np.tile(np.arange(width * height), 3)
    expected = np.stack([number % width + 0.5, number // width + 0.5], axis=1)
    np.testing.assert_allclose(place, expected, atol=1e-3)


def test_rows_in_the_first_cameras_space_are_told_from_a_template() -> None:
    """They move when that camera moves alone."""
    base, moved = (posed(1, motion, LENS) for motion in (np.eye(4), MOTION))
    first = [
        replace(rows, position=rows.position @ rows.views[0, :3, :3].T + rows.views[0, :3, 3])
        for rows in (base, moved)
    ]
    assert reading_of_cameras(first[0], first[1]) is None
    alone = replace(first[0], position=first[0].position @ MOTION[:3, :3])
    reading = reading_of_cameras(first[0], first[1], alone=[(first[0], alone)])
    assert reading is not None
    assert reading.name == _STAYING


def test_rows_behind_all_cameras_are_noticed_without_lenses() -> None:
    base = posed(2, np.eye(4), LENS)
    view = base.views[:1]
    one = replace(base, views=view, lenses=None)
    assert picture_cameras.reading_behind_cameras(replace(one, position=base.position[:96])) is None
    mirrored = (base.position[:96] @ view[0, :3, :3].T + view[0, :3, 3]) * [1, -1, -1]
    behind = replace(one, position=(mirrored - view[0, :3, 3]) @ view[0, :3, :3])
    reading = picture_cameras.reading_behind_cameras(behind)
    assert reading is not None
    assert "OpenGL" in reading.name
