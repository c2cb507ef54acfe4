"""What meshes cost: frames with one, beside the same frame without, in CPU seconds.

CPU seconds are those of the whole process, the driver's threads included; the least of several
frames is printed.
"""

import sys
import time

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh, MeshData
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData

COUNT = 300_000
CAMERA = Camera(np.eye(4), fx=600.0, fy=600.0, cx=480.0, cy=270.0, width=960, height=540)
PANORAMA_CAMERA = Camera.panorama((0, 0, 0), width=1024)


def cpu(renderer: Renderer, scene: Scene, times: int = 5, camera: Camera = CAMERA) -> float:
    durations = []
    for _ in range(times + 1):
        start_time = time.process_time()
        renderer.render(scene, camera)
        durations.append(time.process_time() - start_time)
    return min(durations[1:])


@pytest.fixture(scope="module")
def splats() -> SplatData:
    rng = np.random.default_rng(0)
    z = rng.uniform(2, 8, COUNT)
    centers = np.stack(
        [rng.uniform(-0.8, 0.8, COUNT) * z, rng.uniform(-0.45, 0.45, COUNT) * z, z], 1
    )
    sigma = covariance_upper(
        0.012 * np.exp(0.4 * rng.normal(size=(COUNT, 3))), rng.normal(size=(COUNT, 4))
    )
    rows = np.concatenate([centers, rng.uniform(0.05, 0.6, (COUNT, 1)), sigma], 1)
    return SplatData(
        rows.astype(np.float32), rng.uniform(size=(COUNT, 3)).astype(np.float32), "rgb"
    )


def ball(rings: int) -> MeshData:
    """A sphere of 2 · rings² triangles."""
    up = np.linspace(0, np.pi, rings + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, rings, endpoint=False)
    points = np.stack(
        np.broadcast_arrays(np.sin(up) * np.cos(around), np.cos(up), np.sin(up) * np.sin(around)),
        -1,
    ).reshape(-1, 3)
    ring, spoke_index = np.divmod(np.arange(rings * rings), rings)
    a, b = ring * rings + spoke_index, ring * rings + (spoke_index + 1) % rings
    faces = [np.stack([a, b, b + rings], 1), np.stack([a, b + rings, a + rings], 1)]
    return MeshData(points, np.concatenate(faces), np.abs(points))


def placed(data: MeshData, depth: float, scale: float) -> Mesh:
    result = np.diag([scale, scale, scale, 1.0])
    result[2, 3] = depth
    return Mesh(data, result, "headlight")


def bench_meshes(splats: SplatData) -> None:
    renderer = Renderer(rasteriser="tiles")
    fine, coarse = ball(230), ball(30)
    cases = {
        "one that is out of view": placed(coarse, -9, 1),
        "1,800 triangles behind everything": placed(coarse, 12, 3.5),
        "1,800 triangles, half a picture, in the middle": placed(coarse, 5, 1.9),
        "105,800 triangles there": placed(fine, 5, 1.9),
    }
    bare = cpu(renderer, Scene([splats]))
    sys.stdout.write(f"\n  {COUNT:,} Gaussians, 960×540, no mesh: {bare:.3f} s")
    for name, mesh in cases.items():
        seconds_taken = cpu(renderer, Scene([splats], meshes=[mesh]))
        sys.stdout.write(f"\n  {name}: {seconds_taken:.3f} s, {seconds_taken / bare:.2f} times")
    alone = cpu(renderer, Scene([], meshes=[cases["105,800 triangles there"]]))
    sys.stdout.write(f"\n  105,800 triangles alone: {alone:.3f} s\n")


def bench_meshes_all_around() -> None:
    """Rooms around the eye, whose triangles at the seam and the poles have wide boxes."""
    renderer = Renderer(rasteriser="tiles")
    sky = Scene([], meshes=[placed(ball(2), -900, 1)])
    cases = {
        "one of 1,800 triangles ahead": placed(ball(30), 5, 1.9),
        "one of 105,800 triangles ahead": placed(ball(230), 5, 1.9),
        "a room of 1,800 triangles": placed(ball(30), 0, 5),
        "a room of 105,800 triangles": placed(ball(230), 0, 5),
    }
    sys.stdout.write(
        f"\n  8 triangles, far away: {cpu(renderer, sky, camera=PANORAMA_CAMERA):.3f} s"
    )
    for name, mesh in cases.items():
        scene = Scene([], meshes=[mesh])
        seconds_taken, ahead = cpu(renderer, scene, camera=PANORAMA_CAMERA), cpu(renderer, scene)
        sys.stdout.write(f"\n  {name}: {seconds_taken:.3f} s, as a pinhole sees it {ahead:.3f} s")
    sys.stdout.write("\n")
