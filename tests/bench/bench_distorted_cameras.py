"""How near splats are to the true pictures of Gaussians through lenses, and what lenses cost.

A splat is the linear part of the projection at a Gaussian's centre. The truth is sampled: see
``references.projected_density``. The table has the PSNR in dB of single Gaussians, in the smallest
rectangle that holds both pictures, by camera, by the angle from its axis, and by the size: the
largest standard deviation over the distance, which is also about the half angle that it covers.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from references.lenses import lens_pixels
from references.projected_density import decibels_where_drawn, sampled_alpha

SIZES = (0.003, 0.01, 0.03, 0.1)
ANGLES = (0, 30, 60, 80, 90, 100)  # degrees from the axis
OPACITY = 0.9
SEEDS = 2  # shapes and directions of each entry; the least figure is printed
WINDOW = 384  # pixels
_PIXELS_PER_RADIAN = 400.0

FISHEYE_KB = {"k1": -0.03, "k2": 0.008, "k3": -0.0015, "k4": 0.0001}
LENSES: dict[str, tuple[str, Distortion | None]] = {
    "pinhole": ("pinhole", None),
    "SIMPLE_RADIAL": ("pinhole", Distortion.of({"k1": -0.12})),
    "RADIAL": ("pinhole", Distortion.of({"k1": -0.2, "k2": 0.04})),
    "OPENCV": ("pinhole", Distortion.of({"k1": 0.06, "k2": -0.01, "p1": 0.004, "p2": -0.006})),
    "FULL_OPENCV": (
        "pinhole",
        Distortion.of(
            {"k1": 0.5, "k2": 0.1, "k3": 0.01, "k4": 0.7, "k5": 0.2, "k6": 0.02, "p1": 0.002},
            is_rational=True,
        ),
    ),
    "FISHEYE": ("fisheye", None),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", Distortion.of({"k1": -0.02})),
    "RADIAL_FISHEYE": ("fisheye", Distortion.of({"k1": -0.03, "k2": 0.004})),
    "OPENCV_FISHEYE": ("fisheye", Distortion.of(FISHEYE_KB)),
    "THIN_PRISM_FISHEYE": (
        "fisheye",
        Distortion.of(FISHEYE_KB | {"p1": 0.002, "p2": -0.003, "s1": 0.004, "s2": -0.002}),
    ),
}


def lens_camera(name: str) -> Camera:
    kind, lens = LENSES[name]
    side = 1920
    return Camera(
        np.eye(4),
        fx=_PIXELS_PER_RADIAN,
        fy=_PIXELS_PER_RADIAN,
        cx=side / 2,
        cy=side / 2,
        width=side,
        height=side,
        kind=kind,  # type: ignore[arg-type]
        distortion=lens,
    )


def one_gaussian(
    rng: np.random.Generator, degrees: float, size: float
) -> tuple[SplatData, np.ndarray]:
    """A Gaussian of three different axes, at distance 4 and an angle from the axis."""
    angle, turn = np.radians(degrees), rng.uniform(0, 2 * np.pi)
    center = 4 * np.array(
        [np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)]
    )
    w_last = Rotation.random(rng=rng).as_quat()
    scales = 4 * size * np.array([[1.0, 0.6, 0.3]])
    upper = covariance_upper(scales, w_last[None, [3, 0, 1, 2]])
    row = np.concatenate([[center], [[OPACITY]], upper], axis=1).astype(np.float32)
    xx, xy, xz, yy, yz, zz = upper[0]
    covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return SplatData(row, np.ones((1, 3), np.float32), "rgb"), covariance


def around(camera: Camera, center: np.ndarray) -> Camera:
    """The part of a camera's image around the pixel of a point."""
    x, y = np.floor(lens_pixels(camera, center[None])[0] - WINDOW / 2)
    return replace(camera, cx=camera.cx - x, cy=camera.cy - y, width=WINDOW, height=WINDOW)


def decibels(renderer: Renderer, camera: Camera, degrees: float, size: float) -> float:
    """Return the least PSNR of some Gaussians; NaN if the camera does not see them."""
    figures = []
    for seed in range(SEEDS):
        data, covariance = one_gaussian(np.random.default_rng(seed), degrees, size)
        center = data.rows[0, :3].astype(float)
        window = around(camera, center)
        drawn = renderer.render(Scene([data]), window).alpha
        expected = sampled_alpha(window, center, covariance, OPACITY, exponent=19)
        figures.append(decibels_where_drawn(drawn, expected))
    return min(figures)


def bench_distorted_cameras() -> None:
    renderer = Renderer(rasteriser="tiles")
    write = sys.stdout.write
    flat = lens_camera("pinhole").flattened(4)
    floors = "  ".join(f"{decibels(renderer, flat, 10, size):5.1f}" for size in SIZES)
    write(f"\n  sizes {', '.join(map(str, SIZES))}: least PSNR of {SEEDS} Gaussians in dB\n")
    write(f"  of the sampling itself (an orthographic camera, where splats are exact): {floors}\n")
    for name, (kind, _) in LENSES.items():
        camera = lens_camera(name)
        limit = camera.ray_limit if kind == "fisheye" else np.arctan(camera.ray_limit)
        write(f"\n  {name}, up to {np.degrees(limit):.1f}°\n")
        for degrees in ANGLES:
            if degrees > np.degrees(limit) - 5 or (kind == "pinhole" and degrees > 65):
                continue
            figures = [f"{decibels(renderer, camera, degrees, size):5.1f}" for size in SIZES]
            write(f"  {degrees:5}°   {'  '.join(figures)}\n")


def bench_cost_of_lenses() -> None:
    """CPU seconds of a frame of the same scene by each camera; pictures differ, and so do pairs."""
    rng = np.random.default_rng(0)
    count = 300_000
    centers = rng.normal(size=(count, 3)) * (3, 2, 3)
    upper = covariance_upper(
        0.012 * np.exp(0.4 * rng.normal(size=(count, 3))), rng.normal(size=(count, 4))
    )
    rows = np.concatenate([centers, rng.uniform(0.05, 0.6, (count, 1)), upper], 1)
    colors = rng.uniform(size=(count, 3)).astype(np.float32)
    scene = Scene([SplatData(rows.astype(np.float32), colors, "rgb")])
    renderer = Renderer(rasteriser="tiles")
    for name in ("pinhole", "OPENCV", "FULL_OPENCV", "FISHEYE", "OPENCV_FISHEYE"):
        camera = lens_camera(name).scaled(640, 640)
        seconds, frame = [], renderer.render(scene, camera)
        for _ in range(5):
            start = time.process_time()
            frame = renderer.render(scene, camera)
            seconds.append(time.process_time() - start)
        note = f"{frame.visible:,} of {count:,} Gaussians, {frame.pairs:,} pairs"
        sys.stdout.write(f"\n  {name}: {min(seconds):.3f} s, {note}")
    sys.stdout.write("\n")
