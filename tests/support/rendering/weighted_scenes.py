"""Small scenes of cells, each for one thing that weighted sums can get wrong."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.scene import Box, Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.mesh_scenes import ball, moved, quad, wall
from support.rendering.splat_scenes import camera, cloud, turned

WEIGHTED: dict[str, Callable[[], tuple[Scene, Camera]]] = {}


def named(make: Callable[[], tuple[Scene, Camera]]) -> Callable[[], tuple[Scene, Camera]]:
    WEIGHTED[make.__name__] = make
    return make


def celled(
    cells: int,
    per_cell: int = 5,
    seed: int = 0,
    *,
    depth: tuple[float, float] = (2, 8),
    size: float = 0.25,
    share: float = 0.4,
    opacity: tuple[float, float] = (0.05, 0.95),
    degree: int | None = None,
    dtype: type = np.float32,
) -> SplatData:
    """Random cells in front of :func:`camera`, with smaller Gaussians in each."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(*depth, cells)
    middle = np.stack([rng.uniform(-0.6, 0.6, cells) * z, rng.uniform(-0.5, 0.5, cells) * z, z], 1)
    extent = size * np.exp(0.3 * rng.normal(size=(cells, 3)))
    ellipsoid = covariance_upper(extent, rng.normal(size=(cells, 4)))
    own = np.concatenate([middle, rng.uniform(0.2, 1, (cells, 1)), ellipsoid], 1)
    n = cells * per_cell
    center = np.repeat(middle, per_cell, 0) + np.repeat(extent, per_cell, 0) * rng.uniform(
        -1, 1, (n, 3)
    )
    scale = share * np.repeat(extent, per_cell, 0) * np.exp(0.4 * rng.normal(size=(n, 3)))
    shape = covariance_upper(scale, rng.normal(size=(n, 4)))
    rows = np.concatenate([center, rng.uniform(*opacity, (n, 1)), shape], 1).astype(dtype)
    color = rng.uniform(size=(n, 3)).astype(np.float32)
    if degree is not None:
        color = 0.3 * rng.normal(size=(n, 3 * (degree + 1) ** 2)).astype(dtype)
    space = "rgb" if degree is None else "sh"
    return SplatData(rows, color, space, cells=own.astype(dtype), per_cell=per_cell)


def summed(
    data: SplatData,
    *,
    depth_range: float | None = 12.5,
    background: float = 0.15,
    divisor: float = 1.0,
    **how: Any,
) -> SplatSet:
    weighted = WeightedSum(background=background, depth_range=depth_range, opacity_divisor=divisor)
    return SplatSet(data, weighted=weighted, **how)


@named
def no_cells() -> tuple[Scene, Camera]:
    return Scene([summed(celled(0))]), camera()


@named
def one_cell() -> tuple[Scene, Camera]:
    return Scene([summed(celled(1))]), camera()


@named
def many_cells() -> tuple[Scene, Camera]:
    return Scene([summed(celled(257))]), camera()


def _of_size(per_cell: int) -> tuple[Scene, Camera]:
    return Scene([summed(celled(60, per_cell, per_cell))]), camera()


for _size in (1, 3, 10):
    WEIGHTED[f"cells_of_{_size}"] = lambda size=_size: _of_size(size)


@named
def weights_that_do_not_fall() -> tuple[Scene, Camera]:
    return Scene([summed(celled(80, seed=1), depth_range=None)]), camera()


@named
def beyond_the_range() -> tuple[Scene, Camera]:
    """Half of the Gaussians are farther than weights reach."""
    return Scene([summed(celled(80, seed=2), depth_range=5.0)]), camera()


@named
def divided_opacity() -> tuple[Scene, Camera]:
    return Scene([summed(celled(80, seed=3), divisor=2.0)]), camera()


@named
def multiplied_opacity() -> tuple[Scene, Camera]:
    """A divisor below 1: what covers more than everything lets nothing through."""
    return Scene([summed(celled(80, seed=4), divisor=0.4)]), camera()


@named
def nothing_shows_through() -> tuple[Scene, Camera]:
    """The background has no weight, so that the faintest Gaussian hides it."""
    return Scene([summed(celled(30, seed=5), background=0.0)]), camera()


@named
def finished_early() -> tuple[Scene, Camera]:
    """Opaque and large: most pixels are finished long before the last cell."""
    data = celled(150, seed=6, size=0.9, share=0.8, opacity=(0.9, 1))
    data.cells[:, 3] = 1
    return Scene([summed(data, depth_range=None)]), camera()


@named
def not_finite_cells() -> tuple[Scene, Camera]:
    """Every value of a cell, and of a Gaussian, is once NaN and once each infinity."""
    data = celled(100, seed=7, degree=1)
    wrong = np.float32([np.nan, np.inf, -np.inf])
    for number in range(30):
        data.cells[2 * number, number % 10] = wrong[number // 10]
        data.rows[7 * number + 3, number % 10] = wrong[number // 10]
        data.appearance[9 * number + 1, number % 12] = wrong[number // 10]
    return Scene([summed(data)]), camera()


@named
def invisible_cells() -> tuple[Scene, Camera]:
    data = celled(90, seed=8)
    data.cells[::3, 3] = 0
    data.cells[1::3, 3] = np.float32([-1, 1e-3, 2.5])[np.arange(30) % 3]
    return Scene([summed(data)]), camera()


@named
def cells_that_are_no_ellipsoids() -> tuple[Scene, Camera]:
    data = celled(60, seed=9)
    data.cells[::3, 4:] *= -1
    data.cells[1::6, 5] += 40
    data.cells[2::6, 4:] = 0
    data.rows[::11, 4:] *= -1
    return Scene([summed(data)]), camera()


@named
def cells_at_the_same_depth() -> tuple[Scene, Camera]:
    """Ties go by index, through two sets."""
    sets = []
    for seed in (10, 11):
        data = celled(80, seed=seed, size=0.5, share=0.7)
        data.cells[:, 2] = np.float32([3, 4])[np.arange(80) % 2]
        sets.append(summed(data))
    return Scene(sets), camera()


@named
def around_the_camera_in_cells() -> tuple[Scene, Camera]:
    return Scene([summed(celled(120, seed=12, depth=(-3, 4)))]), camera()


@named
def smaller_than_their_gaussians() -> tuple[Scene, Camera]:
    """Tiles are those of the cell: what its Gaussians reach beyond them is left out."""
    return Scene([summed(celled(60, seed=13, size=0.03, share=6.0))]), camera()


@named
def needles_in_cells() -> tuple[Scene, Camera]:
    """Circles as large as the longer axis, which thin Gaussians fill badly."""
    data = celled(60, seed=14)
    data.rows[:, 4:] = covariance_upper(
        np.tile([0.6, 0.02, 0.005], (300, 1)), np.random.default_rng(14).normal(size=(300, 4))
    )
    return Scene([summed(data)]), camera()


@named
def fewer_live_than_cells_have() -> tuple[Scene, Camera]:
    """The last live cell has lost some of its Gaussians."""
    data = celled(60, seed=15)
    partial_data = SplatData(
        data.rows, data.appearance, "rgb", count=133, cells=data.cells, per_cell=5
    )
    return Scene([summed(partial_data)]), camera()


@named
def half_floats_in_cells() -> tuple[Scene, Camera]:
    sets = [summed(celled(40, seed=20 + d, degree=d, dtype=np.float16)) for d in range(4)]
    return Scene(sets), camera()


@named
def placed_cells() -> tuple[Scene, Camera]:
    """Sets with transforms, weights and sizes of their own, in one order of cells."""
    set_transform = turned(0.7, (1, 2, 3), 1.5)
    set_transform[:3, 3] = 0.3, -0.2, 1.0
    sheared = turned(0.2, (0, 0, 1), (1, 2, 0.5))
    sheared[0, 1] += 0.4
    sheared[:3, 3] = 0, 0.1, 1.2
    sets = [
        summed(celled(40, 5, 30, degree=3), transform=set_transform, opacity_scale=0.5),
        summed(
            celled(50, 3, 31, degree=3),
            transform=sheared,
            degree=2,
            antialias="mip",
            background=2.0,
            depth_range=8.0,
        ),
        summed(
            celled(70, 1, 32, degree=2),
            transform=np.diag([-1.0, 1, 1, 1]),
            opacity_scale=3.0,
            background=0.0,
            divisor=1.7,
        ),
        summed(celled(40, 7, 33), clip=Box((-1, -1, 2), (0.5, 2, 5)), depth_range=None),
    ]
    return Scene(sets), camera()


@named
def cells_seen_flat() -> tuple[Scene, Camera]:
    other_view = Camera.look_at((3, -2, -1), (0.2, 0.1, 4.5), width=61, height=47, fov_y=55)
    return Scene([summed(celled(100, seed=34, degree=3))]), other_view.flattened(6.0)


@named
def cells_all_around() -> tuple[Scene, Camera]:
    """A panorama, whose seam cells and Gaussians cross."""
    data = celled(120, seed=35, depth=(-4, 4), size=0.4)
    data.cells[:, 0] *= 2
    data.rows[:, 0] = data.cells[:, 0].repeat(5) + np.tile([0, 0.1, -0.1, 0.2, -0.2], 120)
    return Scene([summed(data)]), Camera.panorama((0, 0, 0), width=96)


@named
def cells_through_a_lens() -> tuple[Scene, Camera]:
    lens = Distortion.of({"k1": -0.2, "k2": 0.03, "p1": 0.01, "p2": -0.02})
    view = camera()
    return Scene([summed(celled(100, seed=37, degree=2))]), replace(view, distortion=lens)


@named
def cells_in_a_fisheye() -> tuple[Scene, Camera]:
    """Some cells are beside the camera, and some behind it."""
    data = celled(120, seed=38, depth=(-4, 4), size=0.4)
    data.cells[:, 0] *= 2
    data.rows[:, 0] = data.cells[:, 0].repeat(5) + np.tile([0, 0.1, -0.1, 0.2, -0.2], 120)
    lens = Distortion.of({"k1": -0.03, "k2": 0.005})
    return Scene([summed(data)]), replace(camera(fx=17.0, fy=18.0), kind="fisheye", distortion=lens)


@named
def far_beside() -> tuple[Scene, Camera]:
    """The principal point is outside of the image, by no whole number of tiles."""
    return Scene([summed(celled(90, seed=36))]), camera(cx=-4.7, cy=49.1)


MIXED: dict[str, Callable[[], tuple[Scene, Camera]]] = {}


def mixed(make: Callable[[], tuple[Scene, Camera]]) -> Callable[[], tuple[Scene, Camera]]:
    MIXED[make.__name__] = make
    return make


@mixed
def among_sorted_gaussians() -> tuple[Scene, Camera]:
    return Scene([cloud(90, 50), summed(celled(60, seed=51)), cloud(90, 52)]), camera()


@mixed
def behind_and_before_a_mesh() -> tuple[Scene, Camera]:
    """Half of the Gaussians are behind the wall, and count for nothing there."""
    return Scene([summed(celled(80, seed=53))], meshes=[wall(5)]), camera()


@mixed
def among_everything() -> tuple[Scene, Camera]:
    sets = [
        cloud(70, 54, degree=2),
        summed(celled(50, seed=55), background=1.5),
        summed(celled(40, 3, 56), divisor=2.0),
    ]
    return Scene(sets, meshes=[Mesh(ball(), moved(0.2, 0, 4)), wall(7)]), camera()


@mixed
def opaque_among_sorted() -> tuple[Scene, Camera]:
    """What is summed finishes pixels, and hides what is sorted behind it."""
    data = celled(80, seed=57, size=0.9, share=0.8, opacity=(0.9, 1), depth=(3, 4))
    return Scene([cloud(80, 58), summed(data)]), camera()


@mixed
def everything_seen_flat() -> tuple[Scene, Camera]:
    scene, view_camera = among_everything()
    return scene, view_camera.flattened(5.0)


@mixed
def among_everything_all_around() -> tuple[Scene, Camera]:
    """A room whose walls cells reach through, and a wall that all of them cross."""
    scene, view_camera = WEIGHTED["cells_all_around"]()
    sets = [*scene.sets, cloud(90, 59, depth=(-4, 4))]
    room = Mesh(ball(3, 5), np.diag([3.5, 3.5, 3.5, 1]))
    leaning = quad([[-2, -1, -2], [2, -1, -3], [2.5, 1.5, -3], [-2, 1, -2]])
    return Scene(sets, meshes=[room, leaning]), view_camera
