"""Kernels and renderers of one device share pipelines, and only where nothing differs."""

import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.raster.draw_quads import DrawQuads
from gsgen.runtime.kernels.shared.kernel import Kernel
from gsgen.runtime.renderer.plan_options import Rasteriser
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from support.rendering.mesh_scenes import wall
from support.rendering.splat_scenes import camera, single


def tally(device: Device, threads: int = 64) -> Kernel:
    return Kernel(device, "tally_keys", "tally_keys", ("urw", "u"), THREADS=threads)


def test_kernels_with_the_same_text_share_a_pipeline(device: Device) -> None:
    assert tally(device).pipeline is tally(device).pipeline
    assert tally(device, threads=32).pipeline is not tally(device).pipeline


@pytest.mark.parametrize("rasteriser", ["tiles", "quads"])
def test_a_second_renderer_compiles_nothing(rasteriser: Rasteriser) -> None:
    device = Device.open()
    scene = Scene([single()], meshes=[wall(3)])
    Renderer(device, rasteriser=rasteriser).render(scene, camera())
    kernels, drawn = dict(device.pipelines), dict(device.render_pipelines)
    assert len(kernels) > 5
    assert len(drawn) == (1 if rasteriser == "tiles" else 2)
    Renderer(device, rasteriser=rasteriser).render(scene, camera(width=32, height=32))
    assert (device.pipelines, device.render_pipelines) == (kernels, drawn)


def test_quads_that_meshes_hide_have_another_pipeline(device: Device) -> None:
    tested = DrawQuads(device, has_depth_test=True)
    assert DrawQuads(device, has_depth_test=True)._pipeline is tested._pipeline
    assert DrawQuads(device)._pipeline is not tested._pipeline
