"""What a frame that exceeds a binding costs: CPU seconds, and the peak of the process's memory.

    .venv/bin/python tests/bench/devices/large_frames.py                     # 40 million Gaussians
    .venv/bin/python tests/bench/devices/large_frames.py --gaussians 1000000 --panorama 16384
    .venv/bin/python tests/bench/devices/large_frames.py --gaussians 24000000 --per-cell 5

Gaussians of degree 0 fill a box around or before the camera. The first frame also uploads them; the
second one also brings them into spatial order, and is drawn with ``--frames 2``.
"""

import argparse
import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from gsgen.contract.spec.manifest import WeightedSum
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.measures import print_line
from support.rendering import splat_scenes

SIGMA = 0.004  # of forty million Gaussians; fewer are larger


def peak() -> float:
    """Return the greatest memory of this process so far, in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def box(n: int, *, is_around: bool) -> SplatData:
    rng = np.random.default_rng(0)
    rows = np.zeros((n, 10), np.float32)
    depths = (-10, 10) if is_around else (2, 22)
    for column, (low, high) in enumerate(((-10, 10), (-6, 6), depths)):
        rows[:, column] = rng.uniform(low, high, n)
    rows[:, 3] = rng.uniform(0.1, 0.9, n)
    rows[:, [4, 7, 9]] = (SIGMA * np.cbrt(40e6 / n)) ** 2
    return SplatData(rows, rng.random((n, 3), np.float32), "rgb")


def in_cells(n: int, per_cell: int, *, is_around: bool) -> SplatSet:
    """Return a box of cells, each with Gaussians around its centre, for weighted sums."""
    centers = box(n // per_cell, is_around=is_around)
    cells, rng = centers.rows, np.random.default_rng(1)
    sigma = SIGMA * np.cbrt(40e6 / n)
    cells[:, [4, 7, 9]] = (2 * sigma) ** 2
    rows = np.repeat(cells, per_cell, axis=0)
    rows[:, :3] += sigma * rng.standard_normal((len(rows), 3), np.float32)
    rows[:, 3] = rng.uniform(0.1, 0.9, len(rows))
    rows[:, [4, 7, 9]] = sigma**2
    colors = rng.random((len(rows), 3), np.float32)
    data = SplatData(rows, colors, "rgb", cells=cells, per_cell=per_cell)
    return SplatSet(data, weighted=WeightedSum(background=0.15))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=40_000_000)
    parser.add_argument("--size", default="1280x720", help="WIDTHxHEIGHT")
    parser.add_argument("--panorama", type=int, metavar="WIDTH", help="In place of --size.")
    parser.add_argument("--per-cell", type=int, metavar="N", help="Draw weighted sums of cells.")
    parser.add_argument("--frames", type=int, default=1)
    words = parser.parse_args()
    if words.panorama:
        camera = Camera.panorama((0, 0, 0), width=words.panorama)
    else:
        width, height = map(int, words.size.split("x"))
        camera = splat_scenes.camera(width, height, fx=0.8 * width, fy=0.8 * width)
    renderer = Renderer(rasteriser="tiles")
    is_around = bool(words.panorama)
    if words.per_cell:
        scene = Scene([in_cells(words.gaussians, words.per_cell, is_around=is_around)])
    else:
        scene = Scene([box(words.gaussians, is_around=is_around)])
    print_line(
        f"{renderer.device.name}: {words.gaussians:,} Gaussians, {camera.width}×{camera.height}"
    )
    print_line(f"  {peak():.2f} GiB before the first frame")
    for _ in range(words.frames):
        start_time, cpu_began = time.perf_counter(), time.process_time()
        frame = renderer.render(scene, camera)
        seconds, cpu = time.perf_counter() - start_time, time.process_time() - cpu_began
        assert frame.rgba is not None
        covered = frame.alpha.mean(dtype=np.float64)
        print_line(
            f"  {cpu:.1f} CPU-s, {seconds:.1f} s, peak {peak():.2f} GiB; {frame.visible:,} splats, "
            f"{frame.pairs:,} pairs, {100 * covered:.1f} % covered"
        )


if __name__ == "__main__":
    main()
