r"""What two eyes cost: a stereo frame beside a frame of one eye, and of both eyes one by one.

CPU seconds are those of the whole process, the driver's threads included; the least of several
frames is printed.

    .venv/bin/python -m pytest tests/bench/bench_stereo.py -s -o python_files='bench_*.py' \
        -o python_functions='bench_*'
"""

import sys
import time
from collections.abc import Callable

import numpy as np

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.eyes import beside, eye_frames, pair_of_eyes
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData

COUNT, SHARE, DECIBELS = 300_000, 2.0, 60.0
CAMERA = Camera(np.eye(4), fx=450.0, fy=450.0, cx=320.0, cy=180.0, width=640, height=360)


def harmonics() -> SplatData:
    """Gaussians of degree 3, of which most are in view."""
    rng = np.random.default_rng(0)
    z = rng.uniform(2, 8, COUNT)
    centers = np.stack(
        [rng.uniform(-0.8, 0.8, COUNT) * z, rng.uniform(-0.45, 0.45, COUNT) * z, z], 1
    )
    scales = 0.012 * np.exp(0.4 * rng.normal(size=(COUNT, 3)))
    sigma = covariance_upper(scales, rng.normal(size=(COUNT, 4)))
    rows = np.concatenate([centers, rng.uniform(0.05, 0.6, (COUNT, 1)), sigma], 1)
    appearance = rng.normal(0, 0.3, (COUNT, 48)).astype(np.float32)
    return SplatData(rows.astype(np.float32), appearance, "sh")


def cpu(*draws: Callable[[], object], times: int = 8) -> list[float]:
    """Return the least CPU seconds of each way to draw, which take turns."""
    durations = np.empty((times + 2, len(draws)))
    for turn in durations:
        for number, draw in enumerate(draws):
            start = time.process_time()
            draw()
            turn[number] = time.process_time() - start
    return durations[2:].min(axis=0).tolist()  # the second frame arranges the rows


def bench_stereo() -> None:
    scene, (left, right) = Scene([harmonics()]), pair_of_eyes(CAMERA, 0.063)
    both, single = Renderer(rasteriser="tiles"), Renderer(rasteriser="tiles")
    one, apart, stereo = cpu(
        lambda: single.render(scene, left),
        lambda: [single.render(scene, eye) for eye in (left, right)],
        lambda: both.render(scene, left, right=right),
    )
    expected = beside(*(single.render(scene, eye) for eye in (left, right)))
    frame = both.render(scene, left, right=right)
    ratios = [
        psnr(a.rgba, b.rgba) for a, b in zip(eye_frames(frame), eye_frames(expected), strict=True)
    ]
    sys.stdout.write(
        f"\n  {COUNT:,} Gaussians of degree 3, 640×360: one eye {one:.3f} CPU-s, eyes one by one "
        f"{apart / one:.2f} times, stereo {stereo / one:.2f} times (at most {SHARE})"
        f"\n  left {ratios[0]:.1f} dB, right {ratios[1]:.1f} dB (at least {DECIBELS})\n"
    )
    assert stereo <= SHARE * one
    assert min(ratios) >= DECIBELS
