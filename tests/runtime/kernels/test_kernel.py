"""Kernels of one device share compute pipelines, and only where nothing differs."""

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Kernel
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from support.rendering.splat_scenes import camera, single


def tally(device: Device, threads: int = 64) -> Kernel:
    return Kernel(device, "tally_keys", "tally_keys", ("urw", "u"), THREADS=threads)


def test_kernels_with_the_same_text_share_a_pipeline(device: Device) -> None:
    assert tally(device).pipeline is tally(device).pipeline
    assert tally(device, threads=32).pipeline is not tally(device).pipeline


def test_a_second_renderer_compiles_no_kernel() -> None:
    device = Device.open()
    scene = Scene([single()])
    Renderer(device, rasteriser="tiles").render(scene, camera())
    compiled = dict(device.pipelines)
    assert len(compiled) > 5
    Renderer(device, rasteriser="tiles").render(scene, camera(width=32, height=32))
    assert device.pipelines == compiled
