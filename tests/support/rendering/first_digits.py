"""Counts of first digits that kernels make, beside those of their NumPy twin."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.kernels.sort.sort import KEY_BITS
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.plan_options import ImageSpec, RasterMethod
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_pool import SplatPool
from references.sorting import first_digits_reference
from support.rendering.splat_scenes import SCENES, camera, cloud

Case = tuple[Scene, Camera, int]
"""A scene, a camera, and the capacity for pairs."""


def like_gpu(device: Device) -> Device:
    """Return the device as one that no CPU computes for."""
    other = Device(device.raw)
    other.subgroups = other.software = False
    return other


def _scene_case(name: str) -> Callable[[], Case]:
    return lambda: (*SCENES[name](), 1 << 16)


def _over_many_blocks() -> Case:
    """Splats over hundreds of tiles each, so that a workgroup's pairs are in many blocks."""
    wide_camera = replace(camera(), width=1000, height=700)
    return Scene([cloud(100, 6, size=30.0, opacity=(0.05, 0.3))]), wide_camera, 1 << 18


def _beyond_the_capacity() -> Case:
    scene, view, _ = _over_many_blocks()
    return scene, view, 5001


def _at_one_depth_and_place() -> Case:
    """All keys have one digit."""
    data = cloud(9000, 3)
    data.rows[:, :3] = 0, 0, 4
    return Scene([data]), camera(), 1 << 16


def _in_one_tile() -> Case:
    return Scene([cloud(3000, 4)]), camera(width=8, height=8), 1 << 16


def _in_slots() -> Case:
    """Two pools, of pages that are shorter than a block, among sets; some slots are not seen."""
    pools = []
    for seed in (1, 2):
        pool = SplatPool(40 * 128, 3, slot_rows=128)
        for tile in range(30):
            data = cloud(100 + tile, 50 * seed + tile, depth=(-6, 6), degree=0)
            pool.insert(tile, data.rows, data.appearance, np.zeros(3))
        pool.draw({tile: 1.0 for tile in range(30) if tile % 4})
        pools.append(pool)
    return Scene([cloud(700, 9), cloud(1500, 10)], pools=pools), camera(), 1 << 16


CASES: dict[str, Callable[[], Case]] = {
    **{name: _scene_case(name) for name in (
        "nothing", "one", "many", "crowd", "huge", "needles", "same_depths", "not_finite", "placed",
        "fewer_live_than_rows", "none_live_of_some", "panorama_seam", "panorama_huge",
    )},
    "over many blocks": _over_many_blocks,
    "beyond the capacity": _beyond_the_capacity,
    "at one depth and place": _at_one_depth_and_place,
    "in one tile": _in_one_tile,
    "in slots": _in_slots,
}  # fmt: skip


def counters(device: Device, buffer: Buffer, expected: np.ndarray) -> np.ndarray:
    """Return the columns of a histogram that its twin has; the others are asserted to be zero."""
    words = device.read(buffer, np.uint32, buffer.size // 4)
    columns = len(words) // len(expected)
    table = words[: len(expected) * columns].reshape(len(expected), columns)
    assert not table[:, expected.shape[1] :].any()
    return table[:, : expected.shape[1]]


def counted(renderer: Renderer, case: Case) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return what kernels counted, and what their twin counts: digits of depths, and of tiles."""
    scene, view, capacity = case
    device, kernels = renderer.device, renderer._kernels
    placed, size = renderer.placed(scene), (view.width, view.height)
    image = ImageSpec(size=size, projection="panorama" if view.period else "plane")
    plan = Plan(kernels, placed, image, RasterMethod(pair_capacity=capacity))
    depths, tiles = [
        buffer for buffer, *_ in plan.buffer_clears if getattr(buffer, "label", "") == "histogram a"
    ]

    def submit_stages(*stages: str) -> None:
        plan.submit(placed, view, np.zeros(3), only=stages)
        plan.collect()

    result = {}
    submit_stages("project")
    keys = device.read(plan.buffers["keys of Gaussians a"], np.uint32, max(1, len(scene)))
    expected = first_digits_reference(keys[: len(scene)], kernels.sort.first_digits(KEY_BITS))
    result["depths"] = counters(device, depths, expected), expected
    submit_stages("project", "sort", "bin")  # no sort of the pairs, which would change the counters
    pairs = int(device.read(plan.buffers["counts"], np.uint32, 4)[Counts.PAIRS])
    last = plan.buffers["ranges"].size // 8 - 1
    digits = kernels.sort.first_digits(kernels.tile_bits(max(last, 0)))
    listed = device.read(plan.buffers["keys of pairs a"], np.uint32, max(1, pairs))[:pairs]
    assert not (listed == NO_ID).any()
    expected = first_digits_reference(listed, digits)
    result["tiles"] = counters(device, tiles, expected), expected
    return result


def miscounted(device: Device) -> list[str]:
    """Return the cases in which a kernel, as on a GPU, counts other digits than its twin."""
    renderer = Renderer(like_gpu(device), rasteriser="tiles")
    return [
        f"{kind} of {name}"
        for name, case in CASES.items()
        for kind, (result, expected) in counted(renderer, case()).items()
        if not np.array_equal(result, expected)
    ]
