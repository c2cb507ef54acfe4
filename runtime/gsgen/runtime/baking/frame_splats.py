"""Converts the drawn Gaussians of one frame to the splat parameters that files store."""

__all__ = ["drawn_mask", "splats_of_frame"]

from typing import Literal

import numpy as np
from jaxtyping import Bool

from gsgen.contract.spec.layout import CULL_OPACITY, DecodedGaussians
from gsgen.formats import Splats
from gsgen.formats.shared.principal_axes import scales_and_quaternions
from gsgen.formats.shared.quantities import SH_C0, log, logit

# Below this, float32 cannot square a scale; formats and viewers need a finite logarithm.
_MIN_SCALE = 1e-19


def drawn_mask(gaussians: DecodedGaussians) -> tuple[Bool[np.ndarray, " n"], int]:
    """Return the mask of drawn Gaussians, and the number of rows that are not finite.

    A Gaussian is drawn if all its numbers are finite and its opacity is at least 1/255.
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


def splats_of_frame(
    gaussians: DecodedGaussians,
    *,
    antialiased: bool = False,
    color_space: Literal["srgb", "linear"] = "srgb",
) -> Splats:
    """Convert drawn Gaussians to the parameters of a splat file; positions stay bit for bit."""
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
