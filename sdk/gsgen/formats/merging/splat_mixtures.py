"""Converts splats to Gaussians for merging, and merged Gaussians to splats."""

__all__ = ["mixture_of", "splats_of"]

import numpy as np
from jaxtyping import UInt64

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.formats.merging.mixture import Mixture
from gsgen.formats.shared.quantities import log, logit, sigmoid, unit
from gsgen.formats.shared.splats import SH_COUNTS, Splats


def mixture_of(splats: Splats, codes: UInt64[np.ndarray, " n"]) -> Mixture:
    """Convert splats to Gaussians for merging, in the same order."""
    scale = np.exp(splats.log_scale.astype(np.float64))
    rotation = unit(splats.rotation)
    return Mixture(
        code=codes,
        mean=splats.position.astype(np.float64),
        covariance=covariance_upper(scale, rotation),
        scale=scale,
        rotation=rotation,
        opacity=sigmoid(splats.logit_opacity).astype(np.float64),
        sh=splats.sh,
    )


def splats_of(mixture: Mixture, degree: int) -> Splats:
    """Convert merged Gaussians to splats, with spherical harmonics up to ``degree``."""
    return Splats(
        position=mixture.mean.astype(np.float32),
        rotation=mixture.rotation,
        log_scale=log(mixture.scale),
        logit_opacity=logit(mixture.opacity),
        sh=np.ascontiguousarray(mixture.sh[:, : SH_COUNTS[degree]]),
    )
