"""Converts the output of a tile's ONNX generator to rows of the splat pool (GPU memory)."""

__all__ = ["tile_rows"]

from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import COVARIANCE_INDEX, symmetric
from gsgen.contract.spec.spherical_harmonics import coefficients, degree_of
from gsgen.formats.shared.harmonics import rotate_sh
from gsgen.formats.shared.quantities import SH_C0
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.volumes import Box
from gsgen.tiles.streaming.session_frame import TileArrival

_BOUNDS_TOLERANCE = 1e-3  # of the box's diagonal, by which positions may leave the box


def tile_rows(
    tile: int,
    rows: Float[np.ndarray, "n 10"],
    appearance: Float[np.ndarray, "n c"],
    *,
    space: Literal["sh", "rgb"],
    transform: Float64[np.ndarray, "4 4"],
    box: Box,
    sh_degree: int,
) -> TileArrival:
    """Convert the output of a tile's ONNX generator to splat-pool rows, in root coordinates.

    Args:
        tile: Key of the tile.
        rows: Live packed rows in the tile's frame.
        appearance: SH coefficients or RGB of these rows.
        space: What ``appearance`` holds.
        transform: From the tile's frame to that of the root, a similarity.
        box: Of the tile, in the root frame.
        sh_degree: Of the pool; a higher degree is cut, a lower one filled with zeros.

    Raises:
        TilesetInvalid: A number is not finite, an opacity is not in [0, 1], or a Gaussian that is
            not fully transparent lies outside the tile's box.
    """
    linear, origin = transform[:3, :3], transform[:3, 3]
    moved = _transform_rows(rows, linear)
    _require_valid_rows(moved, appearance, origin, box)
    sh_rows = np.zeros((len(rows), 3 * coefficients(sh_degree)), np.float32)
    harmonics = _sh_coefficients(appearance, space)
    if harmonics.shape[1] > 1 and not np.array_equal(linear, np.eye(3)):
        left, _, right = np.linalg.svd(linear)
        harmonics = rotate_sh(harmonics, left @ right)
    flat = harmonics.reshape(len(rows), -1)
    shared_coefficients = min(flat.shape[1], sh_rows.shape[1])
    sh_rows[:, :shared_coefficients] = flat[:, :shared_coefficients]
    return TileArrival(tile=tile, rows=moved, appearance=sh_rows, origin=origin)


def _transform_rows(
    rows: Float[np.ndarray, "n 10"], linear: Float64[np.ndarray, "3 3"]
) -> Float32[np.ndarray, "n 10"]:
    """Return packed Gaussians transformed by a 3 × 3 matrix M: covariance Σ becomes M Σ Mᵀ."""
    moved = rows.astype(np.float32)
    if np.array_equal(linear, np.eye(3)):
        return moved
    moved[:, layout.POSITION] = rows[:, layout.POSITION].astype(np.float64) @ linear.T
    covariance = linear @ symmetric(rows[:, layout.COVARIANCE]) @ linear.T
    moved[:, layout.COVARIANCE] = covariance[:, *COVARIANCE_INDEX]
    return moved


def _sh_coefficients(
    appearance: Float[np.ndarray, "n c"], space: Literal["sh", "rgb"]
) -> Float32[np.ndarray, "n k 3"]:
    """Return the Gaussians' appearance as SH coefficients; RGB colours become degree 0."""
    if space == "rgb":
        return ((appearance[:, None, :3].astype(np.float32) - 0.5) / SH_C0).astype(np.float32)
    degree = degree_of(appearance.shape[1] // 3)
    return appearance.astype(np.float32).reshape(len(appearance), coefficients(degree), 3)


def _require_valid_rows(
    rows: Float32[np.ndarray, "n 10"],
    appearance: Float[np.ndarray, "n c"],
    origin: Float64[np.ndarray, " 3"],
    box: Box,
) -> None:
    finite = np.isfinite(rows).all(axis=1) & np.isfinite(appearance).all(axis=1)
    opacity = rows[:, layout.OPACITY]
    outside = np.zeros(len(rows), bool)
    drawn = finite & (opacity > 0)
    is_outside_bounds = box.outside(rows[drawn, layout.POSITION].astype(np.float64) + origin)
    outside[drawn] = ~(is_outside_bounds <= _BOUNDS_TOLERANCE * box.size)
    checks = {
        "are not finite": (~finite, "finite numbers"),
        "have an invalid opacity": (~((opacity >= 0) & (opacity <= 1)), "0 <= opacity <= 1"),
        "lie outside the tile": (outside, "Gaussians within the tile's volume"),
    }
    for actual, (invalid_mask, expected) in checks.items():
        if count := int(invalid_mask.sum()):
            raise TilesetInvalid(
                f"{count:,} of {len(rows):,} Gaussians {actual}, the first is row "
                f"{int(np.argmax(invalid_mask))}",
                expected=expected,
                fault=Fault.NEURAL,
            )
