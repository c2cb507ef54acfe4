"""A synthetic scene: splats along a torus knot."""

__all__ = ["torus_knot"]

import numpy as np

from gsgen.contract.spec.spherical_harmonics import basis, coefficients
from gsgen.formats import Splats
from gsgen.formats.shared.quantities import SH_C0


def torus_knot(count: int, *, degree: int = 3, seed: int = 0) -> Splats:
    """Return splats along a (2, 3) torus knot, coloured along its length and shiny.

    The knot is three units wide. Colours come from SH: the constant term is the hue, the others
    are the projection of a soft lobe around the upward direction.

    Above ``degree`` 0, the colour has a highlight from above.
    """
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 2 * np.pi, count))
    radius = 1 + 0.4 * np.cos(3 * t)
    centre = np.stack(
        [radius * np.cos(2 * t), -0.4 * np.sin(3 * t), radius * np.sin(2 * t)], axis=1
    )
    position = centre + 0.06 * rng.normal(size=(count, 3))
    color = 0.5 + 0.45 * np.cos(t[:, None] + np.array([0.0, 2.1, 4.2]))
    k = coefficients(degree)
    sh = np.zeros((count, k, 3))
    lobe_coefficients = basis(np.array([[0.0, -1.0, 0.0]]), degree)[0]
    sh_band_strength = np.repeat([1.0, 0.45, 0.2, 0.08], [1, 3, 5, 7])[:k]
    sh += (0.25 * sh_band_strength * lobe_coefficients)[None, :, None]
    sh[:, 0] += (color - 0.5) / SH_C0
    log_scale = np.log(0.02) + 0.4 * rng.normal(size=(count, 3))
    return Splats(
        position=position.astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        log_scale=log_scale.astype(np.float32),
        logit_opacity=rng.normal(1.5, 1.0, count).astype(np.float32),
        sh=sh.astype(np.float32),
    )
