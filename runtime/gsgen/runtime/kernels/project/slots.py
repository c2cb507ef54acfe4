"""The slot table of the splat pool (streamed tiles): camera centre, fade and box of each slot."""

__all__ = ["SLOT_UNIFORM_DTYPE", "slot_table"]

from typing import Final

import numpy as np
from jaxtyping import Float, Shaped

from gsgen.runtime.gpu.splat_residency import SLOT_BYTES
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.splat_pool import SplatPool

SLOT_UNIFORM_DTYPE: Final = np.dtype(
    {
        "names": ["eye", "fade", "eye_rest", "live", "eye_at", "eye_at_rest", "low", "high"],
        "formats": ["3f4", "f4", "3f4", "u4", "3f4", "3f4", "3f4", "3f4"],
        "offsets": [0, 12, 16, 28, 32, 48, 64, 80],
        "itemsize": SLOT_BYTES,
    }
)
"""The bytes of ``struct Slot`` in slots.wgsl."""


def slot_table(
    pool: SplatPool, first: int, count: int, transform: Float[np.ndarray, "4 4"], camera: Camera
) -> Shaped[np.ndarray, " s"]:
    """Return the shader data of ``count`` splat pool slots; positions are split into two float32.

    The camera centre is relative to the origin of each slot, so that positions far from the origin
    of the scene lose nothing.
    """
    table = np.zeros(count, SLOT_UNIFORM_DTYPE)
    slots = slice(first, first + count)
    linear, offset = transform[:3, :3], transform[:3, 3]
    eye = np.linalg.solve(linear, camera.eye - offset) - pool.origin[slots]
    table["eye"] = eye
    eye_remainder = eye - table["eye"].astype(np.float64)
    table["eye_rest"] = eye_remainder
    eye_in_camera = -eye_remainder @ (camera.view[:3, :3] @ linear).T
    table["eye_at"] = eye_in_camera
    table["eye_at_rest"] = eye_in_camera - table["eye_at"].astype(np.float64)
    table["fade"], table["live"] = pool.fade[slots], pool.live[slots]
    table["low"], table["high"] = pool.low[slots], pool.high[slots]
    return table
