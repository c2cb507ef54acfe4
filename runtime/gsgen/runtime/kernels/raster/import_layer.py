"""Copies the picture and the depth buffer of another renderer to an image layer."""

__all__ = ["PICTURE", "ImportLayer"]

from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Kernel

PICTURE: Final = np.dtype(
    {
        "names": ["size", "color_row", "depth_row", "first", "empty", "slope", "offset"],
        "formats": ["2u4", "u4", "u4", "u4", "f4", "f4", "f4"],
        "offsets": [0, 8, 12, 16, 20, 24, 28],
        "itemsize": 32,
    }
)
"""The bytes of ``struct Picture`` in import_layer.wgsl."""


@final
class ImportLayer:
    """The kernel ``import_layer.wgsl``, which copies another renderer's picture and depths."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(device, "import_layer", "import_layer", ("urrw", "w"))
