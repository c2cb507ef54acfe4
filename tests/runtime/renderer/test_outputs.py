"""Depths, ids and normals, and what they are where nothing is."""

import numpy as np
import pytest

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import NOTHING
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.splat_scenes import LENSES, SCENES, camera, cloud, single, turned

EVERYTHING = ("color", "depth", "normal")


@pytest.mark.parametrize(
    "name", ["many", "placed", "flat_cameras", "not_finite", "panorama", *LENSES]
)
def test_all_outputs_agree_with_the_oracle(renderer: Renderer, name: str) -> None:
    scene, camera = SCENES[name]()
    frame = renderer.render(scene, camera, outputs=EVERYTHING)
    expected = oracle.render(scene, camera)
    firm, firm_median = ~expected.fragile, ~expected.fragile_median
    np.testing.assert_allclose(frame.rgba[firm], expected.rgba[firm], atol=2e-5)
    np.testing.assert_allclose(frame.alpha[firm], expected.rgba[..., 3][firm], atol=2e-5)
    np.testing.assert_allclose(frame.depth[firm], expected.depth[firm], rtol=1e-4)
    np.testing.assert_array_equal(frame.ids[firm_median], expected.ids[firm_median])
    np.testing.assert_allclose(
        frame.median_depth[firm_median], expected.median_depth[firm_median], rtol=1e-5
    )
    # A Gaussian whose two short axes are nearly as long has no certain normal.
    cosine = (frame.normal * expected.normal).sum(axis=-1)
    covered = firm & (expected.rgba[..., 3] > 0)
    assert covered.any()
    assert (expected.ids[firm_median] != NOTHING).any()
    assert np.median(cosine[covered]) > 0.999999
    assert np.quantile(cosine[covered], 0.05) > 0.9999
    assert not frame.normal[~covered & firm].any()


def test_empty_scene_has_neutral_outputs(renderer: Renderer) -> None:
    frame = renderer.render(Scene([]), camera(), outputs=EVERYTHING, background=(1, 1, 1, 1))
    assert np.array_equal(frame.rgba, np.ones((47, 61, 4)))
    assert not frame.alpha.any()
    assert np.isposinf(frame.depth).all()
    assert np.isposinf(frame.median_depth).all()
    assert (frame.ids == NOTHING).all()
    assert not frame.normal.any()


def test_only_requested_outputs_are_computed(renderer: Renderer) -> None:
    scene = Scene([single()])
    for outputs in (("depth",), ("normal",)):
        frame = renderer.render(scene, camera(), outputs=outputs, background=(1, 1, 1, 1))
        assert frame.rgba is None
        assert (frame.depth is None) == ("depth" not in outputs)
        assert 0.85 < frame.alpha.max() < 0.91  # the background does not count
        with pytest.raises(ValueError, match="no colours"):
            frame.srgb8  # noqa: B018


def test_a_disk_shows_its_normal_whichever_way_it_is_turned(renderer: Renderer) -> None:
    disk = single(variance=(0.1, 0.1, 1e-5))
    turn = turned(0.6, (1, 0, 0))
    turn[:3, 3] = np.array([0, 0, 3]) - turn[:3, :3] @ [0, 0, 3]
    frame = renderer.render(Scene([SplatSet(disk, turn)]), camera(), outputs=("normal",))
    middle = frame.normal[23, 30]
    np.testing.assert_allclose(middle, -turn[:3, 2], atol=1e-4)
    assert middle[2] < 0  # towards the camera


def test_each_set_has_its_own_normals(renderer: Renderer) -> None:
    """The uniform of the second page is read at the second place."""
    away = np.eye(4)
    away[:3, 3] = 0, 0, -50  # behind the camera
    turn = turned(0.6, (1, 0, 0))
    turn[:3, 3] = np.array([0, 0, 3]) - turn[:3, :3] @ [0, 0, 3]
    disk = single(variance=(0.1, 0.1, 1e-5))
    scene = Scene([SplatSet(disk, away), SplatSet(disk, turn)])
    frame = renderer.render(scene, camera(), outputs=("normal",))
    np.testing.assert_allclose(frame.normal[23, 30], -turn[:3, 2], atol=1e-4)


def test_elongated_splat_normal_is_its_shortest_axis(renderer: Renderer) -> None:
    elongated_splat = single(variance=(0.1, 3e-4, 2.7e-4))
    for angle in np.linspace(0.1, 1.3, 7):
        turn = turned(angle, (1, 0.3, 0.2))
        turn[:3, 3] = np.array([0, 0, 3]) - turn[:3, :3] @ [0, 0, 3]
        scene = Scene([SplatSet(elongated_splat, turn)])
        frame = renderer.render(scene, camera(), outputs=("normal",))
        np.testing.assert_allclose(frame.normal[23, 30], -turn[:3, 2], atol=5e-3)


def test_ids_name_the_set_and_the_row(renderer: Renderer) -> None:
    near, far = single(depth=2), cloud(30, depth=(5, 8))
    scene = Scene([far, near])
    frame = renderer.render(scene, camera(), outputs=("depth",))
    assert scene.locate(int(frame.ids[23, 30])) == (1, 0)
    assert frame.median_depth[23, 30] == pytest.approx(2)
    with pytest.raises(IndexError, match="Gaussian 31 is not in the scene: expected 0 to 30"):
        scene.locate(31)


@pytest.mark.parametrize("outputs", [(), ("colour",)])
def test_unknown_outputs_are_named(renderer: Renderer, outputs: tuple[str, ...]) -> None:
    with pytest.raises(SceneInvalid, match="expected some of color, depth, normal"):
        renderer.render(Scene([single()]), camera(), outputs=outputs)


def test_bytes_are_straight_srgb(renderer: Renderer) -> None:
    data = SplatData(single().rows, np.array([[1.0, 0.25, 0]], np.float32), "rgb")
    frame = renderer.render(Scene([data]), camera())
    alpha = frame.alpha[23, 30]
    assert frame.srgb8[23, 30].tolist() == [255, 64, 0, round(255 * float(alpha))]
    linear = renderer.render(Scene([data], color_space="linear"), camera())
    assert linear.srgb8[23, 30, :3].tolist() == [255, 137, 0]  # IEC 61966-2-1 of 0.25
    assert linear.srgb8[0, 0].tolist() == [0, 0, 0, 0]
