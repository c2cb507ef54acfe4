"""The hardware's rasteriser draws what the tiles draw, but for what finished pixels leave out."""

import numpy as np
import pytest

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from support.rendering.splat_scenes import LENSES, SCENES

BACKGROUND = (0.1, 0.4, 0.7, 0.5)


@pytest.fixture(scope="module")
def quads(device: Device) -> Renderer:
    return Renderer(device, rasteriser="quads")


@pytest.mark.parametrize(
    "name",
    [
        "nothing",
        "one",
        "many",
        "needles",
        "huge",
        "placed",
        "flat_cameras",
        "not_finite",
        "panorama",
        "panorama_seam",
        "panorama_poles",
        "panorama_huge",
        "panorama_part",
        *LENSES,
    ],
)
def test_quads_agree_with_the_oracle(quads: Renderer, name: str) -> None:
    scene, camera = SCENES[name]()
    frame = quads.render(scene, camera, background=BACKGROUND)
    expected = oracle.render(scene, camera, background=BACKGROUND)
    error = np.abs(frame.rgba - expected.rgba).max(axis=-1)
    # Where the oracle's pixels are finished, up to a hundredth of the light is still on its way.
    open_still = ~expected.fragile & (expected.rgba[..., 3] < 0.5 + 0.5 * 0.98)
    assert open_still.any() or name == "huge"
    assert np.where(open_still, error, 0).max() <= 2e-5
    assert error.max() <= 1e-2


def test_quads_and_tiles_share_a_frame(quads: Renderer, renderer: Renderer) -> None:
    scene, camera = SCENES["many"]()
    both = quads.render(scene, camera, outputs=("color", "depth", "normal"))
    tiles = renderer.render(scene, camera, outputs=("color", "depth", "normal"))
    assert np.array_equal(both.depth, tiles.depth)
    assert np.array_equal(both.normal, tiles.normal)
    np.testing.assert_allclose(both.alpha, tiles.alpha, atol=1e-2)


def test_a_device_that_cannot_blend_floats_says_so(device: Device) -> None:
    other = Device(device.raw)
    other.blends_floats = False
    with pytest.raises(DeviceUnavailable, match="cannot blend 32-bit floats"):
        Renderer(other, rasteriser="quads")
