"""The written plans draw splat pools: executed from JSON, they give the renderer's own pictures."""

import json
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.project.project import frame_uniform, page_uniforms
from gsgen.runtime.kernels.project.slots import slot_table
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.renderer.placed_pages import PlacedPage
from gsgen.runtime.renderer.renderer import FIRST_PAIR_CAPACITY, Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import SLOT_ROWS, PooledSplatSet, SplatPool
from gsgen.runtime.web.pages import client_file
from runtime.web.plan_executor import PlanExecutor, choose
from support.rendering.splat_scenes import camera, cloud, turned

BACKGROUND = np.array([0.1, 0.2, 0.3])
TURNED = turned(0.3, (1, 2, 3), 1.2)


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return dict(json.loads(client_file("plans.json")))


@pytest.fixture(scope="module")
def card(device: Device) -> Renderer:
    """A renderer whose kernels are those of GPUs, as the plans are, with two slots a page."""
    other = Device(device.raw)
    other.subgroups = other.software = other.maps_buffers = False
    return Renderer(other, rasteriser="tiles", page_rows=2 * SLOT_ROWS)


def write_uniforms(executor: PlanExecutor, placed: list[PlacedPage], view: Camera) -> None:
    """Write what hosts compute in float64: the frame, its pages, and the slots of pools."""
    write = executor.device.write
    write(executor.input("frame"), frame_uniform(view, BACKGROUND))
    write(executor.input("bare frame"), frame_uniform(view, np.zeros(3)))
    pages, base = [], 0
    for splat_set, page in placed:
        live = splat_set.data.count
        if page.slots is not None:
            live, slots = page.capacity, page.slots
            table = slot_table(slots.pool, slots.first, slots.count, splat_set.transform, view)
            write(slots.table, table)
        pages.append((splat_set, base, page.capacity, live))
        base += page.capacity
    write(executor.input("pages"), page_uniforms(pages, view))


def tile(seed: int, rows: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    data = cloud(rows, seed=seed, degree=degree)
    return data.rows.astype(np.float32), data.appearance.astype(np.float32)


@pytest.mark.parametrize(
    ("kind", "degree", "outputs"), [("pinhole", 0, ["color", "depth"]), ("panorama", 2, ["normal"])]
)
def test_a_written_plan_draws_pools_bit_by_bit(
    card: Renderer, document: dict[str, Any], kind: str, degree: int, outputs: list[Any]
) -> None:
    """Among other sets, with fades, and after arrivals and evictions, without a new GPU object."""
    view = camera() if kind == "pinhole" else Camera.panorama((0, 0, 1), width=96)
    pool = SplatPool(5 * SLOT_ROWS, 3 * (degree + 1) ** 2)
    for key, rows in enumerate((SLOT_ROWS + 700, 300, 5)):
        pool.insert(key, *tile(key, rows, degree), np.array([0.01 * key, 0, 0]))
    pool.draw({0: 1.0, 1: 0.4})
    front_set = SplatSet(SplatData(*tile(9, 200, 1), "sh"), TURNED)
    scene = Scene([front_set], pools=[PooledSplatSet(pool, TURNED, opacity_scale=0.8)])
    placed = card.placed(scene)
    pages = [page for _, page in placed]
    assert len(pages) == 4  # the set, and three pages of the pool
    sizes = {"width": view.width, "height": view.height, "pairs": FIRST_PAIR_CAPACITY}
    shape = {"panorama": kind == "panorama", "deep": False, "layers": 0, "weighted": False}
    chosen = choose(document, sizes, outputs=outputs, **shape)
    executor = PlanExecutor(card.device, document, chosen, sizes, pages)
    pictures = []
    for change in ("none", "arrival", "eviction"):
        if change == "arrival":
            pool.insert(7, *tile(7, 900, degree), np.zeros(3))
            pool.draw({0: 0.7, 2: 1.0, 7: 0.9})
        if change == "eviction":
            pool.evict(0)
            pool.draw({1: 1.0, 7: 0.2})
        placed = card.placed(scene)
        assert [page for _, page in placed] == pages
        write_uniforms(executor, placed, view)
        images = executor.run()
        plan = card.plan(placed, view, frozenset(outputs))
        plan.submit(placed, view, BACKGROUND)
        counts, expected = plan.collect()
        assert counts[Counts.VISIBLE] > 0
        for name in outputs:
            np.testing.assert_array_equal(images[name], expected[name].ravel(), err_msg=change)
        pictures.append(images[outputs[0]].tobytes())
    assert len(set(pictures)) == 3
