"""Weighted sums stand among sorted Gaussians and meshes as one translucent image."""

import numpy as np
import pytest

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import NOTHING
from gsgen.runtime.scene.scene import Scene
from support.rendering.mesh_scenes import wall
from support.rendering.splat_scenes import camera, cloud, single
from support.rendering.weighted_scenes import MIXED, WEIGHTED, celled, summed

BACKGROUND = (0.1, 0.4, 0.7, 0.5)
EVERYTHING = ("color", "depth", "normal")


def compare(name: str, renderer: Renderer) -> None:
    scene, view_camera = MIXED[name]()
    frame = renderer.render(scene, view_camera, background=BACKGROUND, outputs=EVERYTHING)
    expected = oracle.render(scene, view_camera, background=BACKGROUND)
    firm, firm_median = ~expected.fragile, ~expected.fragile_median
    assert firm.mean() > 0.6
    error = np.square(frame.rgba - expected.rgba)[firm].mean()
    assert -10 * np.log10(error) >= 100
    np.testing.assert_allclose(frame.rgba[firm], expected.rgba[firm], atol=1e-4)
    np.testing.assert_allclose(frame.depth[firm], expected.depth[firm], rtol=2e-4)
    np.testing.assert_array_equal(frame.ids[firm_median], expected.ids[firm_median])
    np.testing.assert_allclose(
        frame.median_depth[firm_median], expected.median_depth[firm_median], rtol=1e-4
    )
    covered = firm & np.isfinite(expected.depth)
    cosine = (frame.normal * expected.normal).sum(axis=-1)[covered]
    assert np.median(cosine) > 0.99999


@pytest.mark.parametrize("name", MIXED)
def test_mixed_scenes_agree_with_the_oracle(renderer: Renderer, name: str) -> None:
    compare(name, renderer)


@pytest.mark.parametrize("variant", ["without subgroups", "as on a GPU"])
def test_every_kernel_variant_sums_weights(
    device: Device, renderer: Renderer, variant: str
) -> None:
    other = Device(device.raw)
    other.subgroups = False
    other.software = variant == "without subgroups"
    cut = Renderer(other, rasteriser="tiles")
    scene, view_camera = WEIGHTED["many_cells"]()
    first, two = (
        entry.render(scene, view_camera, outputs=("color", "depth")) for entry in (renderer, cut)
    )
    np.testing.assert_allclose(first.rgba, two.rgba, atol=1e-6)
    assert np.array_equal(first.ids, two.ids)
    if not other.software:  # the other takes long to compile with layers
        compare("among_everything", cut)


def test_something_behind_the_camera_changes_nothing(renderer: Renderer) -> None:
    """Alone or as a layer, the sums are the same; as a layer they have no ids."""
    sums = summed(celled(80, seed=60))
    unseen = single(depth=-3.0)
    alone, with_sets = (
        renderer.render(Scene(sets), camera(), background=BACKGROUND, outputs=EVERYTHING)
        for sets in ([sums], [sums, unseen])
    )
    np.testing.assert_allclose(alone.rgba, with_sets.rgba, atol=1e-6)
    np.testing.assert_allclose(alone.depth, with_sets.depth, rtol=1e-5)
    np.testing.assert_allclose(alone.normal, with_sets.normal, atol=1e-5)
    assert (alone.ids != NOTHING).any()
    assert (with_sets.ids == NOTHING).all()


def test_mesh_occludes_weighted_sums_behind_it(renderer: Renderer) -> None:
    sums = summed(celled(80, seed=61, depth=(4, 8)))
    near = wall(2)
    hidden, bare = (renderer.render(Scene(sets, meshes=[near]), camera()) for sets in ([sums], []))
    reference = bare.alpha > 0
    assert reference.any()
    assert np.array_equal(hidden.rgba[reference], bare.rgba[reference])


def test_an_opaque_splat_hides_sums_behind_it_and_is_hidden_by_those_before(
    renderer: Renderer,
) -> None:
    sums = summed(celled(60, seed=62, depth=(4, 5), size=0.8), background=0.0)
    for depth, expected in ((2.0, 0.99), (9.0, None)):
        splat = single(depth=depth, opacity=1.0, variance=4.0)
        splat.appearance[:] = 5.0  # brighter than all that is summed
        frame = renderer.render(Scene([sums, splat]), camera())
        middle = float(frame.rgba[23, 30, 0])
        if expected is None:
            assert middle < 1.0
        else:
            assert middle == pytest.approx(5 * expected, abs=0.02)


def test_quads_leave_sums_to_compute_shaders(device: Device, renderer: Renderer) -> None:
    quads = Renderer(device, rasteriser="quads")
    scenes = (
        MIXED["among_sorted_gaussians"](),
        MIXED["among_everything_all_around"](),
        WEIGHTED["many_cells"](),
        WEIGHTED["cells_all_around"](),
    )
    for scene, view_camera in scenes:
        first, two = (entry.render(scene, view_camera) for entry in (quads, renderer))
        assert np.array_equal(first.rgba, two.rgba)


def test_published_backgrounds_compose_with_nothing(device: Device) -> None:
    published = Renderer(device, rasteriser="tiles", published=True)
    sums = summed(celled(5))
    for scene in (Scene([sums, cloud(3)]), Scene([sums], meshes=[wall(3)])):
        with pytest.raises(
            SceneInvalid, match=r"published: is True, but the scene has depth-sorted sets or meshes"
        ):
            published.render(scene, camera())
    published.render(Scene([cloud(3)]), camera())  # nothing is summed here
