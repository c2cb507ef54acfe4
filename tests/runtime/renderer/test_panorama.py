"""Panoramas: where directions are, what crosses the seam, what happens at the poles."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.geometry import symmetric
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.kernels.project.project import frame_uniform, page_uniform
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.sdk.binding.camera_inputs import camera_values
from references.projection import project_reference
from support.rendering.splat_scenes import SCENES, cloud

WIDTH, HEIGHT = 128, 64


def ball(direction: object, distance: float = 3.0, size: float = 0.03) -> SplatData:
    """One Gaussian in a direction; x right, y down, z ahead."""
    row = np.zeros((1, 10), np.float32)
    toward = np.asarray(direction, float)
    row[0, :3] = toward / np.linalg.norm(toward) * distance
    row[0, 3], row[0, [4, 7, 9]] = 0.9, (size * distance) ** 2
    return SplatData(row, np.array([[1.0, 0.5, 0.25]], np.float32), "rgb")


def center_of(alpha: np.ndarray) -> tuple[float, float]:
    """The centre of what is covered, around the image the shorter way."""
    rows, columns = np.indices(alpha.shape) + 0.5
    turn = 2j * np.pi / alpha.shape[1]
    x = np.angle((alpha * np.exp(columns * turn)).sum()) / turn.imag % alpha.shape[1]
    return float(x), float((alpha * rows).sum() / alpha.sum())


@pytest.mark.parametrize(
    ("direction", "x", "y"),
    [
        ((0, 0, 1), 64, 32),
        ((1, 0, 0), 96, 32),
        ((-1, 0, 0), 32, 32),
        ((0, 0, -1), 0, 32),
        ((0, -1, 1), 64, 16),
        ((1, np.sqrt(2), 1), 80, 48),
    ],
)
def test_directions_map_to_expected_pixels(
    renderer: Renderer, direction: object, x: float, y: float
) -> None:
    camera = Camera.panorama((0, 0, 0), width=WIDTH)
    actual = center_of(renderer.render(Scene([ball(direction)]), camera).alpha)
    away = abs(actual[0] - x)
    assert min(away, WIDTH - away) < 0.05
    assert actual[1] == pytest.approx(
        y, abs=0.15
    )  # away from the equator, shapes are not symmetric


def test_a_camera_is_placed_and_level() -> None:
    camera = Camera.panorama((1, 2, 3), (1, 1, 5), up=(0, 0, 1), width=40)
    np.testing.assert_allclose(camera.eye, [1, 2, 3])
    np.testing.assert_allclose(camera.view[1, :3], [0, 0, -1], atol=1e-12)  # down
    np.testing.assert_allclose(camera.view[2, :3], np.array([1, 1, 0]) / np.sqrt(2), atol=1e-12)
    assert (camera.width, camera.height) == (40, 20)
    part = Camera.panorama((0, 0, 0), longitudes=(-30, 60), latitudes=(-10, 20), width=90)
    assert (part.height, part.cx, part.cy) == (30, pytest.approx(30), pytest.approx(20))
    again = Camera.from_json(part.to_json())
    assert (again.kind, again.fx) == ("panorama", part.fx)
    half = camera.scaled(20, 10)
    assert half.period == pytest.approx(20)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"longitudes": (-180, 181)}, "longitudes: are -180 to 181 degrees.* 360 apart"),
        ({"latitudes": (10, 10)}, "latitudes: are 10 to 10"),
        ({"latitudes": (-80, 100)}, r"camera\.cy: .*latitudes from -80 to 100 degrees"),
        ({"toward": (0, 3, 0)}, "expected a direction that is not parallel to up"),
        ({"toward": (0, 0, 0)}, r"camera\.toward: is \[0, 0, 0\], expected a direction"),
        ({"width": 0}, r"camera\.width: is 0"),
        ({"height": 0}, r"camera\.height: is 0"),
        ({"near": 0}, r"camera\.near: is 0"),
    ],
)
def test_invalid_panoramas_are_explained(change: dict[str, object], words: str) -> None:
    with pytest.raises(SceneInvalid, match=words):
        Camera.panorama((0, 0, 0), **change)  # type: ignore[arg-type]


def test_more_than_a_turn_is_refused() -> None:
    whole = Camera.panorama((0, 0, 0), width=100)
    with pytest.raises(SceneInvalid, match=r"camera\.fx: .* per turn, but the image is 100 wide"):
        Camera(
            whole.view,
            fx=10,
            fy=whole.fy,
            cx=50,
            cy=whole.cy,
            width=100,
            height=50,
            kind="panorama",
        )
    with pytest.raises(SceneInvalid, match="is panorama, expected pinhole or orthographic"):
        whole.flattened(3)


def test_covariances_are_those_of_the_projection_s_derivative(renderer: Renderer) -> None:
    """Central differences of longitude and latitude, at random places and near the poles."""
    rng = np.random.default_rng(11)
    data = cloud(200, 12, size=0.2)
    toward = rng.normal(size=(200, 3)) * (1, rng.choice([1, 5, 30]), 1)
    data.rows[:, :3] = toward * rng.uniform(0.5, 3, (200, 1))
    camera = Camera.panorama((0.1, 0.2, 0.3), (1, 0, 2), up=(0.2, -1, 0.3), width=400, height=180)
    page = page_uniform(SplatSet(data), camera, 0, 200, 200)
    result = project_reference(data, frame_uniform(camera, np.zeros(3)), page)
    focal = np.array([camera.fx, camera.fy])

    def seen(point: np.ndarray) -> np.ndarray:
        x, y, z = camera.view[:3, :3] @ point + camera.view[:3, 3]
        return focal * [np.arctan2(x, z), np.arcsin(y / np.sqrt(x * x + y * y + z * z))]

    sigma, checked = symmetric(data.rows[:, 4:]), 0
    for number in np.flatnonzero(result.drawn):
        center = data.rows[number, :3].astype(float)
        step = 1e-5 * np.linalg.norm(center - camera.eye)
        ends = [(seen(center + step * entry), seen(center - step * entry)) for entry in np.eye(3)]
        tile_columns = np.stack([high - low for high, low in ends], 1)
        tile_columns[0] -= camera.period * np.round(
            tile_columns[0] / camera.period
        )  # over the seam
        jacobian = tile_columns / (2 * step)
        expected = jacobian @ sigma[number] @ jacobian.T
        xx, xy, yy = result.conic[number]
        actual = np.linalg.inv([[xx, xy], [xy, yy]]) - 0.3 * np.eye(2)
        np.testing.assert_allclose(actual, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
        checked += 1
    assert checked > 150


def test_the_seam_may_be_anywhere(renderer: Renderer) -> None:
    """What a turned camera sees is what the other sees, columns moved along."""
    data = cloud(150, 3, size=0.2)
    data.rows[:, :3] -= (0, 0, 4)
    scene = Scene([data])
    ahead = renderer.render(scene, Camera.panorama((0, 0, 0), (0, 0, 1), width=WIDTH)).rgba
    right = renderer.render(scene, Camera.panorama((0, 0, 0), (1, 0, 0), width=WIDTH)).rgba
    moved = np.abs(np.roll(ahead, -WIDTH // 4, axis=1) - right).max(axis=-1)
    assert ahead[..., 3].max() > 0.9
    assert np.quantile(moved, 0.99) < 1e-4
    assert moved.max() < 5e-3  # a threshold that rounding met


def test_splat_on_the_seam_is_drawn_at_both_edges(renderer: Renderer) -> None:
    camera = Camera.panorama((0, 0, 0), width=WIDTH)
    alpha = renderer.render(Scene([ball((0.02, 0, -1), size=0.1)]), camera).alpha
    assert alpha[32, 0] > 0.75
    assert alpha[32, -1] > 0.75
    assert not alpha[:, WIDTH // 4 : -WIDTH // 4].any()


def test_a_gaussian_at_a_pole_is_seen_all_around(renderer: Renderer) -> None:
    camera = Camera.panorama((0, 0, 0), width=WIDTH)
    for side, row in ((-1, 0), (1, -1)):
        alpha = renderer.render(Scene([ball((0, side, 0), size=0.1)]), camera).alpha
        assert alpha[row].min() > 0.8
        assert not alpha[16:48].any()
    center_offset = np.zeros(3)
    nothing = renderer.render(Scene([ball((1, 0, 0))]), camera)
    assert np.isfinite(nothing.rgba).all()
    at_the_eye = ball((0, 0, 1))
    at_the_eye.rows[:, :3] = center_offset
    assert renderer.render(Scene([at_the_eye]), camera).visible == 0


def test_near_and_depth_are_distances(renderer: Renderer) -> None:
    scene = Scene([ball((1, 1, -1), distance=2.0)])
    camera = Camera.panorama((0, 0, 0), width=WIDTH)
    frame = renderer.render(scene, camera, outputs=("depth",))
    actual = np.isfinite(frame.median_depth)
    assert actual.any()
    np.testing.assert_allclose(frame.median_depth[actual], 2, rtol=1e-6)
    far = Camera.panorama((0, 0, 0), width=WIDTH, near=2.01)
    assert renderer.render(scene, far).visible == 0


def sample_panorama(image: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """What a full panorama has in the directions of rays, between pixels linearly."""
    height, width = image.shape[:2]
    horizontal = np.arctan2(rays[..., 0], rays[..., 2]) / (2 * np.pi) + 0.5
    down = np.arcsin(rays[..., 1] / np.linalg.norm(rays, axis=-1)) / np.pi + 0.5
    places = np.stack([down * height - 0.5, horizontal * width - 0.5 + width])
    doubled_output = np.concatenate([image, image, image], axis=1)
    return np.stack(
        [
            map_coordinates(doubled_output[..., c], places, order=1, mode="nearest")
            for c in range(4)
        ],
        -1,
    )


def test_small_gaussians_are_where_perspective_cameras_see_them(renderer: Renderer) -> None:
    """The six sides of a cube, and the panorama in the same directions."""
    rng = np.random.default_rng(2)
    toward = rng.normal(size=(3000, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    rows = np.zeros((3000, 10), np.float32)
    rows[:, :3], rows[:, 3], rows[:, [4, 7, 9]] = 4 * toward, 0.7, 0.12**2
    # Colours that change slowly with the direction, so that the order hardly counts.
    data = SplatData(rows, (0.5 + 0.5 * toward).astype(np.float32), "rgb")
    around = renderer.render(Scene([data]), Camera.panorama((0, 0, 0), width=1024)).rgba
    y, x = np.indices((128, 128)) + 0.5
    plane = np.stack([(x - 64) / 64, (y - 64) / 64, np.ones((128, 128))], -1)
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        up = (0, 0, 1) if axis[1] else (0, -1, 0)
        side = Camera.look_at((0, 0, 0), axis, up=up, width=128, height=128, fov_y=90)
        actual = renderer.render(Scene([data]), side).rgba
        rays = plane @ side.view[:3, :3]
        error = np.abs(sample_panorama(around, rays) - actual)
        # Within a few sizes of a Gaussian from a pole the two approximations part.
        level = np.hypot(rays[..., 0], rays[..., 2]) / np.linalg.norm(rays, axis=-1)
        assert np.median(error[level > 0.2]) < 0.01, axis
        assert error[level > 0.2].max() < 0.1, axis


def test_a_panorama_is_large_and_precise(renderer: Renderer) -> None:
    """As wide as cameras can be: a strip of it, on the seam, at the oracle's places."""
    data = cloud(60, 5, size=0.002)
    data.rows[:, [0, 2]] *= -1
    strip = {"latitudes": (-0.4, 0.4), "longitudes": (90.0, 270.0)}
    camera = Camera.panorama((0, 0, 0), width=8192, height=36, **strip)
    scene = Scene([data])
    actual, expected = renderer.render(scene, camera), oracle.render(scene, camera)
    assert expected.visible > 0
    error = np.abs(actual.rgba - expected.rgba).max(axis=-1)
    assert np.where(expected.fragile, 0, error).max() <= 2e-3
    assert -10 * np.log10(np.square(actual.rgba - expected.rgba).mean()) >= 80


def test_plans_know_a_panorama_from_a_picture(renderer: Renderer) -> None:
    scene, around = SCENES["panorama_seam"]()
    ahead = Camera.look_at((0, 0, 0), (0, 0, 1), width=around.width, height=around.height)
    first = renderer.render(scene, around).rgba
    renderer.render(scene, ahead)
    assert np.array_equal(renderer.render(scene, around).rgba, first)


def test_models_hide_nothing_from_a_panorama() -> None:
    """The projection is that of a box: whatever is culled by it is a hundred kilometres away."""
    camera = Camera.panorama((1, 2, 3), width=64)
    projection = camera_values(camera)["projection"]
    for point in np.random.default_rng(0).normal(size=(50, 3)) * 1000:
        x, y, z, w = projection @ camera.view @ [*point, 1]
        assert w == 1
        assert max(abs(x), abs(y)) < 1
        assert 0 < z < 1


class Still:
    """As much of a source as a viewpoint asks for."""

    up = (0.0, 0.0, 1.0)

    def extent(self) -> tuple[np.ndarray, float]:
        return np.array([1.0, 2, 3]), 2.0


def test_camera_options_create_panoramas(tmp_path: Path) -> None:
    source = Still()
    inside = viewpoint(None, width=64, panorama=True).camera(source, 0, 0)
    np.testing.assert_allclose(inside.eye, [1, 2, 3])
    assert (inside.kind, inside.width, inside.height) == ("panorama", 64, 32)
    turned = viewpoint(None, height=32, panorama=True).camera(source, 0, 90)
    assert turned.width == 64
    assert turned.view[2, :3] @ inside.view[2, :3] == pytest.approx(0, abs=1e-9)
    above = viewpoint("orbit:0,90,7", panorama=True).camera(source, 0, 0)
    np.testing.assert_allclose(above.eye, [1, 2, 10], atol=1e-9)
    np.testing.assert_allclose(above.view[1, :3], [0, 0, -1], atol=1e-9)  # still level
    camera = viewpoint("look-at:1,1,1,5,1,4", width=64, panorama=True).camera(source, 0, 0)
    np.testing.assert_allclose(camera.view[2, :3], [1, 0, 0], atol=1e-9)
    file = tmp_path / "camera.json"
    file.write_text(Camera.look_at((1, 2, 3), (4, 5, 9)).to_json())
    unpicked_camera = viewpoint(str(file), panorama=True).camera(source, 0, 0)
    np.testing.assert_allclose(unpicked_camera.view, Camera.from_json(file.read_text()).view)
    assert unpicked_camera.period == pytest.approx(unpicked_camera.width)
    level = viewpoint(str(file), up="+z", panorama=True).camera(source, 0, 0)
    np.testing.assert_allclose(level.eye, [1, 2, 3])
    np.testing.assert_allclose(level.view[1, :3], [0, 0, -1], atol=1e-9)
    with pytest.raises(ConfigInvalid, match="--orthographic and --panorama"):
        viewpoint(None, orthographic=True, panorama=True)
