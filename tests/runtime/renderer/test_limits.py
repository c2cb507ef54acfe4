"""What happens at the limits: of buffers, of the device, of what the user gives."""

import gc
from weakref import ref

import numpy as np
import pytest

from gsgen.runtime.errors import (
    CapacityExceeded,
    DeviceLost,
    DeviceUnavailable,
    MemoryFull,
    SceneInvalid,
)
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Residency, bytes_of
from gsgen.runtime.renderer import kernel_set
from gsgen.runtime.renderer import renderer as renderers
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from support.rendering.failing_devices import memory_of
from support.rendering.splat_scenes import camera, cloud, single
from support.rendering.weighted_scenes import WEIGHTED, celled, summed


def test_room_for_pairs_grows_by_itself(device: Device) -> None:
    renderer = Renderer(device, rasteriser="tiles")
    scene = Scene([cloud(3000, size=2.0, depth=(2, 3), opacity=(0.01, 0.05))])
    frame = renderer.render(scene, camera(width=160, height=120))
    assert frame.pairs > 1 << 16  # more than there was room for at first
    again = renderer.render(scene, camera(width=160, height=120))
    assert np.array_equal(frame.rgba, again.rgba)


def test_a_cell_of_more_tiles_than_a_binding_holds_pairs_is_an_error(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several cells are drawn in slabs of depth instead."""
    scene, view = WEIGHTED["many_cells"]()
    view = view.scaled(800, 700)
    expected = renderer.render(scene, view)
    assert expected.pairs > 2048
    monkeypatch.setattr(renderers, "MAX_WORKGROUPS", 1)
    monkeypatch.setattr(renderer, "_pairs", 2048)
    image = renderer.draw(scene, view).image
    actual = renderer.device.read(image, np.float32, expected.rgba.size)
    assert np.array_equal(actual, expected.rgba.ravel())
    assert "tally cells" in renderer._plan.stages
    with pytest.raises(CapacityExceeded, match=r"needs 2,200 pairs .* holds at most 2,048"):
        renderer.draw(Scene([summed(celled(1, 5, size=90, depth=(2, 2.1)))]), view)


def test_more_pairs_than_a_dispatch_has_are_drawn_in_bands(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene([cloud(3000, size=2.0, depth=(2, 3))])
    expected = renderer.render(scene, camera(width=120, height=120))
    assert expected.pairs > 61_440
    monkeypatch.setattr(renderers, "MAX_WORKGROUPS", 30)
    assert renderer._max_pairs == 61_440
    assert np.array_equal(renderer.render(scene, camera(width=120, height=120)).rgba, expected.rgba)


def test_more_splats_than_a_dispatch_has_is_an_error(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene([cloud(5000, size=0.01)])
    renderer.render(scene, camera())
    monkeypatch.setattr(kernel_set, "MAX_WORKGROUPS", 1 if renderer.device.software else 16)
    with pytest.raises(
        CapacityExceeded, match=r"scene: the scene has 4,\d+ splats .* draws at most 4,096"
    ):
        renderer.render(scene, camera())


def test_a_scene_that_is_too_large_takes_no_memory_once_it_is_gone(device: Device) -> None:
    renderer = Renderer(device, rasteriser="tiles")
    first = Scene([cloud(300)])
    renderer.render(first, camera())
    rows = ref(renderer._residency.pages(first.sets[0].data)[0].rows)
    with memory_of(1000), pytest.raises(MemoryFull):
        renderer.render(Scene([cloud(400)]), camera())
    del first
    gc.collect()
    assert rows() is None


def test_failed_pair_allocation_is_not_retried(device: Device) -> None:
    renderer = Renderer(device, rasteriser="tiles")
    near = Scene([cloud(3000, size=2.0, depth=(2, 3), opacity=(0.01, 0.05))])
    with memory_of(1 << 21):
        with pytest.raises(MemoryFull, match=r"splats of tiles|pairs"):
            renderer.render(near, camera(width=160, height=120))
        assert renderer.render(Scene([single()]), camera()).visible == 1


def test_an_image_that_is_too_large_for_one_buffer_is_drawn_in_bands_alone(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = renderer.render(Scene([single()]), camera(width=512, height=512))
    monkeypatch.setattr(renderer.device, "largest_binding", 1 << 20)
    with pytest.raises(CapacityExceeded, match="color image: would take 4,194,304 bytes"):
        renderer.draw(Scene([single()]), camera(width=512, height=512))
    frame = renderer.render(Scene([single()]), camera(width=512, height=512))
    assert np.array_equal(frame.rgba, expected.rgba)
    assert frame.visible == expected.visible == 1


def test_impossible_requests_fail_before_reaching_the_device(device: Device) -> None:
    with pytest.raises(CapacityExceeded, match="much: would take 1,099,511,627,776 bytes"):
        device.readable("much", 1 << 40)
    with pytest.raises(CapacityExceeded, match=r"wide: is 1000000×8; .* has textures of"):
        device.texture("wide", (1_000_000, 8), "rgba8unorm", "COPY_DST")


@pytest.mark.parametrize("compact", [False, True])
@pytest.mark.parametrize("half", [False, True])
def test_memory_of_gaussians_is_known_in_advance(device: Device, half: bool, compact: bool) -> None:
    rng = np.random.default_rng(0)
    dtype = np.float16 if half else np.float32
    colors = rng.uniform(size=(64, 27)).astype(dtype)
    data = SplatData(np.zeros((64, 10), dtype), colors, "sh")
    residency = Residency(device, 32, compact=compact)
    pages = residency.pages(data)
    stored = sum(page.rows.size + page.appearance.size for page in pages)
    assert stored == bytes_of(data, compact=compact)


def test_lost_device_is_reported_for_every_call() -> None:
    device = Device.open()
    scene, renderer = Scene([single()]), Renderer(device, rasteriser="tiles")
    renderer.render(scene, camera())
    assert not device.is_lost
    device.raw.destroy()
    assert device.is_lost
    with pytest.raises(DeviceLost, match="the graphics device was lost"):
        renderer.render(scene, camera())
    with pytest.raises(DeviceLost, match="the graphics device was lost"):
        renderer.render(scene, camera(width=9, height=9), outputs=("depth", "normal"))
    with pytest.raises(DeviceLost, match="the graphics device was lost"):
        Renderer(device)
    with pytest.raises(DeviceLost, match="the graphics device was lost"):
        device.submit(device.raw.create_command_encoder())


@pytest.mark.parametrize("when", ["before the frame", "in its middle"])
def test_device_loss_during_updates_is_reported(when: str, monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device.open()
    data = cloud(300)
    scene, renderer = Scene([SplatSet(data)]), Renderer(device, rasteriser="tiles")
    for step in range(3):  # rows that change are written in other ways than those that stay
        data.update(data.rows + np.float32(0.01 * step), None, len(data))
        renderer.render(scene, camera())
    data.update(data.rows + np.float32(0.1), None, len(data))
    if when == "before the frame":
        device.raw.destroy()
    else:
        submit = device.submit

        def lost_after(encoder: object) -> None:
            submit(encoder)
            device.raw.destroy()

        monkeypatch.setattr(device, "submit", lost_after)
    with pytest.raises(DeviceLost, match="the graphics device was lost"):
        renderer.render(scene, camera())


def test_errors_of_a_working_device_are_not_replaced(device: Device) -> None:
    import wgpu

    with pytest.raises(wgpu.GPUValidationError), device.translate_errors():
        device.raw.create_buffer(size=1 << 62, usage="STORAGE")


def test_kernels_bind_no_more_than_every_device_has(device: Device) -> None:
    assert device.raw.limits["max-storage-buffers-per-shader-stage"] == 8


def test_no_adapter_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    import wgpu

    def none(**_: object) -> None:
        raise RuntimeError("Request adapter failed (Unavailable)")

    monkeypatch.setattr(wgpu.gpu, "request_adapter_sync", none)  # a fake: no adapter
    with pytest.raises(DeviceUnavailable, match=r"no graphics adapter.*\n.*gsgen doctor"):
        Device.open()


@pytest.mark.parametrize(
    "background", [(0, 0, 0), (0, 0, 0, 2), (np.nan, 0, 0, 1), (0, 0, 0, -0.1)]
)
def test_invalid_background_is_refused(renderer: Renderer, background: tuple[float, ...]) -> None:
    with pytest.raises(SceneInvalid, match=r"background: is .* alpha from 0 to 1"):
        renderer.render(Scene([single()]), camera(), background=background)


def test_image_of_one_pixel_is_drawn(renderer: Renderer) -> None:
    frame = renderer.render(Scene([single()]), camera(width=1, height=1))
    assert 0.85 < frame.rgba[0, 0, 3] < 0.91
