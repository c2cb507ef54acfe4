"""Rotates splats between the axes of a tile (z up) and of glTF files (y up).

3D Tiles 1.1, section "glTF transforms": a viewer rotates glTF content about x by 90°, so
(x, y, z) of the content is (x, −z, y) of the tile.
"""

__all__ = ["rotate_splats", "to_content_axes"]

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import quaternion_product
from gsgen.formats.shared.harmonics import rotate_sh
from gsgen.formats.shared.quantities import rotations
from gsgen.formats.shared.splats import SH_COUNTS, Splats
from gsgen.tiles.format.tileset import Z_UP_FROM_Y_UP

_CONTENT_FROM_TILE: Final = Z_UP_FROM_Y_UP[:3, :3].T
_DECIMAL_DIGITS = 7


def to_content_axes(splats: Splats) -> Splats:
    """Rotate splats from the axes of a tile (z up) to the axes of glTF (y up)."""
    return rotate_splats(splats, _CONTENT_FROM_TILE)


def rotate_splats(splats: Splats, rotation: Float64[np.ndarray, "3 3"]) -> Splats:
    """Rotate splats, and their view-dependent colours with them."""
    key = tuple(float(value) for value in rotation.ravel())
    (quaternion,) = rotations(np.asarray(rotation, np.float64)[None])
    sh = splats.sh
    if splats.degree:
        matrix = _sh_rotation(splats.degree, key)
        sh = np.einsum("lk,nkc->nlc", matrix, splats.sh, dtype=np.float64)
    return replace(
        splats,
        position=(splats.position @ rotation.T).astype(np.float32),
        rotation=quaternion_product(quaternion.astype(np.float64), splats.rotation).astype(
            np.float32
        ),
        sh=sh.astype(np.float32),
    )


@cache
def _sh_rotation(degree: int, rotation: tuple[float, ...]) -> Float64[np.ndarray, "k k"]:
    """Return the matrix that rotates SH coefficients, rounded so that all machines agree."""
    count = SH_COUNTS[degree]
    unit = np.eye(count, dtype=np.float32)[:, :, None].repeat(3, axis=2)
    columns = rotate_sh(unit, np.array(rotation).reshape(3, 3))[:, :, 0]
    return np.asarray(np.round(columns.T.astype(np.float64), _DECIMAL_DIGITS))
