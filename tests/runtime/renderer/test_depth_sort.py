"""Front to back is exact: depths that a float does not tell apart are in order."""

import math
from fractions import Fraction

import numpy as np
import pytest

from gsgen.runtime.gpu import splat_residency
from gsgen.runtime.gpu.device import MAX_WORKGROUPS, Device
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import Step, run
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.kernels.sort.gather_keys import GatherKeys
from gsgen.runtime.kernels.sort.order_ties import MAX_TIED_KEYS, OrderTies
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import Columns, RadixSort, SortConfig, sort_config_for
from gsgen.runtime.kernels.tiles.bin_tiles import WALK_THREADS
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.oracle.projection import ellipses
from gsgen.runtime.renderer.depth_sort import DepthOrder
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from references.projection import depth_reference
from references.sorting import gather_reference, order_ties_reference
from support.rendering.near_ties import DEPTH_LEFT, NEAR_TIES, decoded, plane, seen_through
from support.rendering.sorting import GPU
from support.rendering.splat_scenes import SCENES, camera, turned
from support.rendering.weighted_scenes import celled, summed

DEEP = {"tilted_less", "plane_of_rounded_rows", "several_models", "orthographic", "sphere"}
"""Scenes in which more depths have one key than are put in order one by one."""

ALL = ("color", "depth", "normal")


def exact_depths(splat_set: SplatSet, view_camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return depths, as rational numbers, and distances."""
    turn, linear = (
        [[Fraction(x) for x in row] for row in matrix[:3, :3].tolist()]
        for matrix in (view_camera.view, splat_set.transform)
    )
    eye, location = view_camera.eye.tolist(), splat_set.transform[:3, 3].tolist()
    depths, distances = [], []
    for row in np.nan_to_num(splat_set.data.rows[:, :3]).tolist():
        reference = [
            sum(
                (a * Fraction(x) for a, x in zip(line, row, strict=True)), Fraction(p) - Fraction(e)
            )
            for line, p, e in zip(linear, location, eye, strict=True)
        ]
        offset = [sum(a * x for a, x in zip(line, reference, strict=True)) for line in turn]
        distances.append(math.hypot(*map(float, offset)))
        depths.append(Fraction(distances[-1]) if view_camera.period else Fraction(offset[2]))
    return np.array(depths), np.array(distances)


@pytest.mark.parametrize(
    "name", ["many", "not_finite", "placed", "seen_from_elsewhere", "flat_cameras", "far_from_the_origin",
             "panorama_seam", "panorama_poles", *NEAR_TIES]
)  # fmt: skip
def test_a_depth_is_two_floats(renderer: Renderer, name: str) -> None:
    scene, view_camera = (SCENES | NEAR_TIES)[name]()
    assert_two_floats(renderer, scene.sets[0], view_camera)


def assert_two_floats(renderer: Renderer, splat_set: SplatSet, view_camera: Camera) -> None:
    """Assert that keys and what they leave are depths by rational numbers."""
    n, placed = len(splat_set.data), renderer.placed(Scene([splat_set]))
    plan = renderer.plan(placed, view_camera, frozenset(["color"]))
    plan.submit(placed, view_camera, np.zeros(3), only=["project"])
    plan.collect()
    keys, lows = (
        renderer.device.read(plan.buffers[part], np.uint32, n)
        for part in ("keys of Gaussians a", "lows")
    )
    drawn = keys != NO_ID
    assert drawn.any()
    np.testing.assert_array_equal(lows == NO_ID, ~drawn)
    high, low = keys.view(np.float32), decoded(lows)
    depths, distances = exact_depths(splat_set, view_camera)
    for i in np.flatnonzero(drawn):
        result = Fraction(float(high[i])) + Fraction(float(low[i]))
        assert abs(result - depths[i]) <= DEPTH_LEFT * distances[i]
    # The first is the nearest float, so the two sort as their sum does.
    assert (np.abs(low) <= np.spacing(high) / 2)[drawn].all()


@pytest.mark.parametrize("size", [1e-22, 1e36])
@pytest.mark.parametrize("kind", ["pinhole", "panorama"])
def test_depths_may_be_enormous_or_vanishing(renderer: Renderer, size: float, kind: str) -> None:
    transform, data = turned(0.5, (3, 1, 2)), plane(100)
    data.rows[:, 4:] = 0
    data.rows[:, :3] = size * data.rows[:, :3]
    view_camera = seen_through(transform, near=size / 10)
    if kind == "panorama":
        view_camera = Camera.panorama((0, 0, 0), (1, 0, 1), width=96, near=size / 10)
    assert_two_floats(renderer, SplatSet(data, transform), view_camera)


def test_bits_sort_as_depths_do() -> None:
    rng = np.random.default_rng(0)
    depth = np.sort(np.concatenate([1 + 1e-9 * rng.normal(size=200), [1.0, 3.0, 1e-30]]))
    keys, lows = depth_reference(depth)
    assert (np.lexsort((lows, keys)) == np.arange(len(depth))).all()
    np.testing.assert_allclose(
        keys.view(np.float32).astype(np.float64) + decoded(lows), depth, rtol=2.0**-47
    )


def submit(device: Device, steps: list[Step]) -> None:
    encoder = device.raw.create_command_encoder()
    run(encoder, steps, "test")
    device.raw.queue.submit([encoder.finish()])


def filled_buffer(device: Device, words: np.ndarray) -> object:
    buffer = device.storage("words", 4 * len(words) + 16, extra_usage="INDIRECT")
    device.write(buffer, words.astype(np.uint32))
    return buffer


def ordered(
    device: Device,
    walk: int,
    keys: np.ndarray,
    lows: np.ndarray,
    order: np.ndarray,
    *origins: np.ndarray,
) -> tuple[tuple[bool, bool], np.ndarray]:
    """Order ties; return whether any was announced as UNSORTED and as TIED, and the order."""
    counts = counting.initial(len(keys), 0)
    counts[Counts.VISIBLE] = len(keys)
    buffers = [filled_buffer(device, words) for words in (counts, keys, lows, order, *origins)]
    ties = OrderTies(device, walk, is_reordered=bool(origins))
    submit(device, [ties.step(len(keys), *buffers)])
    message = device.read(buffers[0], np.uint32, 8)
    flags = bool(message[Counts.UNSORTED]), bool(message[Counts.TIED])
    return flags, device.read(buffers[3], np.uint32, len(keys))


@pytest.mark.parametrize("arranged", [False, True])
@pytest.mark.parametrize("walk", [1, 4, 64])
def test_ties_are_put_in_order(device: Device, walk: int, arranged: bool) -> None:
    rng = np.random.default_rng(walk)
    lengths = np.concatenate([np.ones(200, int), [MAX_TIED_KEYS, 2, 3, 40], np.ones(50, int)])
    rng.shuffle(lengths)
    keys = np.repeat(np.arange(len(lengths), dtype=np.uint32) * 3, lengths)
    n = len(keys)
    lows, order = rng.integers(0, 7, n, np.uint32), rng.permutation(n).astype(np.uint32)
    origins = rng.permutation(n).astype(np.uint32) if arranged else np.arange(n, dtype=np.uint32)
    flags, result = ordered(device, walk, keys, lows, order, *([origins] if arranged else []))
    assert flags == (False, False)
    np.testing.assert_array_equal(result, order_ties_reference(keys, lows, origins, order))
    assert not np.array_equal(result, order)


def test_ties_among_millions_are_put_in_order(device: Device) -> None:
    """More than one line of workgroups has."""
    n = (MAX_WORKGROUPS + 2) * WALK_THREADS
    keys = origins = order = np.arange(n, dtype=np.uint32)
    keys, order = keys.copy(), order.copy()
    for array in (5, n // 2, MAX_WORKGROUPS * WALK_THREADS - 1, n - 2):
        keys[array] = keys[array + 1]
        order[array : array + 2] = order[array : array + 2][::-1]
    flags, result = ordered(device, 1, keys, np.full(n, 9, np.uint32), order)
    assert flags == (False, False)
    np.testing.assert_array_equal(result, origins)


@pytest.mark.parametrize(
    "location", [0, 1, MAX_TIED_KEYS - 1, MAX_TIED_KEYS, 2 * MAX_TIED_KEYS, 299]
)
@pytest.mark.parametrize("walk", [4, 64])
def test_long_ties_out_of_order_are_announced(device: Device, walk: int, location: int) -> None:
    """Wherever in the tie two are the wrong way around; one that is in order is no trouble."""
    before, n = 37, 301
    keys = np.append(np.arange(before), np.full(n, 50)).astype(np.uint32)
    order = origins = np.arange(len(keys), dtype=np.uint32)
    same, increasing = np.full(len(keys), 9, np.uint32), order + 5
    for lows in (same, increasing):
        flags, result = ordered(device, walk, keys, lows, order, origins)
        assert flags == (False, False)
        np.testing.assert_array_equal(result, order)
    swapped = order.copy()
    swapped[before + location : before + location + 2] = swapped[
        before + location : before + location + 2
    ][::-1]
    assert ordered(device, walk, keys, swapped, order)[0] == (True, False)
    assert ordered(device, walk, keys, swapped, order, origins)[0] == (True, False)
    flags, result = ordered(device, walk, keys, same, order, swapped)
    assert flags == (False, True)
    np.testing.assert_array_equal(result, order)  # it is left as it is


@pytest.mark.parametrize("deep", [False, True])
@pytest.mark.parametrize("cut", ["own", "GPU"])
def test_depths_are_sorted(device: Device, deep: bool, cut: str) -> None:
    """As NumPy does, what is not drawn left out; equal depths as they came."""
    chosen: SortConfig = sort_config_for(device) if cut == "own" else GPU
    sort = RadixSort(device, chosen, Scan(device, chosen.block, 64, 256))
    rng, n = np.random.default_rng(1), 20_000
    count = 40 if deep else 5000
    keys = rng.integers(0, count, n, np.uint32) << np.uint32(18)
    lows = rng.integers(0, 1 << 32, n, np.uint32, endpoint=False)
    lows[::3] = 1 << 31
    lows[rng.random(n) < 0.3] = keys[rng.random(n) < 0.3] = NO_ID
    is_absent = (keys == NO_ID) | (lows == NO_ID)
    keys[is_absent] = lows[is_absent] = NO_ID
    counts = filled_buffer(device, counting.initial(n, 0))
    columns = tuple(Columns(*(filled_buffer(device, np.zeros(n)) for _ in "kv")) for _ in "ab")
    device.write(columns[0].keys, keys)
    spare_keys = filled_buffer(device, np.zeros(n)) if deep else None
    steps, offset = DepthOrder(device, chosen, sort).steps(
        n, counts, columns, filled_buffer(device, lows), None, spare_keys
    )
    submit(device, steps)
    message = device.read(counts, np.uint32, 8)
    indices = np.flatnonzero(~is_absent)
    assert message[Counts.VISIBLE] == len(indices)
    assert not message[[Counts.UNSORTED, Counts.TIED]].any()
    result = device.read(offset, np.uint32, len(indices))
    np.testing.assert_array_equal(result, indices[np.lexsort((lows[indices], keys[indices]))])


def test_keys_are_gathered(device: Device) -> None:
    rng = np.random.default_rng(2)
    keys, order = (
        rng.integers(0, NO_ID, 900, np.uint32),
        rng.permutation(900)[:700].astype(np.uint32),
    )
    counts = counting.initial(900, 0)
    counts[Counts.VISIBLE], counts[Counts.SORT_VISIBLE_GROUPS] = 700, 6
    out = filled_buffer(device, np.zeros(900))
    words = [filled_buffer(device, array) for array in (counts, keys, order)]
    submit(device, [GatherKeys(device, 128).step(*words, out)])
    result = device.read(out, np.uint32, 900)
    np.testing.assert_array_equal(result[:700], gather_reference(keys, order))
    assert not result[700:].any()


@pytest.fixture(scope="module")
def quads(device: Device) -> Renderer:
    return Renderer(device, rasteriser="quads")


def confused(scene: Scene, view_camera: Camera) -> bool:
    """Say whether depths as floats, even rounded but once, have another order."""
    rows = [(splat_set, splat_set.data.rows.astype(np.float64)) for splat_set in scene.sets]
    depth = np.concatenate([ellipses(values, row, view_camera).depth for row, values in rows])
    rounded = np.argsort(depth.astype(np.float32), kind="stable")
    return not np.array_equal(rounded, np.argsort(depth, kind="stable"))


@pytest.mark.parametrize("name", NEAR_TIES)
def test_near_ties_are_as_in_float64(renderer: Renderer, quads: Renderer, name: str) -> None:
    scene, view_camera = NEAR_TIES[name]()
    assert confused(scene, view_camera)
    expected = oracle.render(scene, view_camera)
    assert expected.fragile.mean() < 0.1  # or little was compared
    frame = renderer.render(scene, view_camera, outputs=ALL)
    assert np.abs(frame.rgba - expected.rgba)[~expected.fragile].max() <= 2e-5
    firm = ~expected.fragile_median
    np.testing.assert_array_equal(frame.ids[firm], expected.ids[firm])
    assert renderer._has_deep_tiles == (name in DEEP)
    by_quads = quads.render(scene, view_camera).rgba
    open_still = ~expected.fragile & (expected.rgba[..., 3] < 0.99)
    assert open_still.any()
    assert np.abs(by_quads - expected.rgba)[open_still].max() <= 2e-5


@pytest.mark.parametrize("tilt", [2e-5, 1e-7])
def test_near_ties_of_cells_are_as_in_float64(renderer: Renderer, tilt: float) -> None:
    data = celled(200, 3, 1, depth=(4, 4))
    data.cells[:, 2] = 4
    scene = Scene([summed(data, transform=turned(tilt, (1, 2, 0)))])
    depth = ellipses(data.cells.astype(np.float64), scene.sets[0], camera()).depth
    rounded = np.argsort(depth.astype(np.float32), kind="stable")
    assert not np.array_equal(rounded, np.argsort(depth, kind="stable"))
    actual, expected = renderer.render(scene, camera()), oracle.render(scene, camera())
    assert expected.fragile.mean() < 0.1
    assert np.abs(actual.rgba - expected.rgba)[~expected.fragile].max() <= 2e-5
    assert renderer._has_deep_tiles == (tilt < 1e-6)


@pytest.mark.parametrize("name", ["tilted", "tilted_less"])
def test_rows_that_change_stay_in_order(device: Device, name: str) -> None:
    """That a sort must be deep is noticed once, and not in every frame."""
    scene, view_camera = NEAR_TIES[name]()
    own_renderer, data = Renderer(device, rasteriser="tiles"), scene.sets[0].data
    plans = []
    for _ in range(3):
        data.update(rows=data.rows[::-1].copy())
        frame = oracle.render(scene, view_camera)
        actual = own_renderer.render(scene, view_camera).rgba
        assert np.abs(actual - frame.rgba)[~frame.fragile].max() <= 2e-5
        plans.append(own_renderer._plan)
    assert plans[0] is plans[1] is plans[2]
    assert own_renderer._has_deep_tiles == (name in DEEP)


def frames_equal(frame: Frame, two: Frame) -> bool:
    return np.array_equal(frame.rgba, two.rgba) and np.array_equal(frame.depth, two.depth)


@pytest.mark.parametrize("name", ["tilted", "tilted_less", "sphere"])
def test_rows_may_come_in_any_order(renderer: Renderer, name: str) -> None:
    scene, view_camera = NEAR_TIES[name]()
    first = scene.sets[0]
    order = np.random.default_rng(3).permutation(len(first.data))
    other = SplatData(first.data.rows[order], first.data.appearance[order], "rgb")
    mixed = Scene([SplatSet(other, first.transform)])
    frames = [renderer.render(entry, view_camera, outputs=ALL) for entry in (scene, mixed)]
    assert frames_equal(*frames)
    known = frames[1].ids >= 0
    np.testing.assert_array_equal(order[frames[1].ids[known]], frames[0].ids[known])


@pytest.mark.parametrize("name", ["tilted", "tilted_less"])
def test_split_models_sort_as_one(renderer: Renderer, name: str) -> None:
    scene, view_camera = NEAR_TIES[name]()
    entry = scene.sets[0]
    parts = [
        SplatSet(
            SplatData(entry.data.rows[part], entry.data.appearance[part], "rgb"), entry.transform
        )
        for part in (slice(0, 110), slice(110, None))
    ]
    apart = renderer.render(Scene(parts), view_camera, outputs=ALL)
    assert frames_equal(renderer.render(scene, view_camera, outputs=ALL), apart)


@pytest.mark.parametrize("name", ["tilted", "tilted_less"])
def test_arranged_rows_are_in_order(
    device: Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(splat_residency, "MIN_ORDERED_ROWS", 1)
    scene, view_camera = NEAR_TIES[name]()
    own_renderer = Renderer(device, rasteriser="tiles")
    before = own_renderer.render(scene, view_camera, outputs=ALL)
    after = own_renderer.render(scene, view_camera, outputs=ALL)
    assert own_renderer.placed(scene)[0][1].rows_of is not None
    assert frames_equal(before, after)


def test_thousands_at_one_depth_are_sorted(renderer: Renderer) -> None:
    """They stand as they came, and nothing is sorted for them."""
    data = plane(3000, 4, opacity=(0.02, 0.1))
    expected = oracle.render(Scene([data]), camera())
    frame = renderer.render(Scene([data]), camera())
    assert not renderer._has_deep_tiles
    assert np.abs(frame.rgba - expected.rgba)[~expected.fragile].max() <= 1e-4


def test_other_scenes_are_not_sorted_deeply(renderer: Renderer) -> None:
    scene, view_camera = NEAR_TIES["tilted_less"]()
    renderer.render(scene, view_camera)
    assert renderer._has_deep_tiles
    renderer.render(scene, view_camera.scaled(30, 20))
    assert renderer._has_deep_tiles
    renderer.render(*NEAR_TIES["tilted"]())
    assert not renderer._has_deep_tiles
