"""Weighted sets that exceed a binding are drawn in slabs of depth, bit by bit the same."""

import numpy as np
import pytest

from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSplatSet, SplatPool
from support.rendering.mesh_scenes import wall
from support.rendering.small_bindings import ROWS, SMALL, assert_same_images
from support.rendering.splat_scenes import camera, cloud, turned
from support.rendering.weighted_scenes import celled, summed

pytestmark = pytest.mark.slow


OUTPUTS = ("color", "depth", "normal")
BACKGROUND = (0.1, 0.4, 0.7, 0.5)
MAX_CELLS = SMALL // 16
SMALL_CAMERA = camera(width=32, height=32)


def compare(
    renderers: tuple[Renderer, Renderer],
    scene: Scene,
    view: Camera = SMALL_CAMERA,
    outputs: tuple[str, ...] = OUTPUTS,
) -> Frame:
    """Draw a scene at once and in slabs, of which both are equal; return the frame in slabs."""
    whole, small = renderers
    expected = whole.render(scene, view, outputs=outputs, background=BACKGROUND)
    drawn = small.render(scene, view, outputs=outputs, background=BACKGROUND)
    assert whole._plan.weighted_slabs is None
    assert small._plan.weighted_slabs is not None
    assert_same_images(drawn, expected)
    return drawn


def crowd() -> Scene:
    """Ten thousand Gaussians in cells of different sizes; a set of them is placed twice."""
    first, second = celled(1200, 5, 1, size=0.05), celled(700, 3, 2, size=0.06, degree=1)
    moved = summed(second, transform=turned(0.3, (0, 0, 1)), background=0.5, divisor=1.5)
    return Scene([summed(first), summed(second), moved])


def test_ten_thousand_gaussians_are_those_of_the_oracle(
    renderers: tuple[Renderer, Renderer],
) -> None:
    scene = crowd()
    drawn = compare(renderers, scene)
    whole = renderers[0].render(scene, SMALL_CAMERA, background=BACKGROUND)
    assert drawn.visible == whole.visible > MAX_CELLS
    assert drawn.pairs == whole.pairs
    expected = oracle.render(scene, SMALL_CAMERA, background=BACKGROUND)
    firm = ~expected.fragile
    assert firm.mean() > 0.9
    assert np.abs(drawn.rgba - expected.rgba)[firm].max() <= 2e-5
    np.testing.assert_array_equal(
        drawn.ids[~expected.fragile_median], expected.ids[~expected.fragile_median]
    )


def test_weighted_slabs_in_bands_are_unchanged(renderers: tuple[Renderer, Renderer]) -> None:
    view = camera(width=32, height=75)
    compare(renderers, crowd(), view)
    assert renderers[1]._plan.image.size == (32, 75 % 32)  # of the last band


@pytest.mark.parametrize(("cells", "per_cell"), [(MAX_CELLS // 4, 4), (MAX_CELLS // 4 + 1, 4)])
def test_binding_capacity_plus_one_cell_is_drawn(
    renderers: tuple[Renderer, Renderer], cells: int, per_cell: int
) -> None:
    scene = Scene([summed(celled(cells, per_cell, 3, size=0.05))])
    whole, small = renderers
    expected, drawn = (
        entry.render(scene, SMALL_CAMERA, outputs=OUTPUTS) for entry in (whole, small)
    )
    assert_same_images(drawn, expected)
    assert (small._plan.weighted_slabs is None) == (cells * per_cell <= MAX_CELLS)


def test_cells_that_exceed_a_binding_are_drawn(renderers: tuple[Renderer, Renderer]) -> None:
    """They are in the buffers of pages, and change in each of them."""
    data, later_cells = celled(1000, 1, 4, size=0.1), celled(1000, 1, 5, size=0.1)
    scene = Scene([summed(data)])
    first = compare(renderers, scene)
    pages = renderers[1]._residency.pages(data)
    assert [page.first_cell for page in pages] == [0, ROWS]
    data.update(later_cells.rows, later_cells.appearance, cells=later_cells.cells)
    assert not np.array_equal(compare(renderers, scene).rgba, first.rgba)


def test_cells_in_two_pages_are_drawn(renderers: tuple[Renderer, Renderer]) -> None:
    """Neither pages nor slabs end where cells do, and half-floats are widened."""
    data = celled(900, 3, 6, size=0.1, degree=1, dtype=np.float16)
    compare(renderers, Scene([summed(data)]))
    pages = renderers[1]._residency.pages(data)
    assert pages[1].first_cell == ROWS // 3
    assert ROWS % 3


@pytest.mark.parametrize("live", [0, 1, 703, 1024, 3000])
def test_pages_without_live_cells_are_drawn(
    renderers: tuple[Renderer, Renderer], live: int
) -> None:
    whole = celled(800, 5, 7, size=0.1)
    data = SplatData(whole.rows, whole.appearance, "rgb", count=live, cells=whole.cells, per_cell=5)
    drawn = compare(renderers, Scene([summed(data)]))
    assert (drawn.visible > 0) == (live > 1)


def test_cells_behind_the_camera_draw_the_background(renderers: tuple[Renderer, Renderer]) -> None:
    drawn = compare(renderers, Scene([summed(celled(800, 5, 8, depth=(-8, -2)))]))
    assert drawn.visible == 0
    assert np.array_equal(drawn.rgba[0, 0], np.float32([0.05, 0.2, 0.35, 0.5]))


def test_cell_larger_than_a_slab_is_drawn(renderers: tuple[Renderer, Renderer]) -> None:
    """Its Gaussians are all weighted by the light before it, from whatever slab they are."""
    far_frame = celled(3, MAX_CELLS + 700, 9, size=0.9, share=0.05, opacity=(0.02, 0.06))
    scene = Scene([summed(celled(40, 5, 10)), summed(far_frame), summed(celled(200, 3, 11))])
    drawn = compare(renderers, scene)
    whole = renderers[0].render(scene, SMALL_CAMERA)
    assert drawn.visible == whole.visible > ROWS
    assert drawn.pairs == whole.pairs
    alone = compare(renderers, Scene([summed(celled(1, 5 * MAX_CELLS, 12, size=0.9, share=0.03))]))
    assert alone.visible > ROWS


@pytest.mark.parametrize("tilt", [0, 1e-9])
def test_more_cells_of_one_depth_than_a_slab_holds_are_divided(
    renderers: tuple[Renderer, Renderer], tilt: float
) -> None:
    """They are divided by the remainders of their depths, and by their numbers."""
    data = celled(900, 4, 13, size=0.03)
    data.cells[:, 2] = 3
    data.cells[:, :2] *= 0.1
    data.rows[:, :2] *= 0.1
    near = summed(celled(60, 3, 14, depth=(2, 3)))
    compare(renderers, Scene([near, summed(data, transform=turned(tilt, (0, 1, 0)))]))


def test_other_projections_in_slabs_are_unchanged(renderers: tuple[Renderer, Renderer]) -> None:
    flat, around = camera(width=32, height=25).flattened(6.0), Camera.panorama((0, 0, 0), width=32)
    scene = Scene([summed(celled(900, 5, 15, depth=(-4, 4), size=0.1))])
    for view in (flat, around):
        assert compare(renderers, scene, view, ("color",)).visible > 0


@pytest.mark.parametrize("sorted_splats", [50, 5000])
def test_sorted_sets_mix_with_weighted_slabs(
    renderers: tuple[Renderer, Renderer], sorted_splats: int
) -> None:
    """They are sorted at once, or in slabs of their own."""
    scene = Scene([summed(celled(700, 5, 16, size=0.1)), cloud(sorted_splats, 17, size=0.03)])
    drawn = compare(renderers, scene, camera(width=16, height=20), ("color",))
    plan = renderers[1]._plan
    assert (plan.slabs is not None) == (sorted_splats > MAX_CELLS)
    whole = renderers[0].render(scene, camera(width=16, height=20))
    assert drawn.visible == whole.visible
    assert drawn.pairs == whole.pairs


def test_meshes_occlude_weighted_slabs(renderers: tuple[Renderer, Renderer]) -> None:
    scene = Scene([summed(celled(700, 5, 18, size=0.1))], meshes=[wall(5)])
    view = camera(width=16, height=20)
    outputs = ("color",) if renderers[0].device.software else OUTPUTS
    drawn = compare(renderers, scene, view, outputs)
    bare = renderers[1].render(Scene(scene.sets), view)
    assert not np.array_equal(drawn.rgba, bare.rgba)


def test_pool_mixes_with_weighted_slabs(renderers: tuple[Renderer, Renderer]) -> None:
    tile, sums = cloud(300, 19, degree=1), summed(celled(700, 5, 20, size=0.1))
    frames = []
    for renderer in renderers:
        pool = SplatPool(512, 12, slot_rows=128)
        pool.insert(0, tile.rows, tile.appearance, np.zeros(3))
        pool.draw({0: 0.9})
        scene = Scene([sums], pools=[PooledSplatSet(pool, turned(0.4, (1, 2, 3), 1.3))])
        frames.append(renderer.render(scene, camera(width=16, height=20)))
    assert np.array_equal(frames[0].rgba, frames[1].rgba)
    assert frames[0].visible == frames[1].visible


def test_pairs_that_exceed_a_binding_halve_the_slabs(renderers: tuple[Renderer, Renderer]) -> None:
    """Narrower bands come first; an image that stays on the GPU is drawn in thinner slabs alone."""
    whole, small = renderers
    view = camera(width=32, height=32)
    scene = Scene([summed(celled(1900, 1, 21, size=1.5, opacity=(0.01, 0.02)))])
    small._pairs, most = 512, type(small)._max_pairs
    expected = whole.render(scene, view)
    assert expected.pairs > 4096
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(small), "_max_pairs", property(lambda self: 1024))
        drawn = small.draw(scene, view)
        actual = small.device.read(drawn.image, np.float32, expected.rgba.size).reshape(32, 32, 4)
        assert np.array_equal(actual, expected.rgba)
        assert np.array_equal(small.render(scene, view).rgba, expected.rgba)
    assert type(small)._max_pairs is most
    assert drawn.pairs == expected.pairs
    assert small._plan.weighted_slabs.capacity < 1024


def test_frames_in_flight_are_waited_for(renderers: tuple[Renderer, Renderer]) -> None:
    scene = crowd()
    whole, small = renderers
    expected = whole.render(scene, SMALL_CAMERA)
    for _ in range(3):
        drawn = small.draw(scene, SMALL_CAMERA, wait=False)
        actual = small.device.read(drawn.image, np.float32, expected.rgba.size).reshape(32, 32, 4)
        assert np.array_equal(actual, expected.rgba)
        assert drawn.visible == expected.visible
    assert not small.settle()


def test_the_keys_of_gaussians_are_those_of_their_cells(
    renderers: tuple[Renderer, Renderer],
) -> None:
    data = celled(700, 5, 22, size=0.1)
    compare(renderers, Scene([summed(data)]))
    small = renderers[1]
    keys = np.concatenate(
        [small.device.read(part, np.uint32, part.size // 4) for part in slab_keys(small)]
    )[: len(data)].reshape(700, 5)
    assert (keys == keys[:, :1]).all()
    drawn = keys[:, 0] != NO_ID
    assert 0.1 < drawn.mean() < 1
    np.testing.assert_array_equal(keys[drawn, 0].view(np.float32), data.cells[drawn, 2])


def slab_keys(renderer: Renderer) -> list:
    return renderer._plan.weighted_slabs.keys
