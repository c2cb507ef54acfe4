"""Several sets are one scene, whatever their order, their pages and their transforms."""

import numpy as np
import pytest

from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.splat_scenes import camera, cloud, single, turned
from support.rendering.watched_device import watched
from support.splat_files import scene


def merged(*parts: SplatData) -> SplatData:
    rows = np.concatenate([part.rows for part in parts])
    return SplatData(rows, np.concatenate([p.appearance for p in parts]), parts[0].space)


def test_separate_sets_render_as_one(renderer: Renderer) -> None:
    parts = [cloud(n, seed, degree=3) for seed, n in enumerate((100, 1, 0, 63, 200))]
    apart = renderer.render(Scene(parts), camera())
    combined_frame = renderer.render(Scene([merged(*parts)]), camera())
    assert np.array_equal(apart.rgba, combined_frame.rgba)


def test_the_order_of_rows_does_not_matter(renderer: Renderer) -> None:
    data = cloud(400, 3, degree=1)
    shuffled = np.random.default_rng(0).permutation(400)
    other = SplatData(data.rows[shuffled], data.appearance[shuffled], "sh")
    first, two = (renderer.render(Scene([array]), camera()) for array in (data, other))
    assert np.array_equal(first.rgba, two.rgba)


def test_a_transform_moves_positions_covariances_and_harmonics(renderer: Renderer) -> None:
    """The same as Gaussians that were moved, and whose harmonics were rotated, by NumPy."""
    data = cloud(150, 5, degree=3)
    turn = turned(0.9, (0.1, -0.2, 1), 1.3)
    turn[:3, 3] = 0.2, -0.3, 0.8
    matrix = turn[:3, :3]
    rotation = matrix / 1.3
    rows = data.rows.astype(np.float64)
    rows[:, :3] = rows[:, :3] @ matrix.T + turn[:3, 3]
    full = matrix @ symmetric(data.rows[:, 4:]) @ matrix.T
    rows[:, 4:] = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    # Rotated harmonics: new coefficients that give in direction d what the old gave in Qᵀd.
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    change = np.linalg.lstsq(basis(directions), basis(directions @ rotation), rcond=None)[0]
    sh = np.einsum("ij,njc->nic", change, data.appearance.reshape(150, 16, 3))
    moved = SplatData(rows.astype(np.float32), sh.reshape(150, 48).astype(np.float32), "sh")
    frame = renderer.render(Scene([SplatSet(data, turn)]), camera())
    expected = renderer.render(Scene([moved]), camera())
    assert expected.alpha.mean() > 0.1
    assert np.abs(frame.rgba - expected.rgba).max() <= 5e-5


def test_one_model_in_two_places_is_on_the_device_once(device: Device) -> None:
    residency = Residency(device)
    data = cloud(10)
    assert residency.pages(data) is residency.pages(data)


def test_paging_does_not_change_the_picture(device: Device, renderer: Renderer) -> None:
    data = cloud(300, 6, degree=3)
    small = Renderer(device, rasteriser="tiles", page_rows=64)
    first, two = (entry.render(Scene([data]), camera()) for entry in (renderer, small))
    assert np.array_equal(first.rgba, two.rgba)
    fewer_rows_scene = Scene([SplatData(data.rows, data.appearance, "sh", count=70)])
    first, two = (entry.render(fewer_rows_scene, camera()) for entry in (renderer, small))
    assert np.array_equal(first.rgba, two.rgba)


def test_compact_colours_are_nearly_the_same(device: Device, renderer: Renderer) -> None:
    small = Renderer(device, rasteriser="tiles", compact=True)
    for degree in (None, 1, 2, 3):
        scene = Scene([cloud(200, 50, degree=degree)])
        exact, compact = (entry.render(scene, camera()).rgba for entry in (renderer, small))
        assert 0 < np.abs(exact - compact).max() < 1e-3


def test_values_may_change_and_buffers_stay(renderer: Renderer) -> None:
    first, second = cloud(100, 7), cloud(100, 8)
    data = SplatData(first.rows, first.appearance, "rgb")
    before = renderer.render(Scene([data]), camera())
    data.update(second.rows, second.appearance)
    after = renderer.render(Scene([data]), camera())
    assert not np.array_equal(before.rgba, after.rgba)
    assert np.array_equal(after.rgba, renderer.render(Scene([second]), camera()).rgba)
    data.update(second.rows, second.appearance, count=0)
    assert renderer.render(Scene([data]), camera()).visible == 0
    with pytest.raises(SceneInvalid, match=r"\[99, 10\], expected float32 \[100, 10\], as before"):
        data.update(second.rows[:99], second.appearance[:99])


def test_a_steady_state_makes_no_buffer_and_no_bind_group(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = cloud(100, 9)
    transform = np.eye(4)
    renderer.render(Scene([data]), camera())
    result = watched(renderer.device, monkeypatch)
    for step in range(3):
        transform[0, 3] = 0.1 * step
        data.update(data.rows + np.float32(0.01), data.appearance)
        renderer.render(Scene([SplatSet(data, transform)]), camera(cx=20.0 + step))
    assert result == []


def test_undrawable_sets_are_refused() -> None:
    data = single()
    flat = np.diag([1.0, 1, 0, 1])
    with pytest.raises(SceneInvalid, match="is singular: it scales by 1, 1, 0"):
        SplatSet(data, flat)
    with pytest.raises(SceneInvalid, match="expected 0 0 0 1"):
        SplatSet(data, np.ones((4, 4)))
    with pytest.raises(SceneInvalid, match="finite"):
        SplatSet(data, np.full((4, 4), np.nan))
    with pytest.raises(SceneInvalid, match="opacity_scale: is -1"):
        SplatSet(data, opacity_scale=-1)
    with pytest.raises(SceneInvalid, match="degree: is 4, expected 0 to 3"):
        SplatSet(data, degree=4)
    with pytest.raises(SceneInvalid, match="expected classic or mip"):
        SplatSet(data, antialias="none")


def test_undrawable_rows_are_refused() -> None:
    rows, color = single().rows, single().appearance
    with pytest.raises(SceneInvalid, match=r"rows: is float64 \[1, 10\]"):
        SplatData(rows.astype(np.float64), color, "rgb")
    with pytest.raises(SceneInvalid, match=r"appearance: is float32 \[1, 2\], expected .* 3, 12"):
        SplatData(rows, color[:, :2], "sh")
    with pytest.raises(SceneInvalid, match="count: is 2, expected 0 to 1"):
        SplatData(rows, color, "rgb", count=2)


@pytest.mark.parametrize("entry", ["garden.ply", 7, scene(3, 0)])
def test_a_set_of_another_type_is_refused(entry: object) -> None:
    with pytest.raises(SceneInvalid, match=f"type {type(entry).__name__}, expected SplatData"):
        Scene([entry])  # type: ignore[list-item]


def test_a_renderer_draws_scenes_alone(renderer: Renderer) -> None:
    with pytest.raises(SceneInvalid, match="type str, expected a Scene"):
        renderer.render("garden.ply", camera())  # type: ignore[arg-type]
