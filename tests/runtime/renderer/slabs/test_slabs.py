"""Scenes and images that exceed a binding are drawn in slabs and bands, bit by bit the same."""

from itertools import pairwise

import numpy as np
import pytest

from gsgen.runtime.gpu import splat_residency
from gsgen.runtime.kernels.project.tally_keys import BIN_COUNT
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.renderer.slabs import CountKeys, KeyRange, slab_ranges
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_pool import PooledSplatSet, SplatPool
from references.projection import place_reference, tally_reference
from support.rendering.small_bindings import SMALL, assert_same_images
from support.rendering.splat_scenes import SCENES, camera, cloud, turned
from support.rendering.weighted_scenes import MIXED

OUTPUTS = ("color", "depth", "normal")


def crowd() -> Scene:
    """Ten thousand Gaussians in three sets, two of them at the same depths."""
    first, second = cloud(4000, 1, size=0.02, degree=1), cloud(2000, 2, size=0.03)
    moved = SplatSet(first, turned(0.3, (0, 0, 1)), opacity_scale=0.7)
    return Scene([first, second, moved])


def test_ten_thousand_splats_in_slabs_and_bands(renderers: tuple[Renderer, Renderer]) -> None:
    scene, view = crowd(), camera(width=61, height=75)
    whole, small = renderers
    expected = whole.render(scene, view, outputs=OUTPUTS, background=(0.1, 0.2, 0.3, 0.5))
    frame = small.render(scene, view, outputs=OUTPUTS, background=(0.1, 0.2, 0.3, 0.5))
    assert_same_images(frame, expected)
    assert expected.visible > 3 * SMALL // 16
    assert frame.visible == expected.visible  # though some are in two bands
    assert "tally" in small._plan.stages


def test_mesh_layers_are_drawn_in_bands(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, view = MIXED["among_everything"]()
    view = view.scaled(view.width, 2 * view.height)
    expected = renderer.render(scene, view).rgba
    two_layers_of_32_rows = 64 * 16 * 2 * 32
    monkeypatch.setattr(renderer.device, "largest_binding", two_layers_of_32_rows)
    monkeypatch.setattr(renderer, "_pairs", two_layers_of_32_rows // 4)
    assert np.array_equal(renderer.render(scene, view).rgba, expected)
    assert renderer._plan.image.size == (view.width, view.height % 32)  # of the last band


def test_panorama_in_bands_and_slabs_is_unchanged(renderers: tuple[Renderer, Renderer]) -> None:
    scene, _ = SCENES["panorama"]()
    view = Camera.panorama((0.1, 0, 0), width=60, height=70)
    whole, small = renderers
    assert np.array_equal(small.render(scene, view).rgba, whole.render(scene, view).rgba)


@pytest.mark.parametrize("name", ["lens_cushion", "fisheye_prism"])
def test_lens_in_bands_and_slabs_is_unchanged(
    renderers: tuple[Renderer, Renderer], name: str
) -> None:
    view = SCENES[name]()[1].resized(60, 70)
    whole, small = renderers
    expected = whole.render(crowd(), view, outputs=OUTPUTS)
    assert_same_images(small.render(crowd(), view, outputs=OUTPUTS), expected)
    assert small._plan.image.size == (60, 70 % 32)  # of the last band


def test_arranged_rows_keep_their_ids(
    renderers: tuple[Renderer, Renderer], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of splats at one depth the earlier row is in front, in whatever order rows are."""
    monkeypatch.setattr(splat_residency, "MIN_ORDERED_ROWS", 64)
    data = cloud(3000, 5)
    data.rows[:, 2] = np.repeat(np.linspace(2, 5, 1000), 3)  # three at each depth
    scene, view = Scene([cloud(20), data]), camera()
    whole, small = renderers
    for _ in range(2):  # arranged when they are drawn again
        expected = whole.render(scene, view, outputs=OUTPUTS)
        assert_same_images(small.render(scene, view, outputs=OUTPUTS), expected)
    assert small._residency.pages(data)[0].rows_of is not None


def test_pairs_that_exceed_a_binding_are_drawn_in_parts(
    renderers: tuple[Renderer, Renderer],
) -> None:
    """In narrower bands, then in thinner slabs; an image that stays on the GPU in slabs alone."""
    scene, view = Scene([cloud(2500, size=0.5, depth=(2, 3))]), camera(width=60, height=60)
    whole, small = renderers
    expected = whole.render(scene, view)
    assert expected.pairs > SMALL // 4
    assert np.array_equal(small.render(scene, view).rgba, expected.rgba)
    view = camera(width=32, height=60)
    drawn, expected = small.draw(scene, view), whole.render(scene, view)
    actual = small.device.read(drawn.image, np.float32, expected.rgba.size).reshape(60, 32, 4)
    assert np.array_equal(actual, expected.rgba)
    assert drawn.pairs == expected.pairs


@pytest.mark.parametrize("tilt", [0, 1e-9])
def test_more_splats_of_one_depth_than_a_slab_holds_are_divided(
    renderers: tuple[Renderer, Renderer], monkeypatch: pytest.MonkeyPatch, tilt: float
) -> None:
    """They are divided by the remainders of their depths, and by their rows."""
    monkeypatch.setattr(splat_residency, "MIN_ORDERED_ROWS", 64)
    data = cloud(SMALL // 16 + 500, 3, size=0.01)
    data.rows[:, 2] = 3
    data.rows[:, :2] *= 0.1
    scene = Scene([cloud(300, 5, size=0.02), SplatSet(data, turned(tilt, (0, 1, 0)))])
    whole, small = renderers
    for _ in range(2):  # arranged when they are drawn again
        expected = whole.render(scene, camera(), outputs=("color", "depth"))
        assert_same_images(small.render(scene, camera(), outputs=("color", "depth")), expected)
    assert expected.visible > SMALL // 16 + 500


def test_meshes_and_weighted_sums_mix_with_slabs(renderers: tuple[Renderer, Renderer]) -> None:
    scene, view = MIXED["among_everything"]()
    view, (whole, small) = view.scaled(32, 37), renderers
    # Software drivers take long to compile kernels of many layers and outputs.
    sets, outputs = list(scene.sets), ("color", "depth")
    if whole.device.software:
        sets, outputs = [], ("color",)
    scene = Scene([*sets, cloud(4000, 1, size=0.02)], meshes=scene.meshes)
    expected = whole.render(scene, view, outputs=outputs)
    actual, again = (small.render(scene, view, outputs=outputs) for _ in range(2))
    assert_same_images(actual, expected)
    assert_same_images(again, expected)
    assert again.visible == actual.visible
    assert expected.visible > SMALL // 16
    assert {"meshes", "tally"} <= set(small._plan.stages)
    assert ("sum" in small._plan.stages) == (not whole.device.software)


def test_pool_in_slabs_is_unchanged(renderers: tuple[Renderer, Renderer]) -> None:
    data, around = cloud(5000, 4, size=0.02, degree=1), SplatSet(cloud(500, 2, size=0.03))
    frames = []
    for renderer in renderers:
        pool = SplatPool(5000 + 128, 12, slot_rows=128)
        pool.insert(0, data.rows, data.appearance, np.zeros(3))
        pool.draw({0: 0.9})
        pooled = PooledSplatSet(pool, turned(0.4, (1, 2, 3), 1.3))
        frames.append(renderer.render(Scene([around], pools=[pooled]), camera(), outputs=OUTPUTS))
    assert_same_images(frames[1], frames[0])
    assert frames[0].visible == frames[1].visible > SMALL // 16
    assert "tally" in renderers[1]._plan.stages


def test_slabs_hold_at_most_their_capacity() -> None:
    rng = np.random.default_rng(0)
    near = rng.uniform(1, 1 + 1e-5, 3000)  # in one bin of the first tally, and of the second
    depths = np.concatenate([near, rng.lognormal(size=4000), np.repeat(7.5, 90)])
    keys = np.append(depths.astype(np.float32).view(np.uint32), np.uint32(NO_ID))

    ranges = slab_ranges(tally_of(keys), 100)
    assert ranges[0].low == 0
    assert ranges[-1].high == 1 << 31
    assert all(before.high == after.low for before, after in pairwise(ranges))
    sizes = [int(((keys >= part.low) & (keys < part.high)).sum()) for part in ranges]
    assert sum(sizes) == len(depths)
    assert max(sizes) <= 100
    assert all(a + b > 100 for a, b in zip(sizes, sizes[2:], strict=False))
    assert slab_ranges(tally_of(keys[:0]), 100) == [KeyRange(0, 1 << 31)]


def test_splats_of_one_depth_are_divided_by_remainder_and_row() -> None:
    rng = np.random.default_rng(0)
    keys = rng.choice(np.array([5, 6, 7, 1 << 30], np.uint32), 900, p=[0.1, 0.7, 0.1, 0.1])
    lows = rng.choice(np.array([0, 1 << 31, NO_ID - 1], np.uint32), 900, p=[0.8, 0.1, 0.1])
    ranges = slab_ranges(tally_of(keys, lows), 50)
    rows = np.arange(len(keys))
    drawn = [rows[is_in(part, keys, lows)] for part in ranges]
    assert all(len(part) <= 50 for part in drawn)
    order = np.concatenate([part[np.lexsort((part, lows[part], keys[part]))] for part in drawn])
    assert np.array_equal(order, np.lexsort((rows, lows, keys)))


def is_in(part: KeyRange, *columns: np.ndarray) -> np.ndarray:
    """Return the mask of splats in a range: of keys, of remainders, or of rows."""
    ranks = (*columns, np.arange(len(columns[0])))
    tied_ranks = [ranks[level] == key for level, key in enumerate(part.tied_keys)]
    rank = ranks[len(part.tied_keys)]
    return np.logical_and.reduce([*tied_ranks, rank >= part.low, rank < part.high])


def tally_of(*columns: np.ndarray) -> CountKeys:
    """Return a tally of keys, of remainders and of rows."""

    def tally(tied_ranks: tuple[int, ...], low: int, shift: int) -> np.ndarray:
        ranks = (*columns, np.arange(len(columns[0]), dtype=np.uint32))
        counted = ranks[len(tied_ranks)][is_in(KeyRange(0, NO_ID, tied_ranks), *columns)]
        return tally_reference(counted, low, min(low + (BIN_COUNT << shift), NO_ID), shift)

    return tally


def test_the_kernels_of_slabs_equal_their_twins(renderers: tuple[Renderer, Renderer]) -> None:
    small = renderers[1]
    scene, view = Scene([cloud(5000, 3, size=0.01)]), camera(width=32, height=32)
    small.render(scene, view)
    slabs, device = small._plan.slabs, small.device
    rows = [page.capacity for page in small._residency.pages(scene.sets[0].data)]
    keys = [
        device.read(slabs.buffers[f"keys of page {slot}"], np.uint32, size)
        for slot, size in enumerate(rows)
    ]
    last = slab_ranges(tally_of(np.concatenate(keys)), slabs.capacity)[-1]
    before = 0
    for key in keys:
        places = place_reference(key, last.low, last.high, before)
        before += int((places != NO_ID).sum())
    assert np.array_equal(
        device.read(slabs.buffers["places of a page"], np.uint32, rows[-1]), places
    )
    origins = np.flatnonzero(is_in(last, np.concatenate(keys)))
    assert np.array_equal(device.read(slabs.origins, np.uint32, before), origins)
