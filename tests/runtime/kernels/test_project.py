"""Each kernel does what its NumPy twin does."""

import numpy as np
import pytest

from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.project import project
from gsgen.runtime.kernels.project.projections import projection_of
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import NO_ID, source
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from references.projection import Projected, normals_reference, project_reference
from references.tiles import blend_reference, ranges_reference, touched_reference, window_tiles
from support.rendering.splat_scenes import LENSES, SCENES, camera, cloud

NOTHING_BEHIND = np.zeros(3)


def run(renderer: Renderer, scene: Scene, camera: Camera, *stages: str) -> Plan:
    """Run some stages of a frame, and return the plan whose buffers have what they made."""
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, camera, frozenset(["color"]))
    plan.submit(placed, camera, NOTHING_BEHIND, only=stages or None)
    plan.collect()
    return plan


def read_words(renderer: Renderer, plan: Plan, name: str, count: int) -> np.ndarray:
    return renderer.device.read(plan.buffers[name], np.uint32, count)


def floats(renderer: Renderer, plan: Plan, name: str, count: int) -> np.ndarray:
    return read_words(renderer, plan, name, 4 * count).view(np.float32).reshape(count, 4)


def reference(splat_set: SplatSet, camera: Camera) -> Projected:
    frame = project.frame_uniform(camera, NOTHING_BEHIND)
    n = len(splat_set.data)
    page = project.page_uniform(splat_set, camera, 0, n, splat_set.data.count)
    return project_reference(splat_set.data, frame, page, projection_of(camera))


ONE_SET = [
    "many",
    "principal_point_outside",
    "needles",
    "huge",
    "around_the_camera",
    "not_finite",
    "covariances_that_are_none",
    "degree_3",
    "fewer_live_than_rows",
    "antialiased",
    "seen_from_elsewhere",
    "far_from_the_origin",
    "flat_cameras",
    "panorama",
    "panorama_poles",
    "panorama_part",
    *LENSES,
]


@pytest.mark.parametrize("name", ONE_SET)
def test_projected_splats_agree_with_the_reference(renderer: Renderer, name: str) -> None:
    scene, view_camera = SCENES[name]()
    scene = Scene(scene.sets[:1])
    n = len(scene)
    plan = run(renderer, scene, view_camera, "project")
    keys = read_words(renderer, plan, "keys of Gaussians a", n)
    shapes, weights, colors = (
        floats(renderer, plan, part, n) for part in ("shapes", "weights", "colors")
    )
    expected = reference(scene.sets[0], view_camera)
    drawn = keys != NO_ID
    assert drawn.any()
    assert not (drawn & ~expected.drawn).any()
    # What the kernel leaves out beyond that is beside the image.
    origin = project.frame_uniform(view_camera, NOTHING_BEHIND)["origin"]
    for i in np.flatnonzero(expected.drawn & ~drawn):
        around = (expected.mean[i] + origin, expected.conic[i], expected.strength[i] - 1e-4)
        size = (view_camera.width, view_camera.height)
        assert not touched_reference(*around, size, view_camera.period).any()
    np.testing.assert_allclose(keys[drawn].view(np.float32), expected.depth[drawn], rtol=1e-5)
    np.testing.assert_array_equal(weights[drawn, 2], keys[drawn].view(np.float32))
    size = np.abs(expected.mean[drawn]).max() + 1
    np.testing.assert_allclose(shapes[drawn, :2], expected.mean[drawn], atol=2e-6 * size)
    conic = np.column_stack([shapes[drawn, 2:], weights[drawn, 0]])
    largest = np.abs(expected.conic[drawn]).max(axis=1, keepdims=True)
    assert (np.abs(conic - expected.conic[drawn]) <= 1e-4 * largest).all()
    np.testing.assert_allclose(weights[drawn, 1], expected.strength[drawn], atol=1e-5)
    np.testing.assert_allclose(colors[drawn, :3], expected.color[drawn], atol=1e-5)


def tile_renderer(device: Device, lists: bool) -> Renderer:
    """Return a renderer that lists splats by tile, or one that sorts pairs of both, as on GPUs."""
    renderer = Renderer(device, rasteriser="tiles")
    renderer._kernels.lists = lists
    return renderer


@pytest.mark.parametrize("lists", [True, False], ids=["lists", "pairs"])
@pytest.mark.parametrize(
    "name", ["many", "needles", "huge", "principal_point_outside", "panorama_seam", "panorama_huge"]
)
def test_tiles_list_every_splat_that_reaches_them(device: Device, name: str, lists: bool) -> None:
    renderer = tile_renderer(device, lists)
    scene, small = SCENES[name]()
    view_camera = small.scaled(150, 90)
    run(renderer, scene, view_camera)  # the plan may have to be made
    plan = run(renderer, scene, view_camera, "project", "sort", "bin", "group")
    n, tiles = len(scene), 10 * 6
    counts = read_words(renderer, plan, "counts", 4)
    pairs, visible = int(counts[Counts.PAIRS]), int(counts[Counts.VISIBLE])
    assert pairs == counts[Counts.WANTED_PAIRS] > 0
    ranges = read_words(renderer, plan, "ranges", 2 * tiles).reshape(tiles, 2)
    tile_of = np.repeat(np.arange(tiles), ranges[:, 1] - ranges[:, 0])
    assert len(tile_of) == pairs
    # 60 tiles are six bits, which one pass sorts: its result is on the other side.
    name_of_lists = "splats of tiles" if lists else "values of pairs b"
    members = read_words(renderer, plan, name_of_lists, pairs)
    np.testing.assert_array_equal(ranges, ranges_reference(tile_of.astype(np.uint32), tiles))
    shapes, weights = (floats(renderer, plan, part, n) for part in ("shapes", "weights"))
    for first, end in ranges:  # nearest first
        assert (np.diff(weights[members[first:end], 2]) >= 0).all()
    listed = np.zeros((n, tiles), bool)
    listed[members, tile_of] = True
    assert listed.sum() == pairs
    # As many were listed as were counted.
    drawn = listed.any(axis=1)
    if lists:
        both = read_words(renderer, plan, "lows", plan.buffers["lows"].size // 4)
        windows = both[len(both) // 2 :]  # remainders of depths are before them
        for i in np.flatnonzero(drawn):
            rows, columns = np.divmod(np.flatnonzero(listed[i]), 10)
            if windows[i] == NO_ID:  # larger than a window, but for rows that it misses
                assert view_camera.period or np.ptp(rows) > 1 or np.ptp(columns) > 3
            else:
                assert window_tiles(int(windows[i]), 10) == np.flatnonzero(listed[i]).tolist()
    else:
        touched_count = floats(renderer, plan, "colors", n)[:, 3]
        np.testing.assert_array_equal(listed.sum(axis=1)[drawn], touched_count[drawn])
    origin = project.frame_uniform(view_camera, NOTHING_BEHIND)["origin"]
    required_count = 0
    assert drawn.sum() <= visible
    for i in np.flatnonzero(drawn):
        conic = np.float64([shapes[i, 2], shapes[i, 3], weights[i, 0]])
        mean = shapes[i, :2].astype(np.float64) + origin
        strength = float(weights[i, 1])
        required_tiles = touched_reference(mean, conic, strength, (150, 90), view_camera.period)
        assert not (required_tiles.ravel() & ~listed[i]).any()
        required_count += int(required_tiles.sum())
    assert pairs <= 1.1 * required_count + 5  # little is listed for nothing


@pytest.mark.parametrize("name", ["many", "huge", "panorama_seam", "nothing"])
def test_lists_are_those_of_sorted_pairs(device: Device, name: str) -> None:
    """Pictures are the same, bit by bit, and so is what memory is read by 64 or 32 bits."""
    scene, view_camera = SCENES[name]()
    narrow_device = Device(device.raw)
    narrow_device.has_int64 = False
    variants = [tile_renderer(device, True), tile_renderer(device, False), Renderer(narrow_device)]
    frames = [
        variant.render(scene, view_camera, outputs=("color", "depth")) for variant in variants
    ]
    assert (frames[0].visible > 0) == (name != "nothing")
    for other in frames[1:]:
        np.testing.assert_array_equal(frames[0].rgba, other.rgba)
        np.testing.assert_array_equal(frames[0].ids, other.ids)
        assert (other.pairs, other.visible) == (frames[0].pairs, frames[0].visible)


@pytest.mark.parametrize("name", ["many", "huge", "same_depths"])
def test_blended_image_agrees_with_the_reference(renderer: Renderer, name: str) -> None:
    scene, view_camera = SCENES[name]()
    image = renderer.render(scene, view_camera).rgba
    all_splats = reference(scene.sets[0], view_camera)
    order = np.argsort(all_splats.depth.astype(np.float32), kind="stable")
    order = order[all_splats.drawn[order]]
    fields = Projected.__slots__
    splats = Projected(**{field: getattr(all_splats, field)[order] for field in fields})
    origin = project.frame_uniform(view_camera, NOTHING_BEHIND)["origin"]
    expected = blend_reference(splats, origin, (view_camera.width, view_camera.height))
    error = np.abs(image - expected)
    assert np.quantile(error, 0.999) <= 1e-5  # the rest is at thresholds
    assert error.max() <= 5e-3


def test_projected_normals_agree_with_the_reference(renderer: Renderer) -> None:
    scene, view_camera = SCENES["seen_from_elsewhere"]()
    data, n = scene.sets[0].data, len(scene)
    renderer.render(scene, view_camera, outputs=("normal",))
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, view_camera, frozenset(["normal"]))
    plan.submit(placed, view_camera, NOTHING_BEHIND, only=["project"])
    plan.collect()
    actual = floats(renderer, plan, "normals", n)[:, :3]
    drawn = read_words(renderer, plan, "keys of Gaussians a", n) != NO_ID
    turn = view_camera.view[:3, :3]
    upper = data.rows[:, 4:].astype(np.float64)
    sigma = turn @ upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) @ turn.T
    view_positions = data.rows[:, :3] @ turn.T + view_camera.view[:3, 3]
    values = np.linalg.eigvalsh(sigma)
    is_unambiguous = drawn & (values[:, 1] > 1.3 * values[:, 0])
    expected = normals_reference(sigma, view_positions)
    cosine = np.abs((actual * expected).sum(axis=1))  # edge-on, the side is a matter of rounding
    assert is_unambiguous.sum() > 100
    assert cosine[is_unambiguous].min() > 0.9999
    np.testing.assert_allclose(np.linalg.norm(actual[drawn], axis=1), 1, atol=1e-5)


def test_a_shader_is_its_file_with_includes_and_constants() -> None:
    text = source("blend_tiles", COLUMNS=1, QUADS=2, CELLS=2, PICK=False, LAYERS=0)
    assert "//!" not in text
    assert "struct Frame" in text
    assert "const PICK: bool = false;" in text
    assert "const MAX_ALPHA: f32 = 0.99f;" in text
    assert "cell_0" in text
    assert "cell_1" in text
    assert "cell_2" not in text
    assert text.count("struct Frame") == 1


def test_shader_harmonics_agree_with_the_contract(renderer: Renderer) -> None:
    """Each of the sixteen functions by itself, in many directions."""
    data = cloud(16 * 12, 3, degree=3, depth=(3, 6), size=0.01)
    data.appearance[:] = 0
    basis_index = np.arange(len(data)) % 16
    data.appearance[np.arange(len(data)), 3 * basis_index + 1] = 0.25
    plan = run(renderer, Scene([data]), camera(), "project")
    drawn = read_words(renderer, plan, "keys of Gaussians a", len(data)) != NO_ID
    colors = floats(renderer, plan, "colors", len(data))
    toward = data.rows[:, :3] / np.linalg.norm(data.rows[:, :3], axis=1, keepdims=True)
    expected = 0.5 + 0.25 * basis(toward)[np.arange(len(data)), basis_index]
    assert (np.bincount(basis_index[drawn]) >= 8).all()
    np.testing.assert_allclose(colors[drawn, 1], expected[drawn], atol=1e-6)
    np.testing.assert_allclose(colors[drawn, 0], 0.5, atol=1e-6)
