"""Lens distortion: its derivative, the range where it is one-to-one, and its inverse."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.oracle.projection import ellipses
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from references.lenses import lens_pixel

SIZE = {"width": 640, "height": 480, "cx": 325.0, "cy": 236.0}


def coefficient(largest: float) -> st.SearchStrategy[float]:
    return st.floats(-largest, largest, allow_subnormal=False)


LENSES = st.builds(
    Distortion,
    radial=st.tuples(*map(coefficient, (0.4, 0.2, 0.05, 0.01))),
    divisor=st.tuples(*map(coefficient, (0.3, 0.1, 0.02))),
    tangential=st.tuples(coefficient(0.03), coefficient(0.03)),
    prism=st.tuples(coefficient(0.02), coefficient(0.02)),
)
SYMMETRIC_LENSES = st.builds(
    Distortion,
    radial=st.tuples(*map(coefficient, (0.6, 0.4, 0.2, 0.1))),
    divisor=st.tuples(*map(coefficient, (0.5, 0.3, 0.2))),
)


def camera_of(kind: str, lens: Distortion) -> Camera:
    focal = 150.0 if kind == "fisheye" else 300.0
    return Camera(np.eye(4), fx=focal, fy=1.1 * focal, **SIZE, kind=kind, distortion=lens)  # type: ignore[arg-type]


@settings(max_examples=30, deadline=None)
@given(
    kind=st.sampled_from(["pinhole", "fisheye"]),
    lens=LENSES,
    pixel=st.tuples(st.floats(0, 640), st.floats(0, 480)),
    distance=st.floats(0.3, 30),
)
def test_projected_gaussians_have_the_derivative_of_the_lens_formulas(
    kind: str, lens: Distortion, pixel: tuple[float, float], distance: float
) -> None:
    """Central differences of OpenCV's formulas, at any place that the image shows."""
    camera = camera_of(kind, lens)
    [point] = camera.plane_points(np.array([pixel]))
    radius = math.hypot(*point)
    if radius > 0.98 * camera.ray_limit:
        return  # a black corner
    angle = radius if kind == "fisheye" else math.atan(radius)
    outward = point / radius if radius > 0 else np.array([1.0, 0.0])
    position = distance * np.array([*(math.sin(angle) * outward), math.cos(angle)])
    row = np.zeros((1, 10))
    row[0, :3], row[0, 4:] = position, (2e-4, 3e-5, -1e-5, 1e-4, 2e-5, 3e-4)
    data = SplatData(row.astype(np.float32), np.zeros((1, 3), np.float32), "rgb")
    actual = ellipses(row, SplatSet(data), camera)
    step = 1e-6 * distance
    ends = [
        (lens_pixel(camera, position + step * axis), lens_pixel(camera, position - step * axis))
        for axis in np.eye(3)
    ]
    jacobian = np.stack([np.subtract(high, low) for high, low in ends], 1) / (2 * step)
    expected = jacobian @ actual.sigma[0] @ jacobian.T
    assert actual.mean[0] == pytest.approx(lens_pixel(camera, position), abs=1e-6)
    np.testing.assert_allclose(
        actual.covariance[0], expected, rtol=1e-5, atol=1e-7 * expected.max()
    )


@settings(max_examples=30, deadline=None)
@given(kind=st.sampled_from(["pinhole", "fisheye"]), lens=SYMMETRIC_LENSES)
def test_distance_from_the_axis_grows_up_to_the_ray_limit(kind: str, lens: Distortion) -> None:
    camera = camera_of(kind, lens)
    limit = camera.ray_limit
    radii = np.linspace(0, min(limit, 20.0), 4000)[:-1]
    pixels = np.array([lens.distorted(np.array([[radius, 0.0]]))[0, 0] for radius in radii[::20]])
    assert (np.diff(pixels) > 0).all()
    if limit < (math.radians(179) if kind == "fisheye" else 1000):  # it folds just beyond
        beyond = np.array([[1.0001 * limit, 0.0], [0.9999 * limit, 0.0]])
        outside, inside = np.linalg.det(lens.jacobian(beyond))
        assert inside > -1e-9
        assert not outside > 1e-6 or not np.isfinite(outside) or _has_pole(lens, limit)


def _has_pole(lens: Distortion, limit: float) -> bool:
    s = limit * limit
    return abs(1 + sum(d * s ** (power + 1) for power, d in enumerate(lens.divisor))) < 1e-3


@settings(max_examples=30, deadline=None)
@given(kind=st.sampled_from(["pinhole", "fisheye"]), lens=LENSES, seed=st.integers(0, 1000))
def test_lens_turns_no_area_over_within_its_range(kind: str, lens: Distortion, seed: int) -> None:
    limit = lens.fold_radius(3.0 if kind == "fisheye" else 50.0)
    rng = np.random.default_rng(seed)
    angles = rng.uniform(0, 2 * np.pi, 300)
    points = (
        0.999
        * limit
        * np.sqrt(rng.uniform(size=(300, 1)))
        * np.stack([np.cos(angles), np.sin(angles)], 1)
    )
    assert (np.linalg.det(lens.jacobian(points)) > 0).all()


@settings(max_examples=30, deadline=None)
@given(lens=LENSES, seed=st.integers(0, 1000))
def test_undistorted_points_are_those_that_the_lens_moves_there(
    lens: Distortion, seed: int
) -> None:
    limit = lens.fold_radius(2.0)
    points = np.random.default_rng(seed).uniform(-0.4, 0.4, (50, 2)) * limit
    again = lens.undistorted(lens.distorted(points), limit)
    np.testing.assert_allclose(lens.distorted(again), lens.distorted(points), atol=1e-7)


def test_barrel_folds_where_its_derivative_is_zero() -> None:
    assert Distortion.of({"k1": -0.3}).fold_radius(9) == pytest.approx(1 / math.sqrt(0.9))
    assert Distortion.of({"k1": 0.3}).fold_radius(9) == 9
    pole = Distortion.of({"k4": -0.25}, is_rational=True)
    assert pole.fold_radius(9) == pytest.approx(2)
    tilted = Distortion.of({"k1": -0.3, "p1": 0.02})
    assert 0.9 < tilted.fold_radius(9) < 1 / math.sqrt(0.9)


def test_lens_without_coefficients_is_none() -> None:
    camera = camera_of("pinhole", Distortion())
    assert camera.distortion is None
    assert "distortion" not in camera.to_json()


def test_lens_is_stored_with_its_camera() -> None:
    lens = Distortion.of({"k1": 0.1, "k4": 0.2, "p2": 0.3, "s1": 0.4})
    again = Camera.from_json(camera_of("fisheye", lens).to_json())
    assert (again.kind, again.distortion) == ("fisheye", lens)


@pytest.mark.parametrize(
    ("kind", "distortion", "words"),
    [
        ("pinhole", {"radial": [1, 2]}, r"distortion.radial: is \[1, 2\], expected 4 numbers"),
        ("pinhole", {"radial": [math.nan] * 4}, "distortion.radial: is .*expected 4 numbers"),
        ("fisheye", {"prism": ["a", 0]}, "distortion.prism: is .*expected 2 numbers"),
        ("fisheye", {"k1": 0.1}, "distortion: is .*expected an object with some of radial"),
        ("fisheye", 3, "distortion: is 3, expected an object"),
        ("orthographic", {"radial": [0.1, 0, 0, 0]}, "of kind orthographic, expected pinhole"),
    ],
)
def test_invalid_lens_is_explained(kind: str, distortion: object, words: str) -> None:
    document = {"view": np.eye(4).tolist(), "fx": 9.0, "fy": 9.0, "kind": kind, **SIZE}
    with pytest.raises(SceneInvalid, match=words):
        Camera.from_dict(document | {"distortion": distortion})


@pytest.mark.parametrize("kind", ["pinhole", "fisheye"])
def test_any_coefficients_make_finite_numbers(kind: str) -> None:
    """Signs and sizes from 1e-30 to the largest ones, without a warning of NumPy."""
    rng = np.random.default_rng(0)
    for _ in range(30):
        values = 10.0 ** rng.uniform(-30, 6, 11) * rng.choice([-1, 0, 1], 11)
        radial, divisor, tangential, prism = np.split(values, [4, 7, 9])
        lens = Distortion(
            radial=tuple(radial.tolist()),
            divisor=tuple(divisor.tolist()),
            tangential=tuple(tangential.tolist()),
            prism=tuple(prism.tolist()),
        )
        camera = camera_of(kind, lens)
        assert 0 < camera.ray_limit <= 1000
        assert np.isfinite(camera.projection).all()
        assert 0 < camera.half_angle() <= math.pi
