"""Small scenes, each for one thing that a renderer can get wrong."""

from collections.abc import Callable

import numpy as np

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.scene import Box, Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

SCENES: dict[str, Callable[[], tuple[Scene, Camera]]] = {}


def named(make: Callable[[], tuple[Scene, Camera]]) -> Callable[[], tuple[Scene, Camera]]:
    SCENES[make.__name__] = make
    return make


def camera(width: int = 61, height: int = 47, **changes: float) -> Camera:
    """A camera at the origin that looks along +z; its sizes are no multiples of a tile."""
    values = {"fx": 50.0, "fy": 52.0, "cx": width / 2, "cy": height / 2} | changes
    return Camera(np.eye(4), width=width, height=height, **values)


def cloud(
    n: int,
    seed: int = 0,
    *,
    depth: tuple[float, float] = (2, 8),
    size: float = 0.08,
    thin: float = 0.5,
    opacity: tuple[float, float] = (0.05, 0.95),
    degree: int | None = None,
    dtype: type = np.float32,
) -> SplatData:
    """Random Gaussians in front of :func:`camera`, of all sizes, turns and opacities."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(*depth, n)
    position = np.stack([rng.uniform(-0.6, 0.6, n) * z, rng.uniform(-0.5, 0.5, n) * z, z], 1)
    scale = size * np.exp(thin * rng.normal(size=(n, 3)))
    covariance = covariance_upper(scale, rng.normal(size=(n, 4)))
    columns = [position, rng.uniform(*opacity, (n, 1)), covariance]
    rows = np.concatenate(columns, axis=1).astype(dtype)
    if degree is None:
        return SplatData(rows, rng.uniform(size=(n, 3)).astype(np.float32), "rgb")
    color = 0.3 * rng.normal(size=(n, 3 * (degree + 1) ** 2))
    return SplatData(rows, color.astype(dtype), "sh")


def single(*, depth: float = 3.0, opacity: float = 0.9, variance: object = 0.01) -> SplatData:
    row = np.zeros((1, 10), np.float32)
    row[0, 2:4] = depth, opacity
    row[0, [4, 7, 9]] = variance
    return SplatData(row, np.array([[0.9, 0.5, 0.1]], np.float32), "rgb")


def turned(angle: float, axis: tuple[float, float, float], scale: object = 1.0) -> np.ndarray:
    """A rotation times a scale, as [4, 4]."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    matrix[:3, :3] = matrix[:3, :3] @ np.diag(np.broadcast_to(scale, 3))
    return matrix


@named
def nothing() -> tuple[Scene, Camera]:
    return Scene([cloud(0)]), camera()


@named
def one() -> tuple[Scene, Camera]:
    return Scene([single()]), camera()


@named
def many() -> tuple[Scene, Camera]:
    return Scene([cloud(257)]), camera()


@named
def crowd() -> tuple[Scene, Camera]:
    """More than one block of every kernel; most of them beside the image."""
    data = cloud(65_537, size=0.01, opacity=(0.05, 0.3))
    data.rows[:, :2] *= 3
    return Scene([data]), camera()


@named
def principal_point_off_centre() -> tuple[Scene, Camera]:
    return Scene([cloud(200, 1)]), camera(cx=7.3, cy=41.9)


@named
def principal_point_outside() -> tuple[Scene, Camera]:
    return Scene([cloud(200, 2)]), camera(cx=-20.7, cy=60.1)


@named
def needles() -> tuple[Scene, Camera]:
    return Scene([cloud(150, 3, size=0.05, thin=1.6)]), camera()


@named
def smaller_than_a_pixel() -> tuple[Scene, Camera]:
    return Scene([cloud(500, 4, size=1e-4)]), camera()


@named
def points_without_extent() -> tuple[Scene, Camera]:
    return Scene([cloud(100, 5, size=0.0)]), camera()


@named
def huge() -> tuple[Scene, Camera]:
    return Scene([cloud(40, 6, size=30.0, opacity=(0.05, 0.3))]), camera()


@named
def close_to_the_camera() -> tuple[Scene, Camera]:
    return Scene([cloud(60, 7, depth=(0.02, 0.3), size=0.01)]), camera()


@named
def around_the_camera() -> tuple[Scene, Camera]:
    return Scene([cloud(200, 8, depth=(-4, 4))]), camera()


@named
def opacities_at_the_edges() -> tuple[Scene, Camera]:
    data = cloud(300, 9)
    edges = np.float32([0, 1 / 255, np.nextafter(np.float32(1 / 255), 0), 0.99, 1, 0.5])
    data.rows[:, 3] = edges[np.arange(300) % 6]
    return Scene([data]), camera()


@named
def same_depths() -> tuple[Scene, Camera]:
    data = cloud(200, 10)
    data.rows[:, 2] = np.float32([3, 4])[np.arange(200) % 2]
    return Scene([data]), camera()


@named
def not_finite() -> tuple[Scene, Camera]:
    """Every value of a row, and of a colour, is once NaN and once each infinity."""
    data = cloud(300, 11, degree=1)
    wrong = np.float32([np.nan, np.inf, -np.inf])
    for number in range(30):
        data.rows[2 * number, number % 10] = wrong[number // 10]
    for number in range(36):
        data.appearance[100 + number, number % 12] = wrong[number // 12]
    return Scene([data]), camera()


@named
def covariances_that_are_none() -> tuple[Scene, Camera]:
    data = cloud(200, 12)
    data.rows[::3, 4:] *= -1
    data.rows[1::6, 5] += 40
    return Scene([data]), camera()


@named
def enormous_numbers() -> tuple[Scene, Camera]:
    data = cloud(100, 13)
    data.rows[::4, 4:] *= 1e20
    data.rows[1::4, :2] *= 1e25
    return Scene([data]), camera()


def _of_degree(degree: int) -> tuple[Scene, Camera]:
    return Scene([cloud(200, 20 + degree, degree=degree)]), camera()


for _degree in range(4):
    SCENES[f"degree_{_degree}"] = lambda degree=_degree: _of_degree(degree)


@named
def half_floats() -> tuple[Scene, Camera]:
    sets = [cloud(90, 30 + d, degree=d, dtype=np.float16) for d in range(4)]
    return Scene(sets), camera()


@named
def fewer_live_than_rows() -> tuple[Scene, Camera]:
    data = cloud(200, 40)
    return Scene([SplatData(data.rows, data.appearance, "rgb", count=77)]), camera()


@named
def none_live_of_some() -> tuple[Scene, Camera]:
    data = cloud(50, 50, degree=2)
    return Scene([SplatData(data.rows, data.appearance, "sh", count=0), single()]), camera()


@named
def antialiased() -> tuple[Scene, Camera]:
    return Scene([SplatSet(cloud(300, 41, size=0.01), antialias="mip")]), camera()


@named
def placed() -> tuple[Scene, Camera]:
    """Sets with rotations, scales, a mirror and a shear; some are faint, capped or clipped."""
    set_transform = turned(0.7, (1, 2, 3), 1.5)
    set_transform[:3, 3] = 0.3, -0.2, 1.0
    sheared = turned(0.2, (0, 0, 1), (1, 2, 0.5))
    sheared[0, 1] += 0.4
    sheared[:3, 3] = 0, 0.1, 1.2
    mirrored = np.diag([-1.0, 1, 1, 1])
    sets = [
        SplatSet(cloud(120, 42, degree=3), set_transform, opacity_scale=0.5),
        SplatSet(cloud(120, 43, degree=3), sheared, degree=2, antialias="mip"),
        SplatSet(cloud(120, 44, degree=2), mirrored, opacity_scale=3.0),
        SplatSet(cloud(120, 45), clip=Box((-1, -1, 2), (0.5, 2, 5))),
    ]
    return Scene(sets), camera()


@named
def seen_from_elsewhere() -> tuple[Scene, Camera]:
    other_view = Camera.look_at((3, -2, -1), (0.2, 0.1, 4.5), width=61, height=47, fov_y=55)
    return Scene([cloud(250, 46, degree=3)]), other_view


@named
def flat_cameras() -> tuple[Scene, Camera]:
    """An orthographic camera; harmonics see one direction, in a set that is turned and sheared."""
    other_view = Camera.look_at((3, -2, -1), (0.2, 0.1, 4.5), width=61, height=47, fov_y=55)
    sheared = turned(0.4, (1, 2, 3), (1, 1.4, 0.8))
    sheared[:3, 3] = 0.5, 0.2, 0.3
    sets = [SplatSet(cloud(200, 48, degree=3), sheared), cloud(100, 49, size=0.2)]
    return Scene(sets), other_view.flattened(6.0)


@named
def far_from_the_origin() -> tuple[Scene, Camera]:
    """A model placed a hundred kilometres away: only differences to the camera count."""
    away = np.eye(4)
    away[:3, 3] = 1e5, -3e4, 7e4
    here = camera()
    view = np.eye(4)
    view[:3, 3] = -away[:3, 3]
    other_view = Camera(
        view, fx=here.fx, fy=here.fy, cx=here.cx, cy=here.cy, width=here.width, height=here.height
    )
    return Scene([SplatSet(cloud(200, 47, degree=3), away)]), other_view


def all_around(n: int, seed: int, degree: int | None = None, **kind: object) -> SplatData:
    """Random Gaussians in all directions, as many near the poles as anywhere."""
    data = cloud(n, seed, degree=degree, **kind)  # type: ignore[arg-type]
    rng = np.random.default_rng(seed)
    toward = rng.normal(size=(n, 3))
    toward *= rng.uniform(1, 6, (n, 1)) / np.linalg.norm(toward, axis=1, keepdims=True)
    data.rows[:, :3] = toward
    return data


@named
def panorama() -> tuple[Scene, Camera]:
    """All degrees, in sets of which one is turned; and values that are not finite."""
    placed = turned(0.7, (1, 2, 3), 1.3)
    placed[:3, 3] = 0.3, -0.2, 0.5
    sets = [all_around(60, 60 + d, degree=d) for d in range(4)]
    wrong = np.float32([np.nan, np.inf, -np.inf])
    sets[0].rows[np.arange(30), np.arange(30) % 10] = wrong[np.arange(30) // 10]
    around = Camera.panorama((0.1, 0.2, 0), (1, 0, 1), up=(0.1, -1, 0.2), width=101, height=47)
    return Scene([*sets, SplatSet(sets[3], placed, antialias="mip")]), around


@named
def panorama_seam() -> tuple[Scene, Camera]:
    """Half of what there is lies behind, across both edges of the image."""
    data = all_around(160, 64, size=0.3)
    data.rows[::2, 0] *= 0.05
    data.rows[::2, 2] = -np.abs(data.rows[::2, 2]) - 0.5
    return Scene([data]), Camera.panorama((0, 0, 0), width=96)


@named
def panorama_poles() -> tuple[Scene, Camera]:
    """Centres from the poles to ten degrees away, and one at each pole."""
    data = all_around(150, 65, size=0.05, thin=1.0)
    data.rows[:, [0, 2]] *= 0.15
    data.rows[:2, [0, 2]] = 0
    data.rows[:2, 1] = -2, 2
    return Scene([data]), Camera.panorama((0, 0, 0), width=128)


@named
def panorama_huge() -> tuple[Scene, Camera]:
    data = all_around(40, 66, size=20.0, opacity=(0.02, 0.2))
    return Scene([data]), Camera.panorama((0, 0, 0), width=70)


@named
def panorama_part() -> tuple[Scene, Camera]:
    """From over the left shoulder to behind the right one, from below the horizon to the pole."""
    part = {"longitudes": (100.0, 250.0), "latitudes": (-90.0, 10.0)}
    return Scene([all_around(200, 67, degree=1)]), Camera.panorama((0, 0, 0), width=90, **part)


LENSES = [
    "lens_barrel",
    "lens_cushion",
    "lens_rational",
    "fisheye",
    "fisheye_opencv",
    "fisheye_prism",
]
"""Scenes that cameras with a lens see: a distorted pinhole, or a fisheye beyond a quarter turn."""


def _through_lens(
    seed: int, *, is_fisheye: bool = False, **changes: object
) -> tuple[Scene, Camera]:
    """All around the camera, all degrees, with values that are not finite."""
    sets = [all_around(80, seed + d, size=0.2, degree=d) for d in range(3)]
    wrong = np.float32([np.nan, np.inf, -np.inf])
    sets[0].rows[np.arange(30), np.arange(30) % 10] = wrong[np.arange(30) // 10]
    sets[1].rows[:3, :2] = 0  # on the axis, in front and behind
    sets[1].rows[:3, 2] = 2, 3, -2
    placed = turned(0.7, (1, 2, 3), 1.3)
    placed[:3, 3] = 0.3, -0.2, 0.5
    focal = {"fx": 17.0, "fy": 18.0} if is_fisheye else {"fx": 45.0, "fy": 47.0}
    kind = "fisheye" if is_fisheye else "pinhole"
    view = turned(0.4, (2, -1, 1))
    values: dict[str, object] = {"width": 61, "height": 47, "cx": 31.5, "cy": 22.0, "kind": kind}
    camera = Camera(view, **values | focal | changes)  # type: ignore[arg-type]
    return Scene([*sets, SplatSet(sets[2], placed, antialias="mip")]), camera


@named
def lens_barrel() -> tuple[Scene, Camera]:
    """Its corners are beyond the fold."""
    return _through_lens(70, distortion=Distortion.of({"k1": -0.35, "k2": 0.02}))


@named
def lens_cushion() -> tuple[Scene, Camera]:
    lens = Distortion.of({"k1": 0.2, "k2": 0.05, "p1": 0.02, "p2": -0.03})
    return _through_lens(74, distortion=lens)


@named
def lens_rational() -> tuple[Scene, Camera]:
    values = {
        "k1": 0.3,
        "k2": 0.1,
        "k3": 0.02,
        "k4": 0.4,
        "k5": 0.1,
        "k6": 0.01,
        "p1": -0.01,
        "p2": 0.02,
    }
    return _through_lens(78, distortion=Distortion.of(values, is_rational=True))


@named
def fisheye() -> tuple[Scene, Camera]:
    return _through_lens(82, is_fisheye=True)


@named
def fisheye_opencv() -> tuple[Scene, Camera]:
    """Its principal point is outside the image, whose far corner is 150 degrees from the axis."""
    lens = Distortion.of({"k1": -0.03, "k2": 0.01, "k3": -0.001, "k4": 0.0001})
    return _through_lens(86, is_fisheye=True, distortion=lens, cx=-3.0)


@named
def fisheye_prism() -> tuple[Scene, Camera]:
    values = {"k1": -0.03, "k2": 0.005, "p1": 0.005, "p2": -0.003, "s1": 0.01, "s2": -0.004}
    return _through_lens(90, is_fisheye=True, distortion=Distortion.of(values))
