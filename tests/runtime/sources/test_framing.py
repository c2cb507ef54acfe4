"""The default camera shows the whole object, and floaters do not push it away."""

from collections.abc import Callable

import numpy as np
import pytest

from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.framing import box_around
from gsgen.runtime.sources.scene_source import sources_of

Points = np.ndarray


def ball(rng: np.random.Generator) -> Points:
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions * rng.uniform(size=(4000, 1)) ** (1 / 3)


def shell(rng: np.random.Generator) -> Points:
    directions = rng.normal(size=(3000, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def cube(rng: np.random.Generator) -> Points:
    return rng.uniform(-1, 1, (2000, 3))


def column(rng: np.random.Generator) -> Points:
    return rng.uniform(-1, 1, (3000, 3)) * [0.2, 3, 0.2]


def sheet(rng: np.random.Generator) -> Points:
    return rng.uniform(-1, 1, (2000, 3)) * [4, 0.01, 2]


def spire(rng: np.random.Generator) -> Points:
    """A disc, and 1 % of the Gaussians in a pole three times as high as the disc is wide."""
    disc = rng.uniform(-1, 1, (3000, 3)) * [1, 0.05, 1]
    pole = np.zeros((30, 3))
    pole[:, 1] = np.linspace(0, -6, 30)
    return np.concatenate([disc, pole])


def figure(rng: np.random.Generator) -> Points:
    """A body, a head with 1 % of the Gaussians, and an arm with as many."""
    body = rng.normal(size=(5000, 3)) * [0.25, 0.6, 0.2]
    body = body[(np.abs(body) < [0.5, 1, 0.4]).all(axis=1)]
    head = rng.uniform(-0.15, 0.15, (50, 3)) - [0, 1.1, 0]
    arm = rng.uniform(-1, 1, (50, 3)) * [0.5, 0.05, 0.05] + [0.9, -0.5, 0]
    return np.concatenate([body, head, arm])


def cone(rng: np.random.Generator) -> Points:
    """Few Gaussians are near the tip."""
    height = rng.uniform(size=2000) ** (1 / 3)
    angle, radius = rng.uniform(0, 2 * np.pi, 2000), height * np.sqrt(rng.uniform(size=2000))
    return np.stack([radius * np.cos(angle), 2 * height, radius * np.sin(angle)], 1)


def two_things(rng: np.random.Generator) -> Points:
    return np.concatenate([ball(rng) * 0.5 - [3, 0, 0], cube(rng) * 0.5 + [3, 0, 0]])


def ring(rng: np.random.Generator) -> Points:
    angle = rng.uniform(0, 2 * np.pi, 1500)
    return np.stack([np.cos(angle), 0.1 * rng.normal(size=1500), np.sin(angle)], 1)


def few(rng: np.random.Generator) -> Points:
    return rng.uniform(-1, 1, (12, 3))


def single(rng: np.random.Generator) -> Points:
    return np.full((1, 3), 2.0)


SHAPES: dict[str, Callable[[np.random.Generator], Points]] = {
    function.__name__: function
    for function in (
        ball,
        shell,
        cube,
        column,
        sheet,
        spire,
        figure,
        cone,
        two_things,
        ring,
        few,
        single,
    )
}


def splats(points: Points, sigma: float, opacity: float = 0.9) -> SplatData:
    rows = np.zeros((len(points), 10), np.float32)
    rows[:, :3], rows[:, 3] = points, opacity
    rows[:, [4, 7, 9]] = sigma**2
    return SplatData(rows, np.ones((len(points), 3), np.float32), "rgb")


def floaters(rng: np.random.Generator, points: Points, count: int) -> Points:
    """Points that are two to forty times as far from the middle as the farthest of the object."""
    middle = points.mean(axis=0)
    reach = np.linalg.norm(points - middle, axis=1).max() + 0.1
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return middle + directions * reach * rng.uniform(2, 40, (count, 1))


def projected_share(camera: Camera, points: Points, sigma: float, opacity: float) -> float:
    """How much of the half picture the object takes; up to 1, all of it is inside."""
    in_camera = points @ camera.view[:3, :3].T + camera.view[:3, 3]
    radius = sigma * np.sqrt(2 * np.log(255 * opacity))  # where alpha falls below 1/255
    # A sphere projects into the cone of half angle asin(radius / distance) around its centre.
    shares = []
    for axis, focal, half in ((0, camera.fx, camera.width / 2), (1, camera.fy, camera.height / 2)):
        angle = np.arctan2(np.abs(in_camera[:, axis]), in_camera[:, 2])
        spread = np.arcsin(radius / np.hypot(in_camera[:, axis], in_camera[:, 2]))
        shares.append(focal * np.tan(angle + spread) / half)
    return float(np.max(shares))


@pytest.mark.parametrize("size", [(128, 128), (160, 90), (90, 160)])
@pytest.mark.parametrize("camera", [None, "orbit:0,0", "orbit:75,-40", "orbit:200,89"])
@pytest.mark.parametrize("name", SHAPES)
def test_the_whole_object_is_in_the_picture(
    name: str, camera: str | None, size: tuple[int, int]
) -> None:
    rng = np.random.default_rng(3)
    points, sigma, opacity = SHAPES[name](rng), 0.03, 0.9
    (source,) = sources_of(splats(points, sigma, opacity))
    share = projected_share(viewpoint(camera, *size).camera(source, 0, 0.0), points, sigma, opacity)
    assert share < 0.97
    bounding_radius = np.linalg.norm(np.ptp(points, axis=0)) / 2 + np.sqrt(3) * 3.4 * sigma
    assert source.extent()[1] <= bounding_radius, "the object would be small in the picture"


@pytest.mark.parametrize("name", sorted(SHAPES.keys() - {"few", "single"}))
@pytest.mark.parametrize("share", [0.002, 0.01, 0.05])
def test_floaters_do_not_push_the_camera_away(name: str, share: float) -> None:
    rng = np.random.default_rng(5)
    points = SHAPES[name](rng)
    far = floaters(rng, points, max(1, round(share * len(points))))
    without, together = (
        sources_of(splats(positions, 0.03))[0].extent()
        for positions in (points, np.concatenate([points, far]))
    )
    np.testing.assert_allclose(together[0], without[0], atol=0.02 * without[1])
    assert together[1] == pytest.approx(without[1], rel=0.02)


def test_floaters_of_a_large_scene_do_not_push_the_camera_away() -> None:
    """Of many Gaussians a sample is grouped, and all those of the object are in the box."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (300_000, 3))
    pole = np.stack([np.zeros(3000), np.linspace(1, 9, 3000), np.zeros(3000)], 1)
    object_points = np.concatenate([points, pole])
    every = np.concatenate([object_points, floaters(rng, points, 3000)])
    expected = box_around(splats(object_points, 0.01))
    np.testing.assert_allclose(expected, [[-1.033] * 3, [1.033, 9.033, 1.033]], atol=1e-3)
    np.testing.assert_allclose(box_around(splats(every, 0.01)), expected, atol=0.1)  # type: ignore[arg-type]


def test_the_visible_edges_count() -> None:
    """Large Gaussians at the ends: the box holds them to an alpha of 1/255."""
    low, high = box_around(splats(np.zeros((1, 3)), 2.0, opacity=0.5))  # type: ignore[misc]
    np.testing.assert_allclose(high, 2 * np.sqrt(2 * np.log(127.5)))
    np.testing.assert_allclose(low, -high)
    assert box_around(splats(np.zeros((0, 3)), 1.0)) is None


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30, -1e30])
def test_broken_rows_do_not_count(value: float) -> None:
    points = cube(np.random.default_rng(1))
    expected = box_around(splats(points, 0.01))
    broken = np.concatenate([points, np.full((3, 3), value)])
    np.testing.assert_allclose(box_around(splats(broken, 0.01)), expected)  # type: ignore[arg-type]
    rows = splats(points, 0.01)
    rows.rows[:2, 4:] = value
    actual = box_around(rows)
    np.testing.assert_allclose(actual, expected, atol=0.1)  # type: ignore[arg-type]


def test_a_sky_of_one_huge_gaussian_is_a_floater() -> None:
    points = cube(np.random.default_rng(1))
    data = splats(np.concatenate([points, np.zeros((2, 3))]), 0.01)
    data.rows[-2:, [4, 7, 9]] = 50.0**2
    np.testing.assert_allclose(box_around(data), box_around(splats(points, 0.01)))  # type: ignore[arg-type]


def test_disks_that_overlap_are_one_object() -> None:
    """A ground of few large disks around an object of many small Gaussians."""
    rng = np.random.default_rng(2)
    x, z = np.meshgrid(np.linspace(-5, 5, 7), np.linspace(-5, 5, 7))
    ground = np.stack([x.ravel(), np.ones(49), z.ravel()], 1)
    data = splats(np.concatenate([cube(rng) * [1, 1, 1], ground]), 0.03)
    data.rows[-49:, [4, 9]] = 0.9**2
    low, high = box_around(data)  # type: ignore[misc]
    assert (low[[0, 2]] < -5).all()
    assert (high[[0, 2]] > 5).all()


def test_a_scene_file_in_memory_is_framed_in_the_world() -> None:
    points = cube(np.random.default_rng(0)) + np.array([7.0, 0, 0])
    scene = Scene([splats(points, 0.01)])
    (source,) = sources_of(scene)
    np.testing.assert_allclose(source.extent()[0], [7, 0, 0], atol=0.05)
