"""Frames of renderers that bind little, and of those that bind all at once."""

__all__ = ["ROWS", "SMALL", "assert_same_images", "whole_and_small"]

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import Frame

ROWS = 512  # of a page
SMALL = 1 << 15  # bytes of a binding: 2,048 splats, 819 cells, or 2,048 pixels


def whole_and_small(device: Device, *, as_gpu: bool) -> tuple[Renderer, Renderer]:
    """Return two renderers of a device, the second of which binds little."""
    pair = Device(device.raw), Device(device.raw)
    for renderer_pair in pair:
        if as_gpu:
            renderer_pair.software, renderer_pair.subgroups = False, False
    pair[1].largest_binding = SMALL
    whole, small = (
        Renderer(renderer_pair, rasteriser="tiles", page_rows=ROWS) for renderer_pair in pair
    )
    return whole, small


def assert_same_images(first: Frame, second: Frame) -> None:
    """Assert that all images of two frames are equal, bit by bit."""
    for name in ("rgba", "alpha", "depth", "median_depth", "ids", "normal"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
