"""A pool draws the tiles in it as one set of their rows, and changes no GPU object."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gsgen.runtime.errors import CapacityExceeded, SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import allocate_pool_page
from gsgen.runtime.kernels.project import project
from gsgen.runtime.kernels.project.slots import slot_table
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.renderer import renderer as renderers
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.frame import NOTHING, Frame, Output
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSplatSet, SplatPool, pool_row_bytes
from references.projection import visible_slots_reference
from support.rendering.splat_scenes import camera, cloud, single, turned

OUTPUTS: tuple[Output, ...] = ("color", "depth", "normal")
SLOT = 128


def tiles_of(data: SplatData, count: int) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Cut the rows of a set into tiles of unequal sizes, by their keys."""
    ends = np.linspace(0, 1, count + 1) ** 1.5 * len(data)
    parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    rows, appearance = data.rows.astype(np.float32), data.appearance.astype(np.float32)
    return {key: (rows[part], appearance[part]) for key, part in enumerate(parts)}


def filled_pool(data: SplatData, count: int = 4, spare_slots: int = 3) -> SplatPool:
    tiles = tiles_of(data, count)
    slots = sum(-(-len(rows) // SLOT) for rows, _ in tiles.values()) + spare_slots
    pool = SplatPool(slots * SLOT, data.appearance.shape[1], slot_rows=SLOT)
    for key, (rows, appearance) in tiles.items():
        pool.insert(key, rows, appearance, np.zeros(3))
    pool.draw(dict.fromkeys(tiles, 1.0))
    return pool


def assert_equal(pooled: Frame, single: Frame) -> None:
    for name in ("rgba", "alpha", "depth", "median_depth", "normal"):
        np.testing.assert_array_equal(getattr(pooled, name), getattr(single, name), err_msg=name)
    assert (pooled.visible, pooled.pairs) == (single.visible, single.pairs)


CAMERAS = {
    "pinhole": camera(),
    "panorama": Camera.panorama((0, 0, 1), width=96),
    "distorted": replace(camera(), distortion=Distortion.of({"k1": -0.2, "p1": 0.01})),
    "fisheye": replace(camera(fx=20.0, fy=20.0), kind="fisheye"),
    "orthographic": camera(fx=9.0, fy=9.0).flattened(4.0),
}
TURNED = turned(0.4, (1, 2, 3), 1.3)


def assert_draws_as_one_set(renderer: Renderer, view: Camera) -> None:
    data = cloud(900, seed=3, degree=1)
    pool = filled_pool(data)
    pooled = renderer.render(Scene([], pools=[PooledSplatSet(pool, TURNED)]), view, outputs=OUTPUTS)
    single = renderer.render(Scene([SplatSet(data, TURNED)]), view, outputs=OUTPUTS)
    assert single.visible > 100
    assert_equal(pooled, single)
    # Ids name the same rows, through the tiles.
    assert pooled.ids is not None
    assert single.ids is not None
    starts = np.cumsum([0, *(len(rows) for rows, _ in tiles_of(data, 4).values())])
    for own, expected in set(zip(pooled.ids.ravel(), single.ids.ravel(), strict=True)):
        if expected == NOTHING:
            assert own == NOTHING
            continue
        tile, row = pool.locate(int(own))
        assert starts[tile] + row == expected


@pytest.mark.parametrize("kind", CAMERAS)
def test_a_pool_draws_its_tiles_as_one_set(renderer: Renderer, kind: str) -> None:
    assert_draws_as_one_set(renderer, CAMERAS[kind])


def test_a_pool_of_many_pages_draws_its_tiles_as_one_set(device: Device) -> None:
    small = Renderer(device, rasteriser="tiles", page_rows=3 * SLOT)
    assert_draws_as_one_set(small, CAMERAS["pinhole"])


def test_compact_pools_and_quads_are_close(device: Device) -> None:
    data = cloud(400, seed=5, degree=2)
    compact = Renderer(device, rasteriser="quads", compact=True)
    pooled = compact.render(Scene([], pools=[filled_pool(data)]), camera()).rgba
    single = compact.render(Scene([data]), camera()).rgba
    np.testing.assert_allclose(pooled, single, atol=4e-3)


def test_a_pool_blends_with_sets_around_it(renderer: Renderer) -> None:
    front_set, back = cloud(200, 7, degree=0), cloud(300, 8, degree=0)
    both = renderer.render(Scene([front_set, back]), camera(), outputs=OUTPUTS)
    mixed = renderer.render(
        Scene([front_set], pools=[filled_pool(back)]), camera(), outputs=OUTPUTS
    )
    assert_equal(mixed, both)
    scene = Scene([front_set], pools=[filled_pool(back)])
    assert scene.locate(199) == (0, 199)
    assert scene.locate(205) == (1, 5)
    with pytest.raises(IndexError):
        scene.locate(len(scene))


@pytest.mark.parametrize(("width", "dilation"), [(61, 30.0), (61, 0.3), (9, 0.3)])
def test_dilated_splats_beside_the_image_are_those_of_a_set(
    renderer: Renderer, width: int, dilation: float
) -> None:
    """A point beside the image reaches into it by its dilation alone."""
    view = replace(camera(width=width), dilation=dilation)
    reach = np.sqrt(2 * np.log(255) * dilation)
    actual = 0
    for offset in np.linspace(0.1, 1.1, 8) * reach:
        rows = single(depth=4.0, opacity=1.0, variance=1e-8).rows.copy()
        rows[:, 0] = 4 * (width + offset - view.cx) / view.fx
        data = SplatData(rows, np.ones((1, 3), np.float32), "sh")
        pooled = renderer.render(Scene([], pools=[filled_pool(data, count=1)]), view).rgba
        expected = renderer.render(Scene([data]), view).rgba
        np.testing.assert_array_equal(pooled, expected)
        actual += bool(expected.any())
    assert actual > 3


@pytest.mark.parametrize("fade", [0.0, 0.3, 1.0])
def test_fades_multiply_the_opacity_of_their_tile_alone(renderer: Renderer, fade: float) -> None:
    data = cloud(400, 9, degree=0)
    pool = filled_pool(data, count=2)
    pool.draw({0: fade, 1: 1.0} if fade else {1: 1.0})
    faded = data.rows.copy()
    cut = len(tiles_of(data, 2)[0][0])
    faded[:cut, 3] = np.float32(fade) * faded[:cut, 3]
    expected = renderer.render(Scene([SplatData(faded, data.appearance, "sh")]), camera())
    assert_equal(renderer.render(Scene([], pools=[pool]), camera()), expected)


def test_tiles_far_from_the_origin_of_the_scene_keep_their_precision(renderer: Renderer) -> None:
    """A scene on the globe: metres at six million of them, where float32 has steps of a half."""
    data = cloud(500, 11, degree=1)
    globe = np.array([4.2e6, -3.1e6, 4.0e6])
    pool = SplatPool(8 * SLOT, 12, slot_rows=SLOT)
    origins = [globe, globe + np.array([300.25, -7.5, 90.125])]
    for tile, (rows, appearance) in tiles_of(data, 2).items():
        moved = rows.copy()
        moved[:, :3] -= (origins[tile] - globe).astype(np.float32)
        pool.insert(tile, moved, appearance, origins[tile])
    pool.draw({0: 1.0, 1: 1.0})
    here = camera()
    view = here.view.copy()
    view[:3, 3] = here.view[:3, 3] - here.view[:3, :3] @ globe
    other_view = Camera(view, width=61, height=47, fx=here.fx, fy=here.fy, cx=here.cx, cy=here.cy)
    pooled = renderer.render(Scene([], pools=[pool]), other_view).rgba
    expected = renderer.render(Scene([data]), here).rgba
    assert pooled is not None
    assert expected is not None
    assert 10 * np.log10(1 / np.mean((pooled - expected) ** 2)) > 80


# ---- Arrivals, evictions and fades ---------------------------------------------------------------


def test_a_thousand_arrivals_make_no_plan_and_no_gpu_object(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    data = cloud(3000, 12, degree=0)
    tiles = tiles_of(data, 30)
    pool = SplatPool(12 * SLOT, 3, slot_rows=SLOT)
    scene = Scene([], pools=[pool])
    view = camera(width=16, height=16)
    renderer.render(Scene([data]), view)  # room for all pairs
    renderer.render(scene, view)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a GPU object was made")

    monkeypatch.setattr(renderers, "Plan", refuse)
    monkeypatch.setattr(type(renderer.device), "_create_buffer", refuse)
    uploaded: list[int] = []
    write = type(renderer.device).write

    def counted(self: Device, buffer: object, array: np.ndarray, offset: int = 0) -> None:
        uploaded.append(array.nbytes)
        write(self, buffer, array, offset)

    monkeypatch.setattr(type(renderer.device), "write", counted)
    arrivals = frames = 0
    while arrivals < 1000:
        uploaded.clear()
        expected = 0
        for key in rng.permutation(30):
            rows, appearance = tiles[int(key)]
            if int(key) in pool.tiles:
                if rng.random() < 0.6:
                    pool.evict(int(key))
            elif -(-len(rows) // SLOT) <= pool.free_slots:
                pool.insert(int(key), rows, appearance, np.zeros(3))
                expected += rows.nbytes + len(rows) * 16  # three floats take a vector of four
                arrivals += 1
        pool.draw(dict.fromkeys(pool.tiles, 1.0))
        frames += 1
        if frames % 20:
            pool.take_writes()  # only every twentieth frame is drawn, to save time
            continue
        renderer.render(scene, view)
        assert sum(uploaded) - expected < 4096  # uniforms and the slot table
    assert frames > 50


@pytest.mark.parametrize("seed", range(3))
def test_pool_equals_a_new_set_after_random_events(renderer: Renderer, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = cloud(1500, 20 + seed, degree=0)
    tiles = tiles_of(data, 12)
    pool = SplatPool(14 * SLOT, 3, slot_rows=SLOT)
    scene = Scene([], pools=[pool])
    for _ in range(12):
        for key in rng.permutation(12)[:5]:
            rows, appearance = tiles[int(key)]
            if int(key) in pool.tiles:
                pool.evict(int(key))
            elif -(-len(rows) // SLOT) <= pool.free_slots:
                pool.insert(int(key), rows, appearance, np.zeros(3))
        drawn = [tile for tile in pool.tiles if rng.random() < 0.8]
        pool.draw(dict.fromkeys(drawn, 1.0))
        parts = [tiles[tile] for tile in drawn] or [tiles[0]]
        rows, appearance = (np.concatenate(column) for column in zip(*parts, strict=True))
        count = len(rows) if drawn else 0
        expected = renderer.render(
            Scene([SplatData(rows, appearance, "sh", count=count)]), camera()
        )
        actual = renderer.render(scene, camera())
        np.testing.assert_array_equal(actual.rgba, expected.rgba)


@pytest.mark.parametrize("seed", range(2))
def test_a_tile_is_rewritten_in_its_slots(renderer: Renderer, seed: int) -> None:
    """Runs of a generator give fewer or more rows, before and after a frame."""
    rng = np.random.default_rng(seed)
    data = cloud(900, 40 + seed, degree=0)
    rows, color = data.rows.astype(np.float32), data.appearance.astype(np.float32)
    pool = SplatPool(9 * SLOT, 3, slot_rows=SLOT)
    scene = Scene([], pools=[pool])
    pool.insert(1, rows[:40], color[:40], np.zeros(3), reserved_rows=500)
    pool.insert(2, rows[40:240], color[40:240], np.zeros(3))
    assert pool.free_slots == 9 - 4 - 2
    pool.draw({1: 1.0, 2: 1.0})
    for count in (40, 500, 0, 129, int(rng.integers(1, 500))):
        pick = rng.choice(900, count, replace=False)
        pool.rewrite(1, rows[:1], color[:1], np.zeros(3))  # replaced before it is drawn
        origin = rng.normal(size=3)
        moved = rows[pick].copy()
        moved[:, :3] = (moved[:, :3] - origin).astype(np.float32)
        pool.rewrite(1, moved, color[pick], origin)
        both = (
            np.concatenate([rows[pick], rows[40:240]]),
            np.concatenate([color[pick], color[40:240]]),
        )
        expected = renderer.render(Scene([SplatData(*both, "sh")]), camera())
        actual = renderer.render(scene, camera())
        np.testing.assert_allclose(actual.rgba, expected.rgba, atol=2e-4)
        assert actual.visible == expected.visible
    with pytest.raises(
        CapacityExceeded, match="the tile has 513 rows, but its slots hold 512"
    ) as e:
        pool.rewrite(1, rows[:513], color[:513], np.zeros(3))
    assert "Reserve rows" in e.value.hint
    with pytest.raises(SceneInvalid, match="not in the splat pool"):
        pool.rewrite(3, rows[:1], color[:1], np.zeros(3))


def test_a_flight_through_a_pool_draws_no_frame_twice(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The capacity for pairs is that of the pool's rows, so that it rarely has to grow."""
    monkeypatch.setattr(renderers, "FIRST_PAIR_CAPACITY", 64)
    drawer, plans = Renderer(renderer.device, rasteriser="tiles"), []
    plan = renderers.Plan
    monkeypatch.setattr(renderers, "Plan", lambda *a, **k: plans.append(1) or plan(*a, **k))
    pool = filled_pool(cloud(700, seed=6, degree=0))
    for tiles in ([], [0], [0, 1], [0, 1, 2, 3]):
        pool.draw(dict.fromkeys(tiles, 1.0))
        frame = drawer.render(Scene([], pools=[pool]), camera())
    assert frame.pairs > 64
    assert len(plans) == 1


def test_a_pool_refuses_what_it_cannot_hold() -> None:
    pool = SplatPool(2 * SLOT, 3, slot_rows=SLOT)
    rows, color = np.zeros((SLOT + 1, 10), np.float32), np.zeros((SLOT + 1, 3), np.float32)
    pool.insert(5, rows, color, np.zeros(3))
    assert (pool.free_slots, pool.tiles) == (0, (5,))
    with pytest.raises(
        CapacityExceeded, match="tile 6: the tile needs 1 slots, but only 0 of 2 are free"
    ):
        pool.insert(6, rows[:1], color[:1], np.zeros(3))
    with pytest.raises(SceneInvalid, match="tile 5: the tile is in the splat pool already"):
        pool.insert(5, rows, color, np.zeros(3))
    with pytest.raises(SceneInvalid, match=r"tile 7: has rows \[1, 10\] and appearance \[1, 12\]"):
        pool.insert(7, rows[:1], np.zeros((1, 12), np.float32), np.zeros(3))
    with pytest.raises(SceneInvalid, match="tile 8: the tile is not in the splat pool"):
        pool.draw({8: 1.0})
    with pytest.raises(SceneInvalid, match="tile 8: the tile is not in the splat pool"):
        pool.evict(8)
    with pytest.raises(IndexError):
        pool.locate(2 * SLOT - 1)
    for sizes in ((0, 3, SLOT), (10, 3, 100), (10, 5, SLOT)):
        with pytest.raises(SceneInvalid):
            SplatPool(sizes[0], sizes[1], slot_rows=sizes[2])
    with pytest.raises(SceneInvalid, match="opacity_scale"):
        PooledSplatSet(pool, opacity_scale=float("nan"))


# ---- Culling -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_slots_are_culled_as_the_reference_says(renderer: Renderer, seed: int) -> None:
    """Boxes all around the camera; those within a rounding error of a side may go either way."""
    rng = np.random.default_rng(seed)
    count = 400
    pool = SplatPool(count * 64, 3, slot_rows=64)
    for tile in range(count):
        rows = cloud(int(rng.integers(1, 65)), 100 + tile, degree=0, size=0.05).rows.copy()
        rows[:, :3] = rng.normal(size=3) * 4 + 0.3 * rng.normal(size=(len(rows), 3))
        color = np.zeros((len(rows), 3), np.float32)
        pool.insert(tile, rows.astype(np.float32), color, rng.normal(size=3))
    pool.draw({tile: 1.0 for tile in range(count) if tile % 7})
    view = camera(cx=20.0)
    scene = Scene([], pools=[PooledSplatSet(pool, TURNED)])
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, view, frozenset(["color"]))
    plan.submit(placed, view, np.zeros(3), only=["project"])
    plan.collect()
    frame = project.frame_uniform(view, np.zeros(3))
    keys = renderer.device.read(plan.buffers["keys of Gaussians a"], np.uint32, len(pool))
    is_absent = (keys.reshape(count, 64) == NO_ID).all(axis=1)
    differences = total = 0
    for splat_set, page in placed:
        assert page.slots is not None
        slots = page.slots
        uniform = project.page_uniform(splat_set, view, 0, page.capacity, page.capacity)
        table = slot_table(pool, slots.first, slots.count, TURNED, view)
        groups = renderer.device.read(slots.dispatch, np.uint32, 3)
        assert groups[1:].tolist() == [1, 1]
        listed = renderer.device.read(slots.seen, np.uint32, slots.count)[: groups[0]]
        assert len(set(listed)) == len(listed)
        array = np.zeros(slots.count, bool)
        array[listed] = True
        differences += int(
            np.count_nonzero(array != visible_slots_reference(table, frame, uniform))
        )
        total += len(listed)
        assert is_absent[slots.first : slots.first + slots.count][~array].all()
    assert differences <= 1
    assert 20 < total < 300


def test_a_culled_slot_has_no_splat_in_the_image(renderer: Renderer) -> None:
    """Random scenes around the camera: with and without culling, pictures are the same."""
    for seed in range(4):
        data = cloud(1500, 40 + seed, depth=(-6, 6), size=0.3, degree=0)
        order = np.lexsort((data.rows[:, 2] > 0, data.rows[:, 0] > 0, data.rows[:, 1] > 0))
        sorted_data = SplatData(data.rows[order], data.appearance[order], "sh")
        pooled = renderer.render(Scene([], pools=[filled_pool(sorted_data, count=9)]), camera())
        single = renderer.render(Scene([sorted_data]), camera())
        np.testing.assert_array_equal(pooled.rgba, single.rgba)


def test_parts_of_a_tile_are_written_from_slot_to_slot() -> None:
    data = cloud(300, 5, degree=0)
    rows, appearance = data.rows.astype(np.float32), data.appearance.astype(np.float32)
    pool = SplatPool(4 * SLOT, 3, slot_rows=SLOT)
    pool.insert(3, rows[:SLOT], appearance[:SLOT], np.zeros(3), reserved_rows=300)
    assert pool.free_slots == 1
    assert pool.live.tolist() == [SLOT, 0, 0, 0]
    pool.extend(3, rows[SLOT:], appearance[SLOT:], np.zeros(3), first_row=SLOT)
    assert pool.live.tolist() == [SLOT, SLOT, 300 - 2 * SLOT, 0]
    written = {write.first: write.rows for write in pool.take_writes()}
    np.testing.assert_array_equal(np.concatenate([written[key] for key in sorted(written)]), rows)
    for first_row, end in ((1, 40), (2 * SLOT, 300 + SLOT)):
        part = np.resize(rows, (end - first_row, 10)), np.resize(appearance, (end - first_row, 3))
        with pytest.raises(SceneInvalid, match=f"rows {first_row} to {end}"):
            pool.extend(3, *part, np.zeros(3), first_row=first_row)
    with pytest.raises(SceneInvalid, match="tile 4"):
        pool.extend(4, rows, appearance, np.zeros(3), first_row=0)


def test_staged_rows_are_drawn_once_they_are_complete() -> None:
    """Random tiles in random parts: until the last part, what is drawn stays as it was."""
    rng = np.random.default_rng(0)
    pool, memory = SplatPool(9 * SLOT, 3, slot_rows=SLOT), np.zeros((9 * SLOT, 10), np.float32)

    def rows_of(count: int) -> tuple[np.ndarray, np.ndarray]:
        return rng.uniform(size=(count, 10)).astype(np.float32), np.zeros((count, 3), np.float32)

    def drawn() -> np.ndarray:
        for write in pool.take_writes():
            memory[write.first : write.first + len(write.rows)] = write.rows
        rows = [row for row in range(len(memory)) if row % SLOT < pool.live[row // SLOT]]
        slots_by_row = {pool.locate(row): row for row in rows}
        return memory[[slots_by_row[key] for key in sorted(slots_by_row) if key[0] == 7]]

    pool.insert(1, *rows_of(40), np.zeros(3))
    expected, colors = rows_of(200)
    pool.insert(7, expected, colors, np.zeros(3), reserved_rows=8 * SLOT)
    for count in (4 * SLOT, 3, SLOT + 2, 0, SLOT, 4 * SLOT - 1, 2 * SLOT + 1):
        rows, colors = rows_of(count)
        first = 0
        while first < count or not count:
            end = min(count, first + SLOT * int(rng.integers(1, 4)))
            np.testing.assert_array_equal(drawn(), expected)
            part = rows[first:end], colors[first:end], np.zeros(3)
            pool.stage(7, *part, first_row=first, count=count)
            first = end
            if first == count:
                break
        expected = rows
        np.testing.assert_array_equal(drawn(), expected)
    for first, end, count in ((1, 40, 40), (0, 4 * SLOT + 1, 4 * SLOT + 1), (SLOT, 2 * SLOT, SLOT)):
        with pytest.raises(SceneInvalid, match=f"rows {first} to {end} of {count} "):
            pool.stage(7, *rows_of(end - first), np.zeros(3), first_row=first, count=count)
    with pytest.raises(SceneInvalid, match="second half of the tile's 1 slots"):
        pool.stage(1, *rows_of(20), np.zeros(3), first_row=0, count=10)


@pytest.mark.parametrize(("channels", "size"), [(3, 56), (12, 88), (27, 152), (48, 232)])
def test_a_row_of_a_pool_has_the_bytes_of_its_buffers(
    device: Device, channels: int, size: int
) -> None:
    page = allocate_pool_page(
        device, SplatPool(SLOT, channels, slot_rows=SLOT), 0, 1, is_half=False
    )
    assert pool_row_bytes(channels) == size == (page.rows.size + page.appearance.size) / SLOT
