"""Kernels are cut in several ways; the picture is the same."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.subgroups import subgroup_size
from gsgen.runtime.kernels.tiles import blend_tiles
from gsgen.runtime.kernels.tiles.blend_tiles import MIN_DILATION
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from support.rendering.splat_scenes import SCENES


@pytest.mark.parametrize("variant", ["without subgroups", "as on a GPU"])
def test_kernel_variants_draw_equal_pictures(device: Device, variant: str) -> None:
    other = Device(device.raw)
    other.subgroups = False
    other.software = variant == "without subgroups"
    renderer = Renderer(other, rasteriser="tiles")
    for name in ("many", "placed", "huge", "nothing", "panorama_seam"):
        scene, camera = SCENES[name]()
        frame = renderer.render(scene, camera, outputs=("color", "depth"))
        expected = oracle.render(scene, camera)
        error = np.abs(frame.rgba - expected.rgba).max(axis=-1)
        assert np.where(expected.fragile, 0, error).max() <= 2e-5
        firm = ~expected.fragile_median
        np.testing.assert_array_equal(frame.ids[firm], expected.ids[firm])


def gpu_like(device: Device) -> Device:
    """Return the device as one that no CPU computes for."""
    other = Device(device.raw)
    other.subgroups = other.software = False
    return other


@pytest.mark.parametrize("name", ["opacities_at_the_edges", "many", "needles", "panorama_seam"])
def test_tiles_of_all_sizes_draw_the_same_splats(device: Device, name: str) -> None:
    """A splat between the centres of pixels is not drawn, wherever a tile begins."""
    scene, camera = SCENES[name]()
    frames = [
        Renderer(variant, rasteriser="tiles").render(scene, camera)
        for variant in (device, gpu_like(device))
    ]
    assert frames[0].visible == frames[1].visible >= oracle.render(scene, camera).visible > 0


def test_a_gpus_picture_is_the_same_twice_and_without_records(device: Device) -> None:
    """Splats stand in arrays of their own where a binding is too small for records."""
    scene, camera = SCENES["many"]()
    records, arrays = (Renderer(gpu_like(device), rasteriser="tiles") for _ in range(2))
    arrays._kernels.records = lambda gaussians: False
    drawn = [renderer.render(scene, camera).rgba for renderer in (records, records, arrays)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    np.testing.assert_array_equal(drawn[0], drawn[2])


def test_quads_read_records(device: Device) -> None:
    scene, camera = SCENES["many"]()
    records, arrays = (Renderer(array, rasteriser="quads") for array in (gpu_like(device), device))
    drawn = [renderer.render(scene, camera).rgba for renderer in (records, arrays)]
    np.testing.assert_array_equal(drawn[0], drawn[1])


@pytest.mark.parametrize("name", ["many", "huge", "panorama_seam"])
def test_narrow_cells_draw_the_same_picture(
    device: Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Drivers on CPUs whose subgroups have four invocations blend in cells of 4×4 pixels."""
    monkeypatch.setattr(blend_tiles, "subgroup_size", lambda device: 4)
    narrow_renderer = Renderer(device, rasteriser="tiles")
    scene, camera = SCENES[name]()
    frame = narrow_renderer.render(scene, camera, outputs=("color", "depth"))
    assert (
        narrow_renderer._kernels.blend(
            "color",
            panorama=bool(camera.period),
            layers=0,
            records=False,
            has_small_dilation=False,
            carried_layers=False,
        ).shader
        == "blend_staged"
    )
    expected = oracle.render(scene, camera)
    error = np.abs(frame.rgba - expected.rgba).max(axis=-1)
    assert np.where(expected.fragile, 0, error).max() <= 2e-5
    np.testing.assert_array_equal(
        frame.ids[~expected.fragile_median], expected.ids[~expected.fragile_median]
    )


@pytest.mark.parametrize("dilation", [0.004, 0.06, MIN_DILATION, 0.3])
def test_thin_splats_do_not_underflow_between_rows(device: Device, dilation: float) -> None:
    """Four pixels of a column are 2^1000 apart where a camera adds little to the covariances."""
    for name in ("needles", "many"):
        scene, camera = SCENES[name]()
        camera = replace(camera, dilation=dilation)
        frame = Renderer(device, rasteriser="tiles").render(scene, camera)
        expected = oracle.render(scene, camera)
        error = np.abs(frame.rgba - expected.rgba).max(axis=-1)
        assert np.where(expected.fragile, 0, error).max() <= 2e-5
        assert expected.visible > 0


def test_subgroups_are_measured_where_there_are_any(device: Device) -> None:
    assert subgroup_size(device) in ((0,) if not device.subgroups else (1, 2, 4, 8))
    plain_device = Device(device.raw)
    plain_device.subgroups = False
    assert subgroup_size(plain_device) == 0
