"""Meshes stand among Gaussians: each hides what is behind it, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import wgpu

from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable, SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.project.project import frame_uniform, page_uniform
from gsgen.runtime.kernels.raster.draw_meshes import DrawMeshes
from gsgen.runtime.kernels.raster.mesh_place import PlacedMesh, mesh_rays, mesh_uniform
from gsgen.runtime.kernels.shared.kernel import Step, run
from gsgen.runtime.kernels.shared.shader import NOWHERE, source
from gsgen.runtime.kernels.tiles.blend_tiles import BlendTiles
from gsgen.runtime.oracle import meshes
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import NOTHING
from gsgen.runtime.scene.mesh import Mesh, MeshData
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from references.layers import mesh_reference
from references.projection import Projected, project_reference
from references.tiles import blend_reference
from support.rendering.mesh_scenes import MESH_SCENES, ball, moved, quad, wall
from support.rendering.splat_scenes import camera, cloud, single, turned
from support.rendering.watched_device import watched

BACKGROUND = (0.1, 0.4, 0.7, 0.5)
EVERYTHING = ("color", "depth", "normal")


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-20)))


def compare(scene: Scene, view_camera: Camera, renderer: Renderer) -> None:
    frame = renderer.render(scene, view_camera, background=BACKGROUND, outputs=EVERYTHING)
    expected = oracle.render(scene, view_camera, background=BACKGROUND)
    firm, firm_median = ~expected.fragile, ~expected.fragile_median
    assert firm.mean() > 0.7
    assert decibels(frame.rgba[firm], expected.rgba[firm]) >= 100
    np.testing.assert_allclose(frame.rgba[firm], expected.rgba[firm], atol=1e-4)
    np.testing.assert_allclose(frame.depth[firm], expected.depth[firm], rtol=2e-4)
    np.testing.assert_array_equal(frame.ids[firm_median], expected.ids[firm_median])
    np.testing.assert_allclose(
        frame.median_depth[firm_median], expected.median_depth[firm_median], rtol=1e-4
    )
    covered = firm & (expected.rgba[..., 3] > BACKGROUND[3])
    cosine = (frame.normal * expected.normal).sum(axis=-1)[covered]
    assert np.median(cosine) > 0.999999
    assert np.quantile(cosine, 0.05) > 0.9999


@pytest.mark.parametrize("name", MESH_SCENES)
def test_mesh_scenes_agree_with_the_oracle(renderer: Renderer, name: str) -> None:
    compare(*MESH_SCENES[name](), renderer)


@pytest.mark.parametrize("variant", ["without subgroups", "as on a GPU"])
def test_every_kernel_variant_draws_meshes(device: Device, variant: str) -> None:
    other = Device(device.raw)
    other.subgroups = False
    other.software = variant == "without subgroups"
    compare(*MESH_SCENES["through_the_middle"](), Renderer(other, rasteriser="tiles"))


@pytest.fixture(scope="module")
def quads(device: Device) -> Renderer:
    return Renderer(device, rasteriser="quads")


@pytest.mark.parametrize(
    "name",
    ["through_the_middle", "several", "flat_camera", "alone", "panorama_seam", "panorama_poles"],
)
def test_quads_are_hidden_by_meshes_too(quads: Renderer, name: str) -> None:
    scene, view_camera = MESH_SCENES[name]()
    frame = quads.render(scene, view_camera, background=BACKGROUND, outputs=EVERYTHING)
    expected = oracle.render(scene, view_camera, background=BACKGROUND)
    error = np.where(expected.fragile, 0, np.abs(frame.rgba - expected.rgba).max(axis=-1))
    assert np.quantile(error, 0.9) <= 2e-5
    assert error.max() <= 1e-2  # what finished pixels leave out
    firm = ~expected.fragile
    np.testing.assert_allclose(frame.depth[firm], expected.depth[firm], rtol=2e-4)


def test_splat_is_occluded_only_by_nearer_meshes(renderer: Renderer) -> None:
    splat = single(depth=3.0, opacity=0.9)
    bare = renderer.render(Scene([splat]), camera())
    occluded_frame = renderer.render(
        Scene([splat], meshes=[wall(3.01)]), camera(), outputs=EVERYTHING
    )
    before = renderer.render(Scene([splat], meshes=[wall(2.99)]), camera(), outputs=EVERYTHING)
    middle = (23, 30)
    red = 0.9 * bare.alpha[middle]
    assert occluded_frame.rgba[middle][0] == pytest.approx(
        red + (1 - bare.alpha[middle]) * before.rgba[middle][0], abs=2e-3
    )
    assert occluded_frame.ids[middle] == 0
    assert occluded_frame.median_depth[middle] == pytest.approx(3)
    assert before.ids[middle] == NOTHING
    assert before.median_depth[middle] == pytest.approx(2.99)
    assert before.depth[middle] == pytest.approx(2.99)
    np.testing.assert_allclose(before.normal[middle], [0, 0, -1], atol=1e-6)
    assert occluded_frame.alpha[middle] == before.alpha[middle] == 1


def test_of_equally_near_meshes_the_first_is_seen(renderer: Renderer) -> None:
    first, second = wall(3, seed=1), wall(3, seed=2)
    both = renderer.render(Scene([], meshes=[first, second]), camera())
    frame = renderer.render(Scene([], meshes=[first]), camera())
    assert np.array_equal(both.rgba, frame.rgba)


def test_many_triangles_are_as_two(renderer: Renderer) -> None:
    """More than 65,535 triangles of a plane show what two of it show."""
    side = 200
    location = np.linspace(-1, 1, side)
    x, y = (axis.ravel() for axis in np.meshgrid(location, location))
    points = np.stack([x, y, 3 + 0.4 * x - 0.2 * y], 1)
    colors = np.stack([0.5 + 0.3 * x, 0.5 - 0.4 * y, 0.5 + 0.2 * x + 0.2 * y], 1)
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + 1, a + side], 1), np.stack([a + 1, a + side + 1, a + side], 1)]
    )
    fine = MeshData(points, faces, colors)
    assert len(fine) > 65_535
    ends = np.array([0, side - 1, side * side - 1, side * (side - 1)])
    coarse = MeshData(points[ends], np.array([[0, 1, 2], [0, 2, 3]]), colors[ends])
    splats = cloud(100, 12)
    compare(Scene([splats], meshes=[coarse]), camera(), renderer)
    many_triangles, two = (
        renderer.render(Scene([splats], meshes=[array]), camera()) for array in (fine, coarse)
    )
    edge = oracle.render(Scene([splats], meshes=[coarse]), camera()).fragile
    assert np.abs(many_triangles.rgba - two.rgba)[~edge].max() <= 1e-4


@pytest.mark.parametrize(
    "name",
    ["several", "near_plane", "textured", "flat_camera", "panorama_poles", "panorama_textured"],
)
def test_mesh_kernel_agrees_with_its_reference(renderer: Renderer, name: str) -> None:
    scene, view_camera = MESH_SCENES[name]()
    scene = Scene([], color_space=scene.color_space, meshes=scene.meshes)
    frame = renderer.render(scene, view_camera, outputs=EVERYTHING)
    size = (view_camera.width, view_camera.height)
    best = np.full((*size[::-1], 8), NOWHERE)
    for placed in renderer.placed_meshes(scene):
        location = mesh_uniform(placed, view_camera)
        result = mesh_reference(placed.mesh.data, location, mesh_rays(view_camera))
        best = np.where(result[..., 7:] < best[..., 7:], result, best)
    reference = best[..., 7] < NOWHERE
    edge = oracle.render(scene, view_camera).fragile
    assert (reference == (frame.alpha == 1))[~edge].all()
    np.testing.assert_allclose(
        frame.rgba[reference & ~edge][:, :3], best[reference & ~edge][:, :3], atol=2e-5
    )
    np.testing.assert_allclose(
        frame.depth[reference & ~edge], best[reference & ~edge][:, 7], rtol=1e-4
    )
    normal = best[reference & ~edge][:, 4:7] @ view_camera.view[:3, :3]
    np.testing.assert_allclose(frame.normal[reference & ~edge], normal, atol=2e-3)


@pytest.mark.parametrize("variant", ["as it is", "without subgroups", "as on a GPU"])
def test_two_mesh_layers_agree_with_the_reference(device: Device, variant: str) -> None:
    """A translucent layer that leans, before an opaque one that is not everywhere."""
    other = Device(device.raw)
    if variant != "as it is":
        other.subgroups, other.software = False, variant == "without subgroups"
    renderer, view_camera = Renderer(other, rasteriser="tiles"), camera()
    scene = Scene([cloud(250, 15)])
    image = renderer.render(scene, view_camera).rgba
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, view_camera, frozenset(["color"]))
    rng = np.random.default_rng(16)
    shown = rng.uniform(size=(2, 47, 61, 4)).astype(np.float32)
    depths = np.stack([np.linspace(2.5, 6, 61 * 47).reshape(47, 61), np.full((47, 61), 6.5)])
    depths[:, :9] = np.inf
    depths[1, :, 40:] = NOWHERE
    shown[1, ..., 3] = 1
    shown[depths >= NOWHERE] = 0
    depths = depths.astype(np.float32)
    buffers = [other.storage("layers", shown.nbytes), other.storage("depths", depths.nbytes)]
    for buffer, values in zip(buffers, (shown, depths), strict=True):
        other.write(buffer, values)
    tile = renderer._kernels.sort_config.tile
    records = renderer._kernels.records(250)
    kernel = BlendTiles(other, pick=False, layers=2, tile=tile, records=records).kernel
    (own,) = plan.stages["blend"][0].bind_groups
    step = Step(kernel, (own, kernel.bind(*buffers, group=1)), plan.stages["blend"][0].groups)
    encoder = other.raw.create_command_encoder()
    run(encoder, [step], "layers")
    other.raw.queue.submit([encoder.finish()])
    actual = other.read(plan.images["color"], np.float32, image.size).reshape(image.shape)
    frame = frame_uniform(view_camera, np.zeros(3))
    page = page_uniform(scene.sets[0], view_camera, 0, 250, 250)
    splats = project_reference(scene.sets[0].data, frame, page)
    order = np.argsort(splats.depth.astype(np.float32), kind="stable")
    order = order[splats.drawn[order]]
    splats = Projected(**{field: getattr(splats, field)[order] for field in Projected.__slots__})
    expected = blend_reference(
        splats, frame["origin"], (61, 47), list(zip(shown, depths, strict=True))
    )
    error = np.abs(actual - expected)
    assert np.quantile(error, 0.998) <= 1e-5  # the rest is at thresholds
    assert error.max() <= 2e-2
    assert np.abs(expected - image).max() > 0.5


@pytest.mark.parametrize("subgroups", [False, True])
def test_without_layers_the_shader_binds_and_computes_nothing_of_them(
    renderer: Renderer, subgroups: bool
) -> None:
    """A pipeline of one bind group is refused where an entry point uses a second one."""
    other = Device(renderer.device.raw)
    other.subgroups = subgroups and other.subgroups
    kernel = BlendTiles(other, pick=False).kernel
    assert len(kernel.layouts) == 1
    name = "blend_subgroups" if subgroups else "blend_tiles"
    constants = {"COLUMNS": 1, "QUADS": 2, "CELLS": 2, "LANES": 16, "PICK": False}
    assert "layer_0" not in source(name, **constants, LAYERS=0)
    text = source(name, **constants, LAYERS=2)
    assert "layer_1_1" in text
    assert "layer_2" not in text
    assert "//!" not in text


def test_a_moving_mesh_makes_no_buffer_and_no_bind_group(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    splats, shape = cloud(50, 13), ball()
    renderer.render(Scene([splats], meshes=[shape]), camera())
    result = watched(renderer.device, monkeypatch)
    for step in range(3):
        mesh = Mesh(shape, moved(0.1 * step, 0, 4))
        shape.update(shape.vertices * np.float32(0.9))
        renderer.render(Scene([splats], meshes=[mesh]), camera())
    assert result == []


def test_vertices_may_move(renderer: Renderer) -> None:
    shape, other = wall(4), wall(3, 0.5)
    scene = Scene([cloud(60, 17)], meshes=[shape])
    before = renderer.render(scene, camera())
    shape.update(other.vertices)
    after = renderer.render(scene, camera())
    assert not np.array_equal(before.rgba, after.rgba)
    fresh = MeshData(other.vertices, shape.faces, shape.colors)
    frame = renderer.render(Scene([scene.sets[0]], meshes=[fresh]), camera())
    assert np.array_equal(after.rgba, frame.rgba)
    with pytest.raises(SceneInvalid, match=r"vertices: is float32 \[3, 3\], expected .* \[4, 3\]"):
        shape.update(other.vertices[:3])


def test_added_and_removed_meshes_are_drawn_correctly(renderer: Renderer) -> None:
    splats = cloud(60, 14)
    without_mesh = renderer.render(Scene([splats]), camera())
    renderer.render(Scene([splats], meshes=[wall(4)]), camera())
    again = renderer.render(Scene([splats]), camera())
    assert np.array_equal(without_mesh.rgba, again.rgba)


def test_nothing_shows_through_a_panorama_s_joints(renderer: Renderer) -> None:
    """Rooms around the eye have no holes, where corners meet pixels' centres, either."""
    places = [(0, 0, 0), (0.37, -0.21, 0.53), (0, 0.9, 0), (0.001, -0.98, 0.0001)]
    ends = np.concatenate([np.eye(3), -np.eye(3)])  # each straight at a pixel, or at a pole
    sides = [[x, y, z] for x in (0, 3) for y in (1, 4) for z in (2, 5)]
    for shape in (MeshData(ends, np.array(sides)), ball(30, 45), ball(16, 33)):
        room = Mesh(shape, np.diag([1.7, 1.9, 1.8, 1]))
        for path in places:
            for width, height in ((33, 17), (128, 64)):
                view_camera = Camera.panorama(path, width=width, height=height)
                frame = renderer.render(Scene([], meshes=[room]), view_camera)
                assert (frame.alpha == 1).all(), (len(shape), path, width)


def test_a_panorama_s_mesh_is_where_a_splat_of_the_same_place_is(renderer: Renderer) -> None:
    """In all directions, a small triangle around a direction hides the splat just behind it."""
    rng = np.random.default_rng(30)
    for toward in [*rng.normal(size=(6, 3)), (0, 0, -1), (0, 1, 0), (0, -1, 0)]:
        ahead = np.array(toward) / np.linalg.norm(toward)
        side = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))])
        up = np.cross(ahead, side)
        corners = 3 * ahead + np.stack([side - up, up, -side - up]) * 1.5
        shape = MeshData(corners, FACE, np.full((3, 3), 0.25))
        rows = np.zeros((1, 10), np.float32)
        rows[0, 3], rows[0, [4, 7, 9]] = 0.9, 0.01
        for distance, hidden in ((3.05, True), (2.95, False)):
            rows[0, :3] = distance * ahead
            splat = SplatData(rows, np.ones((1, 3), np.float32), "rgb")
            view_camera = Camera.panorama((0, 0, 0), width=96)
            frame = renderer.render(Scene([splat], meshes=[shape]), view_camera)
            assert frame.alpha.max() == 1
            brightest = frame.rgba[..., :3].max()
            assert brightest == pytest.approx(0.25) if hidden else brightest > 0.5


def test_plans_know_a_mesh_all_around_from_one_ahead(renderer: Renderer) -> None:
    scene, around = MESH_SCENES["panorama_poles"]()
    ahead = camera(width=around.width, height=around.height)
    first = renderer.render(scene, around).rgba
    renderer.render(scene, ahead)
    assert np.array_equal(renderer.render(scene, around).rgba, first)


def test_slivers_have_the_colours_of_their_pixels(renderer: Renderer) -> None:
    """Triangles in planes that almost pass through the eye, with corners near and far."""
    rng = np.random.default_rng(0)
    upright = rng.normal(size=(40, 1, 3))
    upright /= np.linalg.norm(upright, axis=-1, keepdims=True)
    pixel, depth = (rng.uniform(0, (160, 120), (40, 3, 2)), np.exp(rng.uniform(0, 3, (40, 3))))
    view_camera = Camera(np.eye(4), fx=100.0, fy=100.0, cx=80.0, cy=60.0, width=160, height=120)
    points = np.concatenate([(pixel - (80, 60)) / 100, np.ones((40, 3, 1))], -1)
    points *= depth[..., None]
    apart = rng.choice([0.003, 0.01, 0.03], (40, 1, 1))
    points -= ((points * upright).sum(-1, keepdims=True) - apart) * upright
    colors = rng.uniform(size=(120, 3))
    shape = MeshData(points.reshape(-1, 3), np.arange(120).reshape(40, 3), colors)
    for kind in (view_camera, view_camera.panorama_around(96, 48)):
        expected = meshes.cast_rays([Mesh(shape)], kind, "srgb")
        frame = renderer.render(Scene([], meshes=[shape]), kind, outputs=EVERYTHING)
        firm = ~expected.fragile & np.isfinite(expected.depth)
        assert firm.sum() > 40
        assert np.abs(frame.rgba[firm][:, :3] - expected.color[firm]).max() <= 3e-5
        np.testing.assert_allclose(frame.depth[firm], expected.depth[firm], rtol=3e-4)


def test_triangles_from_near_plane_to_horizon_are_drawn(renderer: Renderer) -> None:
    """Each has corners at distances from 0.05 to 1000, so that boxes and planes need all digits."""
    near_triangle = [[3.57, 6.75, 35.87], [-433.0, -157.85, -1219.35], [0.124, -0.06, 0.604]]
    ahead = camera(fx=25.0, fy=25.0)
    around = Camera.panorama((0, 0, 0), width=44)
    seen_at_all = 0
    for seed in range(16):
        rng = np.random.default_rng(seed)
        points = rng.normal(size=(3, 3)) * np.exp(rng.uniform(-3, 7, (3, 1)))
        shape = MeshData(np.array(near_triangle) if seed == 0 else points, FACE, np.eye(3))
        for view_camera in (ahead, around):
            expected = meshes.cast_rays([Mesh(shape)], view_camera, "srgb")
            frame = renderer.render(Scene([], meshes=[shape]), view_camera, outputs=EVERYTHING)
            reference, firm = np.isfinite(expected.depth), ~expected.fragile
            assert ((frame.alpha == 1) == reference)[firm].all(), seed
            is_covered = reference & firm
            seen_at_all += is_covered.any()
            np.testing.assert_allclose(
                frame.depth[is_covered], expected.depth[is_covered], rtol=1e-4
            )
            np.testing.assert_allclose(
                frame.rgba[is_covered][:, :3], expected.color[is_covered], atol=1e-4
            )
    assert seen_at_all > 10


@pytest.mark.parametrize("around", [False, True])
def test_a_floor_to_the_horizon_is_as_far_as_it_should_be(renderer: Renderer, around: bool) -> None:
    """Corners are kilometres away; the floor under the eye is not."""
    floor_mesh = quad([[-9e3, 1, -9e3], [9e3, 1, -8e3], [9e3, 1, 9e3], [-8e3, 1, 9e3]])
    view_camera = camera().panorama_around(64, 32) if around else camera(fx=20.0, fy=20.0)
    placed = Mesh(floor_mesh, turned(0.6, (1, 2, 3)))
    view = view_camera.view @ turned(0.6, (1, 2, 3)).T
    frame = renderer.render(
        Scene([], meshes=[placed]), replace(view_camera, view=view), outputs=("depth",)
    )
    rays = mesh_rays(view_camera).astype(float)[view_camera.width :]
    down = rays[:, 0]  # of the direction; the floor is one unit below
    reference = down > 0.03
    expected = np.broadcast_to(1 / down[reference, None], frame.depth[reference].shape)
    np.testing.assert_allclose(frame.depth[reference], expected, rtol=2e-5)


def test_oversized_texture_is_refused(renderer: Renderer) -> None:
    most = int(renderer.device.raw.limits["max-texture-dimension-2d"])
    shape = wall(3)
    uv = np.zeros((4, 2), np.float32)
    mesh_data = MeshData(
        shape.vertices, shape.faces, uv=uv, texture=np.zeros((1, most + 1, 3), np.uint8)
    )
    with pytest.raises(CapacityExceeded, match=f"mesh texture: is {most + 1}×1"):
        renderer.render(Scene([], meshes=[mesh_data]), camera())


@pytest.mark.parametrize("known", [True, False])
def test_a_device_without_textures_of_floats_says_so(
    device: Device, monkeypatch: pytest.MonkeyPatch, known: bool
) -> None:
    """What else is wrong stays what it is."""
    reason = "Format Rgba32Float is not renderable" if known else "another bug"

    def refuse(self: object, **parts: object) -> None:
        raise wgpu.GPUValidationError(f"Color state [0] is invalid\n  {reason}")

    # A fake of a device that renders to no floats, as Mesa's OpenGL: by the words of wgpu.
    monkeypatch.setattr(type(device.raw), "create_render_pipeline", refuse)
    monkeypatch.setattr(device, "render_pipelines", {})
    expected_message = (
        (DeviceUnavailable, "cannot render to textures .* which meshes need")
        if known
        else (wgpu.GPUError, reason)
    )
    with pytest.raises(expected_message[0], match=expected_message[1]):
        DrawMeshes(device)


POINTS = np.eye(3, dtype=np.float32)
FACE = np.array([[0, 1, 2]])


def _with_nan() -> np.ndarray:
    copy = POINTS.copy()
    copy[1, 2] = np.nan
    return copy


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: MeshData(_with_nan(), FACE), r"vertices: 1 of 3 rows .* row 1 is .*nan"),
        (lambda: MeshData(np.full((3, 3), np.inf), FACE), "vertices: 3 of 3 rows are not finite"),
        (lambda: MeshData(POINTS[:, :2], FACE), r"vertices: is float32 \[3, 2\], expected"),
        (lambda: MeshData(POINTS, FACE + 1), r"row 0 is \[1, 2, 3\], expected indices of 3 vert"),
        (lambda: MeshData(POINTS, FACE - 1), r"row 0 is \[-1, 0, 1\]"),
        (lambda: MeshData(POINTS, FACE / 1), r"faces: is float64 \[1, 3\], expected integers"),
        (lambda: MeshData(POINTS, FACE, POINTS[:2]), r"colors: is float32 \[2, 3\]"),
        (lambda: MeshData(POINTS, FACE, uv=POINTS[:, :2]), "texture: is None, expected both"),
        (
            lambda: MeshData(POINTS, FACE, texture=np.zeros((1, 1, 3), np.uint8)),
            "uv: is None, expected both",
        ),
        (
            lambda: MeshData(POINTS, FACE, uv=POINTS[:, :2], texture=np.zeros((1, 1, 3))),
            r"texture: is float64 \[1, 1, 3\], expected uint8",
        ),
        (lambda: MeshData(POINTS, FACE, color_space="rgb"), "color_space: is 'rgb'"),
        (lambda: Mesh(wall(1), np.diag([1.0, 0, 1, 1])), "is singular"),
        (lambda: Mesh(wall(1), shading="phong"), "shading: is 'phong', expected unlit or"),
    ],
)
def test_undrawable_meshes_are_refused(make: object, match: str) -> None:
    with pytest.raises(SceneInvalid, match=match):
        make()


def test_a_mesh_keeps_what_it_is_given() -> None:
    bytes_of_colors = np.array([[255, 0, 51, 7]] * 3, np.uint8)
    data = MeshData(POINTS, FACE, bytes_of_colors)
    np.testing.assert_allclose(data.colors, [[1, 0, 0.2]] * 3)
    assert len(data) == 1
    turn = turned(0.3, (0, 1, 0))
    mesh = Mesh(data, moved(1, 0, 0)).placed(turn)
    np.testing.assert_allclose(mesh.transform, turn @ moved(1, 0, 0))
    assert replace(mesh, shading="headlight").data is data
    assert PlacedMesh.__slots__ == ("mesh", "buffers", "color_space")
