"""Culling and cuts, compared with points, and with a walk from the root."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion
from gsgen.tiles.format.tileset import Tile, Tileset
from gsgen.tiles.format.volumes import Box, Region, Sphere, ecef
from gsgen.tiles.prediction.poses import Pose, matrix_quaternion
from gsgen.tiles.prediction.prefetch import ViewSettings
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.request_order import request_order
from gsgen.tiles.selection.tile_tree import TileTree
from references.lenses import lens_pixel


def rotation(rng: np.random.Generator) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return turn * np.linalg.det(turn)


def random_boxes(rng: np.random.Generator, count: int):
    half = np.stack([rotation(rng) * rng.uniform(0.05, 1.5, (3, 1)) for _ in range(count)])
    return rng.normal(size=(count, 3)) * 6, half


def inside_frustum(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Whether points are in the image, by projecting them."""
    x, y, z = (points @ camera.view[:3, :3].T + camera.view[:3, 3]).T
    flat = camera.kind == "orthographic"
    depth = np.ones_like(z) if flat else z
    u, v = camera.fx * x + camera.cx * depth, camera.fy * y + camera.cy * depth
    is_in_image = (u >= 0) & (u <= camera.width * depth) & (v >= 0) & (v <= camera.height * depth)
    return is_in_image & (z >= 0)


LENSES = {
    "barrel": ("pinhole", 300.0, {"k1": -0.3, "k2": 0.05}),
    "cushion": ("pinhole", 300.0, {"k1": 0.25, "p1": 0.01, "p2": -0.02}),
    "narrow fisheye": ("fisheye", 200.0, {"k1": -0.02}),
    "wide fisheye": ("fisheye", 60.0, {"k1": -0.02}),
}


@pytest.mark.parametrize("name", LENSES)
def test_no_box_that_a_lens_sees_is_culled(name: str) -> None:
    """Points are projected by OpenCV's formulas; a fisheye of more than half a turn culls nothing."""
    rng = np.random.default_rng(4)
    kind, focal, values = LENSES[name]
    kept_count = actual = 0
    for _ in range(10):
        camera = replace(
            random_camera(rng, "pinhole"),
            kind=kind,
            fx=focal,
            fy=focal,
            distortion=Distortion.of(values),
        )
        center, half = random_boxes(rng, 50)
        points = center[:, None] + np.einsum("nki,nij->nkj", rng.uniform(-1, 1, (50, 100, 3)), half)
        local = points.reshape(-1, 3) @ camera.view[:3, :3].T + camera.view[:3, 3]
        rho, z = np.hypot(local[:, 0], local[:, 1]), local[:, 2]
        radius = np.arctan2(rho, z) if kind == "fisheye" else np.where(z > 0, rho / z, np.inf)
        pixels = np.array([lens_pixel(camera, point) for point in local.tolist()])
        visible = ((pixels >= 0) & (pixels <= [camera.width, camera.height])).all(axis=1)
        visible &= radius < camera.ray_limit
        visible_boxes = visible.reshape(50, 100).any(axis=1)
        is_met = Frustum.from_camera(camera).intersects(center, half)
        assert not (visible_boxes & ~is_met).any()
        kept_count, actual = kept_count + is_met.sum(), actual + visible_boxes.sum()
    assert actual > 20
    assert (kept_count == 500) == (name == "wide fisheye")


def random_camera(rng: np.random.Generator, kind: str) -> Camera:
    camera = Camera.look_at(
        rng.normal(size=3).tolist(), (rng.normal(size=3) * 5).tolist(), width=300, height=200
    )
    return camera if kind == "pinhole" else camera.flattened(8.0)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_no_box_with_a_visible_point_is_culled(kind: str) -> None:
    rng = np.random.default_rng(0)
    kept_count = actual = 0
    for _ in range(40):
        camera = random_camera(rng, kind)
        center, half = random_boxes(rng, 50)
        shares = rng.uniform(-1, 1, (50, 200, 3))
        points = center[:, None] + np.einsum("nki,nij->nkj", shares, half)
        visible = inside_frustum(camera, points.reshape(-1, 3)).reshape(50, 200).any(axis=1)
        is_met = Frustum.from_camera(camera).intersects(center, half)
        assert not (visible & ~is_met).any()
        kept_count += is_met.sum()
        actual += visible.sum()
    assert (
        actual <= kept_count < 1.6 * actual
    )  # it does cull: a test that keeps all would keep 2000


def test_a_box_behind_is_culled_and_one_around_the_camera_is_seen() -> None:
    camera = Camera.look_at([0, 0, 0], [0, 0, 1])
    frustum = Frustum.from_camera(camera)
    center = np.array([[0, 0, -3.0], [0, 0, 0], [0, 0, 3.0]])
    half = np.stack([np.eye(3)] * 3)
    assert frustum.intersects(center, half).tolist() == [False, True, True]
    np.testing.assert_allclose(frustum.distances(center, half), [2, 0, 2])
    pixels = frustum.screen_space_error(np.array([1.0, 1.0, 0.0]), np.array([2.0, 0.0, 0.0]))
    height = camera.height / (2 * 2 * np.tan(np.radians(25)))
    np.testing.assert_allclose(pixels, [height, np.inf, 0.0])


def test_a_pose_is_the_camera_with_that_matrix() -> None:
    rng = np.random.default_rng(1)
    quaternion = rng.normal(size=4)
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    eye = rng.normal(size=3)
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = turn.T, -turn.T @ eye
    focal = 120 / np.tan(np.radians(30))
    camera = Camera(view, fx=focal, fy=focal, cx=200, cy=120, width=400, height=240)
    settings = ViewSettings(width=400, height=240, fov_y=60)
    pose = settings.frustum(Pose(0.0, eye, 3 * quaternion))
    same = Frustum.from_camera(camera)
    np.testing.assert_allclose(pose.planes, same.planes, atol=1e-12)
    np.testing.assert_allclose(pose.eye, same.eye, atol=1e-12)
    assert pose.focal == pytest.approx(same.focal)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_a_placement_moves_the_camera_into_the_root_frame(kind: str) -> None:
    rng = np.random.default_rng(2)
    placement = np.eye(4)
    placement[:3, :3], placement[:3, 3] = rotation(rng) * 2.5, rng.normal(size=3)
    center, half = random_boxes(rng, 400)
    camera = random_camera(rng, kind)
    placed = Frustum.from_camera(camera, placement)
    world = Frustum.from_camera(camera)
    moved = center @ placement[:3, :3].T + placement[:3, 3]
    turned = half @ placement[:3, :3].T
    np.testing.assert_array_equal(placed.intersects(center, half), world.intersects(moved, turned))
    distance = placed.distances(center, half)
    np.testing.assert_allclose(distance * 2.5, world.distances(moved, turned), atol=1e-9)
    error = rng.uniform(0, 1, 400)
    np.testing.assert_allclose(
        placed.screen_space_error(error, distance),
        world.screen_space_error(error * 2.5, distance * 2.5),
    )


def test_distances_are_those_of_the_nearest_of_many_points() -> None:
    rng = np.random.default_rng(3)
    center, half = random_boxes(rng, 30)
    half[0, 1] = 0
    frustum = Frustum.from_camera(random_camera(rng, "pinhole"))
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 3), axis=-1).reshape(-1, 3)
    points = center[:, None] + np.einsum("ki,nij->nkj", grid, half)
    nearest = np.linalg.norm(points - frustum.eye, axis=2).min(axis=1)
    np.testing.assert_allclose(frustum.distances(center, half), nearest, atol=0.1)


def random_tileset(rng: np.random.Generator, depth: int = 4) -> Tileset:
    def tile(center: np.ndarray, side: float, level: int) -> Tile:
        children = ()
        if level < depth:
            offsets = [o for o in np.ndindex(2, 2, 2) if rng.uniform() < 0.6]
            children = tuple(
                tile(center + (np.array(o) - 0.5) * side / 2, side / 2, level + 1) for o in offsets
            )
        return Tile(
            location=f"{level}",
            volume=Box(center, np.eye(3) * side / 2),
            geometric_error=side / 4 if children else 0.0,
            refine="REPLACE",
            transform=np.eye(4),
            children=children,
            level=level,
        )

    return Tileset(
        name="t",
        index="tileset.json",
        version="1.1",
        geometric_error=9.0,
        transform=np.eye(4),
        root=tile(np.zeros(3), 16.0, 0),
    )


def test_a_cut_is_that_of_a_walk_from_the_root() -> None:
    rng = np.random.default_rng(4)
    tree = TileTree.of_tileset(random_tileset(rng))
    assert len(tree) > 200
    index = {id(tile): row for row, tile in enumerate(tree.tiles)}
    for _ in range(20):
        frustum = Frustum.from_camera(random_camera(rng, "pinhole"))
        actual, expected = [], []

        def walk(tile: Tile, frustum=frustum, actual=actual, expected=expected) -> None:
            row = index[id(tile)]
            box = tile.volume
            if not frustum.intersects(box.center[None], box.half_axes[None])[0]:
                return
            actual.append(row)
            axis_distance = np.maximum(np.abs(frustum.eye - box.center) - np.diag(box.half_axes), 0)
            distance = np.linalg.norm(axis_distance)
            error = tile.geometric_error * frustum.focal
            if tile.children and error > 16 * distance:
                for child in tile.children:
                    walk(child)
            else:
                expected.append(row)

        walk(tree.tiles[0])
        cut = cut_tree(tree, frustum, 16.0)
        assert np.flatnonzero(cut.seen).tolist() == sorted(actual)
        assert np.flatnonzero(cut.selected).tolist() == sorted(expected)
        order = request_order(tree, cut).tolist()
        key = {row: (tree.level[row], -cut.error[row], row) for row in actual}
        assert order == sorted(actual, key=key.get)


def test_volumes_of_every_kind_become_boxes_that_hold_them() -> None:
    rng = np.random.default_rng(5)
    sphere = Sphere(rng.normal(size=3), 2.0)
    region = Region(west=0.2, south=0.5, east=0.22, north=0.53, minimum=-5, maximum=300)
    wide_region = Region(west=-2, south=-1, east=2, north=1, minimum=0, maximum=50)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(rng) * 2, rng.normal(size=3) * 100
    globe = np.eye(4)
    globe[:3, :3], globe[:3, 3] = rotation(rng), [4e6, 1e6, 4.7e6]
    for volume in (sphere, region, wide_region):
        tile = Tile(location="", volume=volume, geometric_error=1, refine="ADD", transform=matrix)
        tileset = Tileset(
            name="", index="", version="1.1", geometric_error=1, transform=globe, root=tile
        )
        tree = TileTree.of_tileset(tileset)
        assert tree.error[0] == pytest.approx(2)
        if isinstance(volume, Sphere):
            directions = rng.normal(size=(200, 3))
            directions *= volume.radius / np.linalg.norm(directions, axis=1)[:, None]
            points = (volume.center + directions) @ matrix[:3, :3].T + matrix[:3, 3]
        else:
            points = ecef(
                rng.uniform(volume.west, volume.east, 500),
                rng.uniform(volume.south, volume.north, 500),
                rng.uniform(volume.minimum, volume.maximum, 500),
            )
            points = (points - globe[:3, 3]) @ globe[:3, :3]
        box = Box(tree.center[0], tree.half_axes[0])
        assert box.outside(points).max() < 1e-6


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_a_moved_frustum_is_that_of_the_camera_there(kind: str) -> None:
    rng = np.random.default_rng(6)
    camera = random_camera(rng, kind)
    for _ in range(5):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        turn, eye = rotation_matrix(quaternion[None])[0].T, rng.normal(size=3) * 5
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = turn, -turn @ eye
        reference = Frustum.from_camera(replace(camera, view=view))
        moved = Frustum.from_camera(camera).moved(eye, quaternion)
        np.testing.assert_allclose(moved.planes, reference.planes, atol=1e-9)
        np.testing.assert_allclose(moved.rotation, reference.rotation, atol=1e-9)
        back = matrix_quaternion(turn.T)
        np.testing.assert_allclose(abs(back @ quaternion), 1)
