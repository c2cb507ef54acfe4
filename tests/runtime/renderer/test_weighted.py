"""Weighted sums are those of the float64 oracle, and of the method's own rasteriser."""

import numpy as np
import pytest

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.checkpoints.golden_duplex import BACKDROP, golden_scene, golden_view
from support.rendering.splat_scenes import camera, turned
from support.rendering.weighted_scenes import WEIGHTED, celled, summed

BACKGROUND = (0.1, 0.4, 0.7, 0.5)
EVERYTHING = ("color", "depth", "normal")


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-20)))


@pytest.fixture(scope="session")
def published(device: Device) -> Renderer:
    return Renderer(device, rasteriser="tiles", published=True)


@pytest.mark.parametrize("name", WEIGHTED)
def test_weighted_sums_agree_with_the_oracle(renderer: Renderer, name: str) -> None:
    scene, view_camera = WEIGHTED[name]()
    frame = renderer.render(scene, view_camera, background=BACKGROUND, outputs=EVERYTHING)
    expected = oracle.render(scene, view_camera, background=BACKGROUND)
    assert np.isfinite(frame.rgba).all()
    firm, firm_median = ~expected.fragile, ~expected.fragile_median
    assert decibels(frame.rgba[firm], expected.rgba[firm]) >= 110
    assert np.abs(frame.rgba - expected.rgba)[firm].max() <= 2e-5
    assert expected.fragile.mean() < 0.1  # or little was compared
    assert frame.visible >= expected.visible
    np.testing.assert_allclose(frame.depth[firm], expected.depth[firm], rtol=1e-4)
    np.testing.assert_array_equal(frame.ids[firm_median], expected.ids[firm_median])
    np.testing.assert_allclose(
        frame.median_depth[firm_median], expected.median_depth[firm_median], rtol=1e-5
    )
    covered = firm & np.isfinite(expected.depth)
    cosine = (frame.normal * expected.normal).sum(axis=-1)
    if name == "no_cells":
        assert not covered.any()
    else:
        assert covered.any()
        assert np.median(cosine[covered]) > 0.99999
    assert not frame.normal[~covered & firm].any()


@pytest.mark.parametrize("name", ["many_cells", "placed_cells", "finished_early"])
def test_published_backgrounds_agree_with_the_oracle(published: Renderer, name: str) -> None:
    scene, view_camera = WEIGHTED[name]()
    frame = published.render(scene, view_camera, background=BACKGROUND)
    expected = oracle.render(scene, view_camera, background=BACKGROUND, published=True)
    assert np.abs(frame.rgba - expected.rgba)[~expected.fragile].max() <= 2e-5


@pytest.mark.parametrize("number", [0, 1])
def test_golden_images_of_the_method_are_reproduced(published: Renderer, number: int) -> None:
    """They are float32 themselves: the oracle in float64 is as far from them as we are."""
    scene, (view_camera, image) = golden_scene(number), golden_view(number)
    frame = published.render(scene, view_camera, background=BACKDROP)
    expected = oracle.render(scene, view_camera, background=BACKDROP, published=True)
    assert np.abs(expected.rgba[..., :3] - image).max() <= 5e-6
    assert np.abs(frame.rgba[..., :3] - image).max() <= 5e-6
    assert np.ptp(image, axis=(0, 1)).min() > 0.5  # there is something to see


def test_the_goldens_need_cells_and_their_tiles() -> None:
    """Larger cells, or a cell for each Gaussian, are other pictures."""
    scene, (view_camera, image) = golden_scene(0), golden_view(0)
    entry = scene.sets[0]
    data = entry.data
    copy = data.cells.copy()
    copy[:, 4:] *= 100
    larger = SplatData(data.rows, data.appearance, "rgb", cells=copy, per_cell=5)
    alone = SplatData(
        data.rows, data.appearance, "rgb", cells=np.repeat(data.cells, 5, 0), per_cell=1
    )
    for other in (larger, alone):
        changed = Scene([SplatSet(other, weighted=entry.weighted)])
        frame = oracle.render(changed, view_camera, background=BACKDROP, published=True)
        assert np.abs(frame.rgba[..., :3] - image).max() > 1e-3


def test_the_order_within_cells_does_not_count(renderer: Renderer) -> None:
    data = celled(120, 7, 3, size=0.5, share=0.7)
    order = np.random.default_rng(0).permuted(np.arange(840).reshape(120, 7), axis=1).reshape(-1)
    other = SplatData(data.rows[order], data.appearance[order], "rgb", cells=data.cells, per_cell=7)
    first, two = (
        renderer.render(Scene([summed(array)]), camera(), outputs=EVERYTHING)
        for array in (data, other)
    )
    np.testing.assert_allclose(first.rgba, two.rgba, atol=3e-6)
    np.testing.assert_allclose(first.depth, two.depth, rtol=1e-5)
    np.testing.assert_allclose(first.normal, two.normal, atol=1e-4)
    same = first.median_depth == two.median_depth  # but where half of the light is in doubt
    assert same.mean() > 0.99
    assert np.array_equal(np.where(first.ids < 0, -1, order[two.ids])[same], first.ids[same])


def test_the_order_of_cells_counts_only_where_they_tie(renderer: Renderer) -> None:
    data = celled(200, 3, 4)
    order = np.random.default_rng(1).permutation(200)
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    other = SplatData(
        data.rows[rows], data.appearance[rows], "rgb", cells=data.cells[order], per_cell=3
    )
    first, two = (renderer.render(Scene([summed(array)]), camera()) for array in (data, other))
    assert np.array_equal(first.rgba, two.rgba)


def test_paging_does_not_change_the_picture(device: Device) -> None:
    """Pages that end within cells, and more pairs than there is room for at first."""
    scene = Scene([summed(celled(400, 5, 5, size=1.5)), summed(celled(90, 3, 6))])
    view_camera = camera(width=400, height=300, fx=330.0, fy=330.0)
    whole, paged = (
        Renderer(device, rasteriser="tiles"),
        Renderer(device, rasteriser="tiles", page_rows=64),
    )
    whole._pairs = paged._pairs = 512
    first, two = (
        entry.render(scene, view_camera, outputs=("color", "depth")) for entry in (whole, paged)
    )
    assert first.pairs > 512
    assert np.array_equal(first.rgba, two.rgba)
    assert np.array_equal(first.ids, two.ids)
    assert {scene.locate(int(entry))[0] for entry in np.unique(first.ids[first.ids >= 0])} == {0, 1}


def test_values_change_without_new_buffers(device: Device) -> None:
    renderer, view_camera = Renderer(device, rasteriser="tiles"), camera()
    data, later_cells = celled(60, seed=40), celled(60, seed=41)
    first = renderer.render(Scene([summed(data)]), view_camera)
    plan = renderer._plan
    data.update(later_cells.rows, later_cells.appearance, cells=later_cells.cells)
    second = renderer.render(Scene([summed(data, background=0.9)]), view_camera)
    assert renderer._plan is plan
    fresh = renderer.render(Scene([summed(later_cells, background=0.9)]), view_camera)
    assert np.array_equal(second.rgba, fresh.rgba)
    assert not np.array_equal(first.rgba, second.rgba)


def test_a_depth_range_follows_the_size_of_its_set(renderer: Renderer) -> None:
    """A model twice as large, seen from twice as far, is the same picture."""
    data = celled(80, seed=42)
    frame = renderer.render(Scene([summed(data, depth_range=9.0)]), camera())
    scaled_set = summed(data, depth_range=9.0, transform=turned(0, (0, 0, 1), 2.0))
    assert scaled_set.depth_range == pytest.approx(18)
    far_frame = renderer.render(Scene([scaled_set]), camera(near=0.02))
    np.testing.assert_allclose(frame.rgba, far_frame.rgba, atol=1e-5)


def test_the_same_data_is_sorted_or_summed(renderer: Renderer) -> None:
    data = celled(60, seed=43)
    sums, blended = (renderer.render(Scene([array]), camera()) for array in (summed(data), data))
    again = renderer.render(Scene([summed(data)]), camera())
    assert not np.allclose(sums.rgba, blended.rgba, atol=0.05)
    assert np.array_equal(sums.rgba, again.rgba)


def test_cells_alone_are_sorted(device: Device) -> None:
    """Ten Gaussians of a cell take the room of one in columns, and list no pairs of their own."""
    data, renderer = celled(200, 10, 44), Renderer(device, rasteriser="tiles")
    blended = renderer.render(Scene([data]), camera())
    sorted_bytes = _columns(renderer)
    summed_up = renderer.render(Scene([summed(data)]), camera())
    assert sorted_bytes == 16 * 2000
    assert _columns(renderer) == 16 * 200 + 4 * 2000  # and a word that says who is drawn
    assert summed_up.pairs < blended.pairs / 3
    assert 200 < summed_up.visible <= blended.visible


def _columns(renderer: Renderer) -> int:
    """How many bytes the plan's keys and values take, but those of pairs."""
    sizes = {name: buffer.size for name, buffer in renderer._plan.buffers.items()}
    return sum(
        size
        for name, size in sizes.items()
        if name.startswith(("keys", "values")) and "pairs" not in name
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth_range": 0.0}, "numbers above 0"),
        ({"depth_range": float("nan")}, "numbers above 0"),
        ({"divisor": 0.0}, "numbers above 0"),
        ({"background": -0.1}, "has the background weight -0.1"),
    ],
)
def test_invalid_weights_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(SceneInvalid, match=message):
        summed(celled(3), **change)


def test_mismatched_cells_are_refused() -> None:
    data = celled(4)
    with pytest.raises(SceneInvalid, match=r"needs cells .* but the splat data has none"):
        summed(SplatData(data.rows, data.appearance, "rgb"))
    for wrong in (data.cells[:3], data.cells[:, :9], data.cells.astype(np.float64)):
        with pytest.raises(SceneInvalid, match=r"cells: .* expected float16 or float32"):
            SplatData(data.rows, data.appearance, "rgb", cells=wrong, per_cell=5)
    with pytest.raises(SceneInvalid, match="expected float32 as in the frame before"):
        data.update(cells=data.cells.astype(np.float16))
    with pytest.raises(SceneInvalid, match="expected no cells as in the frame before"):
        SplatData(data.rows, data.appearance, "rgb").update(cells=np.repeat(data.cells, 5, 0))
