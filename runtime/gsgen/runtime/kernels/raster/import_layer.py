"""Copies the picture and the depth buffer of another renderer to an image layer."""

__all__ = ["PICTURE", "ImportLayer", "import_reference"]

from typing import Final, final

import numpy as np
from jaxtyping import Float, Float16, Float32, Shaped

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Kernel
from gsgen.runtime.kernels.shared.shader import NOWHERE

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


def import_reference(
    picture: Shaped[np.ndarray, ""],
    halves: Float16[np.ndarray, "h r 4"],
    values: Float32[np.ndarray, "h s"],
) -> tuple[Float[np.ndarray, "h w 4"], Float[np.ndarray, "h w"]]:
    """Return an imported layer's colours and depths in float64, as ``import_layer.wgsl`` does.

    Args:
        picture: A :data:`PICTURE`.
        halves: Linear colours multiplied by alpha, and alpha; rows may be padded.
        values: The depth buffer.
    """
    width = int(picture["size"][0])
    color, value = halves[:, :width].astype(np.float64), values[:, :width].astype(np.float64)
    alpha = np.clip(color[..., 3:], 0, 1)
    straight = np.clip(color[..., :3] / np.maximum(alpha, 1e-6), 0, 1)
    curve = 1.055 * straight ** (1 / 2.4) - 0.055
    encoded = np.where(straight <= 0.0031308, 12.92 * straight, curve)
    with np.errstate(divide="ignore"):
        depth = picture["offset"] / (value + picture["slope"])
    depth = np.where(values[:, :width] == picture["empty"], 0.5 * NOWHERE, depth)
    layer = np.concatenate([alpha * encoded, alpha], axis=-1)
    return layer, np.where(alpha[..., 0] > 0, depth, NOWHERE)
