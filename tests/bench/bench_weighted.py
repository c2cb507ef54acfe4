"""What weighted sums cost beside sorting the same Gaussians: CPU seconds, pairs and bytes.

CPU seconds are those of the whole process, the driver's threads included; the least of several
frames is printed.
"""

import time

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.measures import print_figure

CELLS, PER_CELL, FRAMES = 50_000, 5, 5
PAIR_BYTES = 16  # two columns of a key and a value
SORTED = ("keys of Gaussians", "values of Gaussians", "lows", "histogram")
CELLED = ("keys of cells", "values of cells", "lows", "keys of weighted", "circles", "spans")


@pytest.fixture(scope="module")
def device() -> Device:
    return Device.open()


@pytest.fixture(scope="module")
def data() -> SplatData:
    """Cells in a deep box before the camera, five Gaussians in each, as a trained scene has them."""
    rng = np.random.default_rng(0)
    z = rng.uniform(2, 12, CELLS)
    middle = np.stack([rng.uniform(-0.7, 0.7, CELLS) * z, rng.uniform(-0.5, 0.5, CELLS) * z, z], 1)
    extent = 0.03 * np.exp(0.4 * rng.normal(size=(CELLS, 3)))
    ellipsoid = covariance_upper(extent, rng.normal(size=(CELLS, 4)))
    cells = np.concatenate([middle, rng.uniform(0.3, 1, (CELLS, 1)), ellipsoid], 1)
    n = CELLS * PER_CELL
    size = np.repeat(extent, PER_CELL, axis=0)
    center = np.repeat(middle, PER_CELL, axis=0) + size * rng.uniform(-1, 1, (n, 3))
    shape = covariance_upper(0.5 * size, rng.normal(size=(n, 4)))
    rows = np.concatenate([center, rng.uniform(0.1, 0.9, (n, 1)), shape], 1)
    return SplatData(
        rows.astype(np.float32),
        rng.uniform(size=(n, 3)).astype(np.float32),
        "rgb",
        cells=cells.astype(np.float32),
        per_cell=PER_CELL,
    )


@pytest.mark.parametrize("size", [(640, 360), (1280, 720)])
def bench_sums_beside_sorting(device: Device, data: SplatData, size: tuple[int, int]) -> None:
    width, height = size
    view_camera = Camera(
        np.eye(4),
        fx=width * 0.7,
        fy=width * 0.7,
        cx=width / 2,
        cy=height / 2,
        width=width,
        height=height,
    )
    weighted = WeightedSum(background=0.15, depth_range=20.0)
    print_figure(f"{len(data):,} Gaussians in {CELLS:,} cells at {width}×{height}")
    durations = {}
    for name, splat_set, columns in (
        ("sorted", SplatSet(data), SORTED),
        ("summed", SplatSet(data, weighted=weighted), CELLED),
    ):
        renderer, scene = Renderer(device, rasteriser="tiles"), Scene([splat_set])
        frame = renderer.render(scene, view_camera)
        seconds = []
        for _ in range(FRAMES):
            start_time = time.process_time()
            renderer.render(scene, view_camera)
            seconds.append(time.process_time() - start_time)
        durations[name] = min(seconds)
        sizes = renderer._plan.buffers.items()
        own = sum(size.size for label, size in sizes if label.startswith(columns))
        own += PAIR_BYTES * frame.pairs
        print_figure(
            f"{name:7} {min(seconds):6.3f} CPU-s  {frame.pairs:9,} pairs  "
            f"{own / len(data):5.1f} bytes a Gaussian to bring them into order"
        )
    print_figure(f"summing takes {durations['summed'] / durations['sorted']:.2f} of sorting")
