"""Kernels are cut in several ways; the picture is the same."""

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.subgroups import lanes
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.renderer.renderer import Renderer
from support.rendering.splat_scenes import SCENES


@pytest.mark.parametrize("variant", ["without subgroups", "as on a GPU"])
def test_the_picture_is_the_same(device: Device, variant: str) -> None:
    other = Device(device.raw)
    other.subgroups = False
    other.software = variant == "without subgroups"
    renderer = Renderer(other, rasteriser="tiles")
    for name in ("many", "placed", "huge", "nothing", "panorama_seam"):
        scene, camera = SCENES[name]()
        seen = renderer.render(scene, camera, outputs=("color", "depth"))
        wanted = oracle.render(scene, camera)
        error = np.abs(seen.rgba - wanted.rgba).max(axis=-1)
        assert np.where(wanted.fragile, 0, error).max() <= 2e-5
        firm = ~wanted.fragile_median
        np.testing.assert_array_equal(seen.ids[firm], wanted.ids[firm])


def test_subgroups_are_measured_where_there_are_any(device: Device) -> None:
    assert lanes(device) in ((0,) if not device.subgroups else (1, 2, 4, 8))
    without = Device(device.raw)
    without.subgroups = False
    assert lanes(without) == 0
