"""Packs a Gaussian into 32 bytes: float32 position and opacity, 16-bit Cholesky factor."""

__all__ = ["PACKED_BYTES", "pack_rows"]

from typing import Final

import numpy as np
from jaxtyping import Float, Float64, UInt32

from gsgen.contract.spec import layout

PACKED_BYTES: Final = 32
"""Bytes of a packed row: x, y, z, opacity; six fixed-point numbers in [-1, 1]; their scale."""

_FIXED_POINT_ONE: Final = 32767  # as in WGSL's unpack2x16snorm
_PIVOT_TOLERANCE: Final = (
    1e-5  # of the largest variance: negative pivots closer to zero are rounding
)


def pack_rows(rows: Float[np.ndarray, "n 10"]) -> UInt32[np.ndarray, "n 8"]:
    """Pack each Gaussian into the 32 bytes that the shader ``page.wgsl`` reads.

    A covariance is stored by its Cholesky factor L, Σ = L Lᵀ, so that every stored value is a
    covariance; rounding Σ itself would make flat Gaussians far thicker. Rows whose covariance is
    not positive semidefinite, or not finite, get a NaN and are not drawn.
    """
    packed_rows = np.empty((len(rows), PACKED_BYTES // 4), np.uint32)
    packed_rows[:, :4] = rows[:, :4].astype(np.float32).view(np.uint32)
    with np.errstate(all="ignore"):
        cholesky_factors = _cholesky_factors(rows[:, layout.COVARIANCE].astype(np.float64))
        scale = np.abs(cholesky_factors).max(axis=1).astype(np.float32)
        scale[~np.isfinite(scale)] = np.nan
        scaled_factors = np.divide(
            cholesky_factors,
            scale[:, None],
            where=scale[:, None] > 0,
            out=np.zeros_like(cholesky_factors),
        )
        fixed_point = np.nan_to_num(
            np.rint(np.clip(scaled_factors, -1, 1) * _FIXED_POINT_ONE)
        ).astype(np.int16)
    packed_rows[:, 4:7] = fixed_point.view(np.uint32)
    packed_rows[:, 7] = scale.view(np.uint32)
    return packed_rows


def _cholesky_factors(covariance: Float64[np.ndarray, "n 6"]) -> Float64[np.ndarray, "n 6"]:
    """Return the Cholesky factors xx, yx, zx, yy, zy, zz of covariances; NaN where none exists."""
    xx, xy, xz, yy, yz, zz = covariance.T
    min_pivots = -_PIVOT_TOLERANCE * np.maximum(xx, np.maximum(yy, zz))
    l_xx = _pivot_roots(xx, min_pivots)
    l_yx, l_zx = _divide_or_zero(xy, l_xx), _divide_or_zero(xz, l_xx)
    l_yy = _pivot_roots(yy - l_yx**2, min_pivots)
    l_zy = _divide_or_zero(yz - l_yx * l_zx, l_yy)
    l_zz = _pivot_roots(zz - l_zx**2 - l_zy**2, min_pivots)
    return np.stack([l_xx, l_yx, l_zx, l_yy, l_zy, l_zz], axis=1)


def _pivot_roots(
    squared_pivots: Float64[np.ndarray, " n"], min_pivots: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Return the square roots of Cholesky pivots; pivots that rounding made negative give zero."""
    return np.asarray(
        np.sqrt(
            np.where((squared_pivots < 0) & (squared_pivots >= min_pivots), 0.0, squared_pivots)
        )
    )


def _divide_or_zero(
    number: Float64[np.ndarray, " n"], divisor: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    quotients = np.zeros_like(number)
    return np.asarray(np.divide(number, divisor, where=divisor != 0, out=quotients))
