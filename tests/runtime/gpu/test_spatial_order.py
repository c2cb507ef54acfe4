"""Rows that are neighbours in space become neighbours in memory; no picture shows it."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.runtime.errors import MemoryFull
from gsgen.runtime.gpu import device as devices
from gsgen.runtime.gpu import spatial_order, splat_residency
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.morton_order import morton_sorted_indices
from gsgen.runtime.gpu.spatial_order import SpatialOrder
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.renderer.placed_pages import PlacedPage, scene_order
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.failing_devices import memory_of
from support.rendering.splat_scenes import camera, cloud, turned

ALL = ("color", "depth", "normal")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few rows are enough."""
    monkeypatch.setattr(splat_residency, "MIN_ORDERED_ROWS", 1)


def frames_equal(value: object, two: object) -> bool:
    fields = ("rgba", "depth", "median_depth", "ids", "normal", "visible", "pairs")
    return all(np.array_equal(getattr(value, f), getattr(two, f)) for f in fields)


def test_the_curve_goes_through_the_smallest_cubes_first() -> None:
    """Bit by bit, from the plain definition."""
    bits = 18  # what 200 indices leave of a word, a third of it for each axis
    cells = np.random.default_rng(0).integers(0, 1 << bits, (200, 3))
    cells[0], cells[1] = 0, (1 << bits) - 1  # the bounding box is all there is
    codes = [
        sum(
            ((int(cell[axis]) >> bit) & 1) << (3 * bit + axis)
            for bit in range(bits)
            for axis in range(3)
        )
        for cell in cells
    ]
    np.testing.assert_array_equal(morton_sorted_indices(cells * 0.25 - 7), np.argsort(codes))


def test_curve_marks_nonfinite_points() -> None:
    points = np.array([[1, 1, 1], [np.nan, 0, 0], [0, 0, 0], [np.inf, 0, 0]], np.float32)
    assert morton_sorted_indices(points).tolist() == [1, 2, 3, 0]
    assert morton_sorted_indices(points[1:2]).tolist() == [0]
    assert morton_sorted_indices(np.ones((3, 3), np.float32)).tolist() == [0, 1, 2]
    assert morton_sorted_indices(np.zeros((0, 3), np.float32)).tolist() == []


def test_no_picture_shows_how_rows_are_arranged(device: Device, small: None) -> None:
    """Two sets of several pages, one of them twice, one with rows that are not live."""
    first, second = cloud(300, 1, degree=2), cloud(200, 2)
    second.update(count=150)
    first.rows[40:60, :3] = first.rows[20:40, :3]  # ties, which the earlier row wins
    scene = Scene(
        [first, SplatSet(second, turned(0.2, (0, 1, 0))), SplatSet(first, turned(0.5, (0, 0, 1)))]
    )
    own_renderer = Renderer(device, rasteriser="tiles", page_rows=64)
    before = own_renderer.render(scene, camera(), outputs=ALL)
    assert all(page.rows_of is None for _, page in own_renderer.placed(Scene([cloud(5)])))
    after = own_renderer.render(scene, camera(), outputs=ALL)
    assert all(page.rows_of is not None for _, page in own_renderer.placed(scene))
    assert frames_equal(before, after)
    assert (before.ids >= 0).any()


def copied_scene(data: SplatData) -> Scene:
    """The same values, which no renderer has seen."""
    return Scene([SplatData(data.rows, data.appearance, data.space, count=data.count)])


@pytest.fixture(params=[True, False], ids=["mapped", "copied"])
def maps(device: Device, monkeypatch: pytest.MonkeyPatch, request: object) -> bool:
    """Whether the device maps its memory, as software drivers do and cards do not."""
    if request.param and not device.maps_buffers:
        pytest.skip("a card, whose memory is its own")
    monkeypatch.setattr(device, "maps_buffers", request.param)
    monkeypatch.setattr(devices, "MIN_MAPPED_BYTES", 1)
    return bool(request.param)


def test_changing_rows_keep_an_order_that_costs_nothing(
    device: Device, renderer: Renderer, small: None, maps: bool
) -> None:
    data, other = cloud(100, 3), cloud(100, 4)
    own_renderer, scene = Renderer(device, rasteriser="tiles"), Scene([data])

    def arranged() -> bool:
        frame = own_renderer.render(scene, camera(), outputs=ALL)
        assert frames_equal(frame, renderer.render(copied_scene(data), camera(), outputs=ALL))
        return own_renderer._residency.pages(data)[0].rows_of is not None

    assert [arranged(), arranged(), arranged()] == [False, True, True]
    plan = own_renderer._plan
    data.update(appearance=other.appearance)
    assert [arranged(), arranged()] == [maps, maps]
    data.update(rows=other.rows)
    assert [arranged(), arranged()] == [maps, maps]
    assert (own_renderer._plan is plan) is maps  # no buffer was made
    data.update(data.rows, data.appearance, count=80)  # these rows are no longer those before
    assert [arranged(), arranged()] == [False, False]
    data.update(data.rows, data.appearance)
    assert [arranged(), arranged()] == [False, False]


def test_order_is_recomputed_when_neighbours_separate(
    device: Device, small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not device.maps_buffers:
        pytest.skip("rows that change have their own order on a card")
    monkeypatch.setattr(spatial_order, "_CHECK_INTERVAL", 3)
    data = cloud(200, 8)
    start_time, residency = data.rows, Residency(device)

    def order() -> np.ndarray:
        residency.begin(data)
        return residency.pages(data)[0].rows_of

    assert order() is None
    data.update(rows=1.5 * start_time)
    first = order()
    np.testing.assert_array_equal(first, morton_sorted_indices(data.rows[:, :3]))
    for _ in range(5):  # nobody moves far
        data.update(rows=data.rows + np.float32(0.01))
        assert order() is first
    mixed = start_time[np.random.default_rng(0).permutation(200)]
    data.update(rows=50 * mixed)
    np.testing.assert_array_equal(order(), morton_sorted_indices(data.rows[:, :3]))
    data.update(rows=start_time)  # the new one serves for a while, whatever comes
    np.testing.assert_array_equal(order(), morton_sorted_indices(50 * mixed[:, :3]))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("far", [np.inf, -np.inf, np.nan])
def test_nonfinite_neighbours_are_ignored(far: float) -> None:
    data = cloud(200, 9)
    data.rows[::2, :2] = far
    order = SpatialOrder.of(data)
    assert 0 < order.median_gap < 10
    data.rows[:, 0] = far
    assert SpatialOrder.of(data).median_gap == 0


@pytest.mark.parametrize("change", ["rows", "appearance", "count"])
def test_values_may_change_once_rows_are_arranged(
    device: Device, renderer: Renderer, small: None, maps: bool, change: str
) -> None:
    data, other = cloud(100, 5), cloud(100, 6)
    data.update(count=60)
    own_renderer, scene = Renderer(device, rasteriser="tiles"), Scene([data])
    for _ in range(2):
        own_renderer.render(scene, camera())
    retained = {"count": 60} if change != "count" else {"count": 80}
    data.update(**retained, **({} if change == "count" else {change: getattr(other, change)}))
    assert frames_equal(
        own_renderer.render(scene, camera(), outputs=ALL),
        renderer.render(copied_scene(data), camera(), outputs=ALL),
    )


def test_a_frame_without_memory_forgets_no_count(
    device: Device, renderer: Renderer, small: None, maps: bool
) -> None:
    data, other = cloud(200, 10), cloud(200, 11)
    own_renderer, scene = Renderer(device, rasteriser="tiles", compact=True), Scene([data])
    for _ in range(2):
        own_renderer.render(scene, camera())
    data.update(rows=other.rows, count=100)  # rows are unpacked, for which there is no room
    with memory_of(100), pytest.raises(MemoryFull):
        own_renderer.render(scene, camera())
    shapes = ("depth", "normal")
    assert frames_equal(
        own_renderer.render(scene, camera(), outputs=shapes),
        renderer.render(copied_scene(data), camera(), outputs=shapes),
    )


def test_a_plane_seen_straight_on_is_not_arranged(device: Device, small: None) -> None:
    """All its depths are one, and the earlier row is in front."""
    data = cloud(400, 7, opacity=(0.5, 0.9))
    data.rows[:, 2] = 4.0
    own_renderer, scene = Renderer(device, rasteriser="tiles"), Scene([data])
    before = own_renderer.render(scene, camera(), outputs=ALL)
    for _ in range(2):
        assert frames_equal(own_renderer.render(scene, camera(), outputs=ALL), before)
    assert own_renderer.placed(scene)[0][1].rows_of is None


def pages_of(count: int, sizes: list[int], order: np.ndarray | None) -> list[PlacedPage]:
    """Return the pages of a splat set; ``order`` has the set's row of each GPU row."""
    assert sum(sizes) == count
    pages, first = [], 0
    for size in sizes:
        rows = None if order is None else order[first : first + size]
        page = SimpleNamespace(first=first, capacity=size, rows_of=rows)
        pages.append(cast(PlacedPage, (None, page)))
        first += size
    return pages


def test_rows_of_a_scene_are_counted_over_all_sets_and_pages() -> None:
    rng = np.random.default_rng(3)
    order = rng.permutation(9).astype(np.uint32)
    placed = [*pages_of(5, [5], None), *pages_of(9, [4, 5], order), *pages_of(6, [2, 4], None)]
    result = scene_order(placed)
    assert result is not None
    assert result.dtype == np.uint32
    np.testing.assert_array_equal(result, [*range(5), *(5 + order), *range(14, 20)])


def test_sets_in_their_own_order_need_no_table() -> None:
    assert scene_order([*pages_of(5, [5], None), *pages_of(6, [2, 4], None)]) is None
