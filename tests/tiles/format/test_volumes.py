"""Volumes: distances, parts and the globe against other ways of computing them."""

import numpy as np
import pytest

from gsgen.tiles.format.volumes import Box, Region, Sphere, ecef, geodetic

RNG = np.random.default_rng(4)


def turned_box() -> Box:
    axes = np.linalg.qr(RNG.normal(size=(3, 3)))[0] * [[1.0], [2.0], [0.5]]
    return Box(np.array([3.0, -1.0, 2.0]), axes)


def test_points_of_a_box_are_within_and_others_are_not() -> None:
    box = turned_box()
    inside = box.center + RNG.uniform(-1, 1, (500, 3)) @ box.half_axes
    assert box.outside(inside).max() < 1e-12
    for axis in range(3):
        out = box.center + 1.25 * box.half_axes[axis]
        expected = 0.25 * np.linalg.norm(box.half_axes[axis])
        assert box.outside(out[None])[0] == pytest.approx(expected)
    assert box.outside(box.samples()).max() < 1e-12
    assert box.size == pytest.approx(2 * np.sqrt(1 + 4 + 0.25))


@pytest.mark.parametrize("flat", [(0,), (2,), (0, 1), (0, 1, 2)])
def test_flat_boxes_have_an_inside(flat: tuple[int, ...]) -> None:
    axes = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    axes[list(flat)] = 0
    box = Box(np.zeros(3), axes)
    assert box.outside(box.samples()).max() < 1e-12
    assert box.outside(np.array([[3.0, 4.0, 5.0]]))[0] > 1


@pytest.mark.parametrize("dimensions", [2, 3])
def test_cells_of_a_level_fill_the_volume(dimensions: int) -> None:
    box = turned_box()
    region = Region(west=3.1, south=-0.2, east=-3.1, north=0.3, minimum=0, maximum=100)
    cells = np.stack(np.meshgrid(*[range(4)] * dimensions), axis=-1).reshape(-1, dimensions)
    boxes = [box.child(tuple(cell), 2) for cell in cells.tolist()]
    parts = [abs(np.linalg.det(part.half_axes)) for part in boxes]
    assert sum(parts) == pytest.approx(abs(np.linalg.det(box.half_axes)))
    points = box.center + RNG.uniform(-1, 1, (200, 3)) @ box.half_axes
    nearest = np.min([part.outside(points) for part in boxes], axis=0)
    assert nearest.max() < 1e-12
    regions = [region.child(tuple(cell), 2) for cell in cells.tolist()]
    assert min(part.west for part in regions) == pytest.approx(3.1)
    widths = [part.width for part in regions]
    assert np.allclose(widths, (2 * np.pi - 6.2) / 4)


def test_geodetic_inverts_ecef() -> None:
    longitude = RNG.uniform(-np.pi, np.pi, 1000)
    latitude = RNG.uniform(-1.57, 1.57, 1000)
    height = RNG.uniform(-5000, 10_000, 1000)
    back = geodetic(ecef(longitude, latitude, height))
    assert np.abs(back[0] - longitude).max() < 1e-12
    assert np.abs(back[1] - latitude).max() < 1e-12
    assert np.abs(back[2] - height).max() < 1e-6
    (pole,) = ecef(np.zeros(1), np.full(1, np.pi / 2), np.zeros(1))
    assert np.allclose(pole, [0, 0, 6356752.314245], atol=1e-5)


def test_region_contains_its_points() -> None:
    region = Region(west=0.1, south=0.5, east=0.11, north=0.52, minimum=-5, maximum=60)
    longitude, latitude = RNG.uniform(0.1, 0.11, 300), RNG.uniform(0.5, 0.52, 300)
    points = ecef(longitude, latitude, RNG.uniform(-5, 60, 300))
    assert region.outside(points).max() < 1e-5
    above = ecef(longitude, latitude, np.full(300, 75.0))
    assert np.allclose(region.outside(above), 15, atol=1e-5)
    assert region.outside(region.samples()).max() < 1e-5


def test_a_transform_moves_boxes_and_spheres() -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = 2 * np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    matrix[:3, 3] = [5, 6, 7]
    box = turned_box()
    expected = box.samples() @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(box.transformed(matrix).samples(), expected)
    sphere = Sphere(np.array([1.0, 2, 3]), 2.0).transformed(matrix)
    assert sphere.radius == pytest.approx(4)
    assert np.allclose(sphere.center, matrix[:3, :3] @ [1, 2, 3] + [5, 6, 7])
