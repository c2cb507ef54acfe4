"""Scenes in which many depths are nearer to each other than the last bit of a float tells."""

from collections.abc import Callable

import numpy as np

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.splat_scenes import camera, cloud, turned

DEPTH_LEFT = 2.0**-43
"""Of its distance, what the two floats of a depth may be off."""

NEAR_TIES: dict[str, Callable[[], tuple[Scene, Camera]]] = {}


def named(make: Callable[[], tuple[Scene, Camera]]) -> Callable[[], tuple[Scene, Camera]]:
    NEAR_TIES[make.__name__] = make
    return make


def plane(n: int = 300, seed: int = 0, opacity: tuple[float, float] = (0.3, 0.9)) -> SplatData:
    """Large Gaussians around a plane across the sight of :func:`camera`, many over each pixel."""
    data = cloud(n, seed, depth=(4, 4), size=0.25, opacity=opacity)
    data.rows[:, 2] = 4
    return data


def moved(data: SplatData, transform: np.ndarray) -> SplatData:
    """The same with the transform in its rows, rounded."""
    linear = transform[:3, :3]
    rows = data.rows.astype(np.float64)
    rows[:, :3] = rows[:, :3] @ linear.T + transform[:3, 3]
    full = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    rows[:, 4:] = (linear @ full @ linear.T).reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
    return SplatData(rows.astype(np.float32), data.appearance, data.space)


def seen_through(transform: np.ndarray, **changes: float) -> Camera:
    """:func:`camera`, moved as ``place`` moves models."""
    here = camera(**changes)
    linear = transform[:3, :3] / np.cbrt(np.linalg.det(transform[:3, :3]))
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = linear.T, -linear.T @ transform[:3, 3]
    return Camera(
        view,
        fx=here.fx,
        fy=here.fy,
        cx=here.cx,
        cy=here.cy,
        width=here.width,
        height=here.height,
        near=here.near,
    )


def decoded(lows: np.ndarray) -> np.ndarray:
    """Return the numbers that bits stand for that sort as they do."""
    bits = np.where(lows >> 31 == 1, lows ^ np.uint32(1 << 31), ~lows)
    return bits.astype(np.uint32).view(np.float32)


@named
def tilted() -> tuple[Scene, Camera]:
    """A few splats have each key."""
    return Scene([SplatSet(plane(), turned(2e-5, (1, 2, 0)))]), camera()


@named
def tilted_less() -> tuple[Scene, Camera]:
    """Hundreds have."""
    return Scene([SplatSet(plane(), turned(1e-7, (1, 2, 0)))]), camera()


@named
def plane_of_rounded_rows() -> tuple[Scene, Camera]:
    """Nothing but what rounding left of the rows is deep."""
    transform = turned(0.7, (1, 2, 3))
    transform[:3, 3] = 0.3, -0.2, 0.1
    return Scene([moved(plane(), transform)]), seen_through(transform)


@named
def far_away() -> tuple[Scene, Camera]:
    transform = turned(0.5, (3, 1, 2))
    transform[:3, 3] = 1e5, -3e4, 7e4
    tilt = turned(3e-5, (1, 2, 0))
    return Scene([SplatSet(plane(), transform @ tilt)]), seen_through(transform)


@named
def huge() -> tuple[Scene, Camera]:
    transform = turned(0.5, (3, 1, 2), 1e9)
    return Scene([SplatSet(plane(), transform @ turned(1e-5, (1, 2, 0)))]), seen_through(transform)


@named
def tiny() -> tuple[Scene, Camera]:
    transform = turned(0.5, (3, 1, 2), 1e-9)
    view_camera = seen_through(transform, near=1e-12)
    return Scene([SplatSet(plane(), transform @ turned(1e-5, (1, 2, 0)))]), view_camera


@named
def several_models() -> tuple[Scene, Camera]:
    """Each sheared along the same plane, and tilted otherwise."""
    sets = []
    for number in range(3):
        sheared = turned(2e-7 * (number + 1), (1, number, 0), (1.1, 0.9, 1))
        sheared[0, 1] += 0.2 * number
        sets.append(SplatSet(plane(100, number), sheared))
    transform = turned(0.4, (1, 2, 3))
    return Scene(
        [SplatSet(splat_set.data, transform @ splat_set.transform) for splat_set in sets]
    ), seen_through(transform)


@named
def orthographic() -> tuple[Scene, Camera]:
    transform = turned(0.7, (1, 2, 3))
    flat = seen_through(transform).flattened(6.0)
    return Scene([moved(plane(), transform)]), flat


@named
def sphere() -> tuple[Scene, Camera]:
    """Around a panorama's eye, as round as rounded rows are."""
    data = plane(500)
    toward = np.random.default_rng(5).normal(size=(500, 3))
    data.rows[:, :3] = 3 * toward / np.linalg.norm(toward, axis=1, keepdims=True)
    transform = turned(0.7, (1, 2, 3))
    transform[:3, 3] = 0.3, -0.2, 0.1
    around = Camera.panorama((0.3, -0.2, 0.1), (1, 0, 1), width=96)
    return Scene([SplatSet(data, transform)]), around
