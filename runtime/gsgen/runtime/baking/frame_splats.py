"""Converts Gaussians of one frame to splats: drawn rows, scales, quaternions and SH."""

__all__ = ["drawn_mask", "scales_and_quaternions", "splats_of_frame"]

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.layout import CULL_OPACITY, DecodedGaussians
from gsgen.formats import Splats
from gsgen.formats.shared.quantities import SH_C0, log, logit, rotations

# Below this, float32 cannot square a scale; formats and viewers need a finite logarithm.
_MIN_SCALE = 1e-19


def drawn_mask(gaussians: DecodedGaussians) -> tuple[Bool[np.ndarray, " n"], int]:
    """Return which rows a renderer draws, and how many others are not finite.

    A row is drawn if all its numbers are finite and its opacity is at least 1/255.

    Args:
        gaussians: The live rows of one frame.
    """
    appearance = gaussians.rgb if gaussians.sh is None else gaussians.sh
    assert appearance is not None
    finite = (
        np.isfinite(gaussians.position).all(axis=1)
        & np.isfinite(gaussians.opacity)
        & np.isfinite(gaussians.covariance).all(axis=1)
        & np.isfinite(appearance.reshape(len(gaussians), -1)).all(axis=1)
    )
    return finite & (gaussians.opacity >= np.float32(CULL_OPACITY)), int((~finite).sum())


def scales_and_quaternions(
    covariance: Float[np.ndarray, "n 6"],
) -> tuple[Float64[np.ndarray, "n 3"], Float32[np.ndarray, "n 4"]]:
    """Return the standard deviations and the rotation of each covariance.

    The eigenvalues ascend. Signs of eigenvectors, which no solver defines, are fixed: the largest
    component of the second and the third is positive, and the first makes the axes right-handed.

    Args:
        covariance: Upper triangles xx xy xz yy yz zz, in squared scene units.

    Returns:
        Scales, in scene units; and unit quaternions (w, x, y, z) with w ≥ 0.
    """
    variances, axes = np.linalg.eigh(symmetric(covariance))
    largest = np.abs(axes).argmax(axis=1)  # of each column
    signs = np.sign(np.take_along_axis(axes, largest[:, None, :], axis=1))
    axes = axes * signs
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    quaternions = rotations(axes)
    positive = quaternions * np.where(quaternions[:, :1] < 0, np.float32(-1), np.float32(1))
    return np.sqrt(np.maximum(variances, 0)), positive


def splats_of_frame(
    gaussians: DecodedGaussians,
    *,
    antialiased: bool = False,
    color_space: Literal["srgb", "linear"] = "srgb",
) -> Splats:
    """Return the parameters that a splat file holds; positions stay bit for bit.

    Args:
        gaussians: Rows that are drawn.
        antialiased: The scene was trained with the filter of Mip-Splatting.
        color_space: Of the colours.
    """
    scales, quaternions = scales_and_quaternions(gaussians.covariance)
    if gaussians.sh is None:
        assert gaussians.rgb is not None
        coefficients = (gaussians.rgb.astype(np.float64)[:, None, :] - 0.5) / SH_C0
        sh = coefficients.astype(np.float32)
    else:
        sh = np.asarray(gaussians.sh, np.float32)
    return Splats(
        position=np.ascontiguousarray(gaussians.position, np.float32),
        rotation=quaternions,
        log_scale=log(np.maximum(scales, _MIN_SCALE)),
        logit_opacity=logit(np.clip(gaussians.opacity, 0, 1)),
        sh=np.ascontiguousarray(sh),
        antialiased=antialiased,
        color_space=color_space,
    )
