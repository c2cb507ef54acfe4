"""Small scenes with meshes, each for one thing that a renderer can get wrong."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh, MeshData
from gsgen.runtime.scene.scene import Scene, SplatSet
from support.rendering.splat_scenes import all_around, camera, cloud, turned

MESH_SCENES: dict[str, Callable[[], tuple[Scene, Camera]]] = {}


def named(make: Callable[[], tuple[Scene, Camera]]) -> Callable[[], tuple[Scene, Camera]]:
    MESH_SCENES[make.__name__] = make
    return make


def quad(corners: object, seed: int = 0, **more: object) -> MeshData:
    """Two triangles between four points, with a colour at each."""
    colors = np.random.default_rng(seed).uniform(0.1, 0.9, (4, 3)).astype(np.float32)
    return MeshData(np.array(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]]), colors, **more)


def wall(depth: float, half: float = 1.0, seed: int = 0) -> MeshData:
    """A square that faces the camera."""
    x = half
    return quad([[-x, -x, depth], [x, -x, depth], [x, x, depth], [-x, x, depth]], seed)


def ball(rings: int = 6, spoke_count: int = 9, seed: int = 1) -> MeshData:
    """A sphere of radius 1 around the origin, with random colours."""
    up = np.linspace(0, np.pi, rings + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, spoke_count, endpoint=False)
    points = np.stack(
        np.broadcast_arrays(np.sin(up) * np.cos(around), np.cos(up), np.sin(up) * np.sin(around)),
        -1,
    ).reshape(-1, 3)
    ring, spoke_index = np.divmod(np.arange(rings * spoke_count), spoke_count)
    a, b = ring * spoke_count + spoke_index, ring * spoke_count + (spoke_index + 1) % spoke_count
    faces = np.concatenate(
        [np.stack([a, b, b + spoke_count], 1), np.stack([a, b + spoke_count, a + spoke_count], 1)]
    )
    colors = np.random.default_rng(seed).uniform(0.1, 0.9, (len(points), 3))
    return MeshData(points, faces, colors)  # at the poles some have no area


def moved(x: float, y: float, z: float, turn: np.ndarray | None = None) -> np.ndarray:
    result = np.eye(4) if turn is None else turn.copy()
    result[:3, 3] = x, y, z
    return result


@named
def in_front() -> tuple[Scene, Camera]:
    return Scene([cloud(200, 1)], meshes=[wall(1.9, 0.5)]), camera()


@named
def behind() -> tuple[Scene, Camera]:
    return Scene([cloud(200, 2)], meshes=[wall(8.1, 3)]), camera()


@named
def through_the_middle() -> tuple[Scene, Camera]:
    """Some splats before the wall, some behind it, and the wall leans."""
    leaning = quad([[-3, -2, 3], [3, -2, 6], [3, 2, 7], [-3, 2, 4]])
    return Scene([cloud(300, 3)], meshes=[leaning]), camera()


@named
def several() -> tuple[Scene, Camera]:
    """Balls that cut each other, turned, stretched and mirrored; one is lit."""
    shape = ball()
    meshes = [
        Mesh(shape, moved(-0.4, 0, 4, turned(0.5, (1, 2, 3))), "headlight"),
        Mesh(shape, moved(0.5, 0.2, 4.5, turned(1.0, (0, 1, 0), (1, 0.6, 0.8)))),
        Mesh(ball(seed=2), moved(0, -0.6, 5, np.diag([-1.0, 1, 1, 1])), "headlight"),
    ]
    turn = moved(0.1, 0.2, 0.3, turned(0.3, (0, 0, 1)))
    return Scene([cloud(150, 4), SplatSet(cloud(150, 5, degree=2), turn)], meshes=meshes), camera()


@named
def alone() -> tuple[Scene, Camera]:
    return Scene([], meshes=[Mesh(ball(), moved(0, 0, 3), "headlight")]), camera()


@named
def principal_point() -> tuple[Scene, Camera]:
    scene, _ = several()
    return scene, camera(cx=-4.3, cy=41.7)


@named
def flat_camera() -> tuple[Scene, Camera]:
    scene, _ = several()
    other_view = Camera.look_at((3, -2, -1), (0.2, 0.1, 4.5), width=61, height=47, fov_y=55)
    return scene, other_view.flattened(6.0)


@named
def flat_camera_inside() -> tuple[Scene, Camera]:
    """What is behind an orthographic camera, or nearer than its near plane, is not drawn."""
    scene, _ = several()
    other_view = Camera.look_at((0, 0, 4.2), (0.1, 0, 8), width=61, height=47)
    return scene, replace(other_view.flattened(6.0), near=0.3)


@named
def near_plane() -> tuple[Scene, Camera]:
    """A floor from far behind the camera to far ahead, and a ball around the near plane."""
    floor_mesh = quad([[-9, 0.7, -20], [9, 0.7, -20], [9, 0.7, 40], [-9, 0.7, 40]])
    ring = Mesh(ball(), moved(0.1, -0.3, 0.9, np.diag([0.5, 0.5, 0.5, 1])))
    return Scene([cloud(150, 6)], meshes=[floor_mesh, ring]), replace(camera(), near=0.8)


@named
def inside_a_ball() -> tuple[Scene, Camera]:
    """All faces are seen from behind, and some are beside or behind the camera."""
    room = Mesh(ball(), np.diag([5.0, 5, 5, 1]), "headlight")
    return Scene([cloud(200, 7)], meshes=[room]), camera(fx=20.0, fy=20.0)


@named
def textured() -> tuple[Scene, Camera]:
    picture = np.random.default_rng(8).integers(0, 256, (5, 7, 3), np.uint8)
    uv = np.array([[-0.3, 0], [1.6, 0.1], [1.4, 1.2], [0, 1]], np.float32)
    corners = [[-1.5, -1, 2.5], [1.5, -1, 3.5], [1.5, 1, 4], [-1.5, 1, 3]]
    return Scene([cloud(80, 8)], meshes=[quad(corners, uv=uv, texture=picture)]), camera()


@named
def linear_scene() -> tuple[Scene, Camera]:
    meshes = [Mesh(wall(4, seed=9)), Mesh(ball(), moved(0, 0, 4), "headlight")]
    return Scene([cloud(80, 9)], color_space="linear", meshes=meshes), camera()


@named
def linear_mesh() -> tuple[Scene, Camera]:
    shape = ball()
    data = MeshData(shape.vertices, shape.faces, shape.colors, color_space="linear")
    return Scene([cloud(80, 10)], meshes=[Mesh(data, moved(0, 0, 4), "headlight")]), camera()


@named
def nothing_of_it() -> tuple[Scene, Camera]:
    """A mesh without faces, one without area, and one that is out of view."""
    empty = MeshData(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    points = np.array([[0, 0, 3], [1, 1, 4], [2, 2, 5]], np.float32)
    line = MeshData(points, np.array([[0, 1, 2], [0, 0, 1], [2, 2, 2]]))
    away = Mesh(ball(), moved(0, 0, -5))
    return Scene([cloud(150, 11)], meshes=[empty, line, away]), camera()


@named
def far_from_the_origin() -> tuple[Scene, Camera]:
    """A hundred kilometres away: only differences to the camera count."""
    away = np.array([1e5, -3e4, 7e4])
    scene, here = several()
    sets = [
        SplatSet(splat_set.data, moved(*away) @ splat_set.transform) for splat_set in scene.sets
    ]
    meshes = [mesh.placed(moved(*away)) for mesh in scene.meshes]
    view = np.eye(4)
    view[:3, 3] = -away
    return Scene(sets, meshes=meshes), replace(here, view=view)


@named
def panorama_room() -> tuple[Scene, Camera]:
    """A room around the eye, whose walls some splats are behind, and a ball in it."""
    room = Mesh(ball(4, 6), moved(0.3, 0.2, -0.4, np.diag([3.0, 3, 3, 1])), "headlight")
    inner = Mesh(ball(3, 5, 2), moved(0.5, 0.6, 1.4, np.diag([0.5, 0.5, 0.5, 1])))
    view_camera = Camera.panorama((0, 0, 0), (1, 0, 1), up=(0.1, -1, 0.2), width=64)
    return Scene([all_around(150, 20)], meshes=[room, inner]), view_camera


@named
def panorama_seam() -> tuple[Scene, Camera]:
    """Behind the eye, on both edges of the picture: splats before a leaning wall and behind it."""
    leaning = quad([[-2, -1, -2], [2, -1, -4], [2.5, 1.5, -5], [-2, 1, -2]])
    data = all_around(150, 21, size=0.2)
    data.rows[:, 0] *= 0.3
    data.rows[:, 2] = -np.abs(data.rows[:, 2]) - 0.7
    return Scene([data], meshes=[leaning]), Camera.panorama((0, 0, 0), width=72)


@named
def panorama_poles() -> tuple[Scene, Camera]:
    """A floor and a ceiling that have the poles inside, and small triangles near them."""
    floor_mesh = quad([[-3, 1.2, -2], [3, 1.3, -1], [2, 1, 4], [-3, 1.5, 3]])
    ceiling = MeshData(
        np.array([[-2, -1.5, -2], [3, -1, -1], [0, -2, 4]]),
        np.array([[0, 1, 2]]),
        np.eye(3, dtype=np.float32),
    )
    small = Mesh(ball(3, 4, 3), moved(0.1, -0.7, 0.1, np.diag([0.2, 0.2, 0.2, 1])))
    return Scene([all_around(80, 22)], meshes=[floor_mesh, ceiling, small]), Camera.panorama(
        (0.05, 0.02, 0.03), width=66, height=35
    )


@named
def panorama_around_the_eye() -> tuple[Scene, Camera]:
    """Large triangles that pass close by the eye, with corners on all sides of it."""
    rng = np.random.default_rng(23)
    points = rng.normal(size=(12, 3)) * rng.uniform(0.4, 6, (12, 1))
    colors = rng.uniform(0.1, 0.9, (12, 3))
    data = MeshData(points, np.arange(12).reshape(4, 3), colors)
    near_triangle = quad([[-5, 0.03, -4], [6, 0.02, -5], [5, 0.04, 6], [-4, 0.03, 5]], seed=4)
    far = quad([[-900, 3, -1000], [900, 3, -1000], [900, 3, 1000], [-900, 3, 1000]])
    placed = Mesh(data, moved(0.3, -0.2, 0.1, turned(0.6, (1, 2, 3))), "headlight")
    return Scene([all_around(80, 24)], meshes=[placed, near_triangle, far]), Camera.panorama(
        (0, 0, 0), (1, 0, -1), width=64
    )


@named
def panorama_near() -> tuple[Scene, Camera]:
    """What is nearer than the near distance is not there: a ball is cut open by it."""
    ring = Mesh(ball(4, 7), moved(0.2, 0.3, -0.4, np.diag([1.0, 1, 1, 1])))
    view_camera = Camera.panorama((0, 0, 0), width=64, near=0.8)
    return Scene([all_around(80, 25)], meshes=[ring]), view_camera


@named
def panorama_textured() -> tuple[Scene, Camera]:
    """A texture across the seam, in linear light, far from the origin."""
    picture = np.random.default_rng(26).integers(0, 256, (5, 7, 3), np.uint8)
    uv = np.array([[-0.3, 0], [1.6, 0.1], [1.4, 1.2], [0, 1]], np.float32)
    corners = [[-4, -2, -3], [4, -2, -2], [4, 1, -2], [-4, 2, -4]]
    away = moved(1e4, -3e3, 7e3)
    wall_of_it = Mesh(quad(corners, uv=uv, texture=picture), away, "headlight")
    scene = Scene([SplatSet(all_around(60, 26), away)], color_space="linear", meshes=[wall_of_it])
    return scene, Camera.panorama(away[:3, 3], width=64)


@named
def panorama_part() -> tuple[Scene, Camera]:
    """From over the left shoulder to behind the right one, and up to the pole."""
    part = {"longitudes": (100.0, 250.0), "latitudes": (-30.0, 90.0)}
    room = Mesh(ball(4, 5, 5), np.diag([2.5, 2.5, 2.5, 1]))
    meshes = [room, quad([[-1, -1, -2], [1, -1, -2], [1, 1, -2], [-1, 1, -2]])]
    return Scene([all_around(150, 27)], meshes=meshes), Camera.panorama((0, 0, 0), width=60, **part)
