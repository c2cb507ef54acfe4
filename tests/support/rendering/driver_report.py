"""What a renderer gets right on the driver of this process, as JSON; see ``drivers.py``."""

import json
import sys
import time
from itertools import product
from pathlib import Path

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import sort_config_for
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from references.sorting import scan_reference, sort_reference
from support.checkpoints.golden_case import golden_case
from support.rendering.first_digits import miscounted
from support.rendering.mesh_scenes import MESH_SCENES
from support.rendering.near_ties import NEAR_TIES
from support.rendering.sorting import GPU, KEYS, Bench, keys_of, scanned


def renderers_by_way(device: Device) -> dict[str, Renderer]:
    """Return each way to draw."""
    gpu_like_device = Device(device.raw)
    gpu_like_device.software, gpu_like_device.subgroups = False, False
    return {
        "tiles": Renderer(device, rasteriser="tiles"),
        "tiles, cut as for a GPU": Renderer(gpu_like_device, rasteriser="tiles"),
        "quads": Renderer(device, rasteriser="quads"),
    }


def pictures(renderers_by_name: dict[str, Renderer], golden: Path) -> dict[str, float]:
    """Return the largest error of the golden picture, by each way to draw it."""
    data, camera, image = golden_case(golden)
    errors = {}
    for name, renderer in renderers_by_name.items():
        actual = renderer.render(Scene([data]), camera).rgba
        assert actual is not None
        errors[name] = float(np.abs(actual - image).max())
    return errors


def disordered(renderers_by_name: dict[str, Renderer]) -> list[str]:
    """Draw near ties by tiles; return in which the oracle finds another order."""
    wrong = []
    for name in ("tilted", "plane_of_rounded_rows"):
        scene, camera = NEAR_TIES[name]()
        frame = oracle.render(scene, camera)
        for renderer_name in [
            renderer_name for renderer_name in renderers_by_name if "tiles" in renderer_name
        ]:
            error = np.abs(renderers_by_name[renderer_name].render(scene, camera).rgba - frame.rgba)
            if not error[~frame.fragile].max() <= 2e-5:
                wrong.append(f"{name} by {renderer_name}")
    return wrong


def unmet(renderer: Renderer) -> list[str]:
    """Draw scenes with meshes; return those in which a pixel is not the oracle's."""
    wrong = []
    for name in ("several", "near_plane", "panorama_poles"):
        scene, camera = MESH_SCENES[name]()
        actual, expected = renderer.render(scene, camera).rgba, oracle.render(scene, camera)
        assert actual is not None
        if not np.abs(actual - expected.rgba)[~expected.fragile].max() <= 1e-4:
            wrong.append(name)
    return wrong


def unsorted(device: Device, sizes: list[int]) -> list[str]:
    """Sort all keys of all sizes, in three ways; return where NumPy finds another order."""
    wrong = []
    for n, (cut, counted) in product(
        sizes, ((sort_config_for(device), False), (GPU, False), (GPU, True))
    ):
        sort = Bench(device, cut, 32, max(n, 1), compact=True, counted=counted)
        for kind in KEYS:
            keys = keys_of(n, kind) if n else np.full(1, 0xFFFFFFFF, np.uint32)
            durations = [time.process_time(), time.perf_counter()]
            keys_out, places = sort(keys)
            durations = [time.process_time() - durations[0], time.perf_counter() - durations[1]]
            expected = sort_reference(keys, 32)
            if not (np.array_equal(places, expected) and np.array_equal(keys_out, keys[expected])):
                wrong.append(f"{n} keys, {kind}, blocks of {cut.block}" + ", counted" * counted)
            sys.stderr.write(
                f"  {n:>9,} keys, {kind:9}, blocks of {cut.block:>5,}: "
                f"{durations[0]:6.2f} CPU-s, {durations[1]:6.2f} s\n"
            )
    return wrong


def unscanned(device: Device) -> list[str]:
    """Scan 300,001 numbers in one workgroup and by blocks; return where NumPy has other sums."""
    wrong = []
    numbers = np.random.default_rng(0).integers(0, 1 << 16, 300_001, np.uint32)
    for software in (True, False):
        gpu_like_device = Device(device.raw)
        gpu_like_device.software = software
        result = scanned(Scan(gpu_like_device, 4096, 64, 256), device, numbers)
        if not np.array_equal(result, scan_reference(numbers)):
            wrong.append("in one workgroup" if software else "by blocks")
    return wrong


def main() -> None:
    """Print what there is to know; the golden's path and sizes of sorts are in the command line."""
    device = Device.open()
    sys.stderr.write(f"{device.name}\n")
    golden, *sizes = sys.argv[1:]
    report: dict[str, object] = {"driver": device.name, "software": device.software}
    if golden != "-":
        report["pictures"] = pictures(drawn := renderers_by_way(device), Path(golden))
        report["disordered"] = disordered(drawn)
        report["unmet"] = unmet(drawn["tiles"])
        report["miscounted"] = miscounted(device)
    report["unscanned"] = unscanned(device)
    report["unsorted"] = unsorted(device, [int(size) for size in sizes])
    sys.stdout.write(json.dumps(report) + "\n")


if __name__ == "__main__":
    main()
