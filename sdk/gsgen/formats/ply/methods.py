"""Recognises PLY properties of methods that change the meaning of a splat, such as motion."""

import re
from collections.abc import Collection
from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.contract._entry_points import registered_entry_points
from gsgen.formats.shared.errors import NotSupported, join_names
from gsgen.formats.shared.quantities import logit, sigmoid

FILTER_PROPERTY: Final = "filter_3D"
"""The property of Mip-Splatting (Yu et al. 2023): the size of its smoothing filter, in units."""

_METHOD_PROPERTIES: Final = (
    ("SpacetimeGaussians", "spacetime-gaussians", re.compile(r"motion_\d+|omega_\d+|trbf_\w+")),
    ("GaussianAvatars", "gaussian-avatars", re.compile(r"binding_\d+")),
    ("Ex4DGS", "ex4dgs", re.compile(r"xyz_disp_\d+|motion_(?:xyz|rot)_\d+_\d+")),
    ("rotor 4DGS", "rotor-4dgs", re.compile(r"scale_t|t_scale|rot_r_\d+|rotation_r_\d+")),
)


def require_still_splats(names: Collection[str]) -> None:
    """Raise NotSupported if PLY properties animate the splats, or attach them to triangles."""
    for title, plugin, pattern in _METHOD_PROPERTIES:
        matches = [name for name in names if pattern.fullmatch(name)]
        if not matches:
            continue
        is_plugin_installed = plugin in {
            point.name for point in registered_entry_points("gsgen.generators")
        }
        raise NotSupported(
            f"{join_names(matches, limit=6)}: splats of {title}, which move or follow triangles",
            where="element 'vertex'",
            expected="the properties of a 3DGS PLY",
            hint=f"`gsgen export {plugin} --checkpoint FILE -o OUT.onnx` exports them"
            if is_plugin_installed
            else "no installed plugin reads them; bake one moment with the method's own code",
        )


def with_smoothing_filter(
    log_scale: Float32[np.ndarray, "n 3"],
    logit_opacity: Float32[np.ndarray, " n"],
    size: Float32[np.ndarray, " n"],
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
    """Apply the 3-D smoothing filter of Mip-Splatting (Yu et al. 2023, equation 7).

    A variance s² becomes s² + f², and the opacity is multiplied by √(Π s² / Π (s² + f²)).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scale64 = log_scale.astype(np.float64)
        filtered_log_scale = (
            np.logaddexp(2 * log_scale64, 2 * np.log(np.abs(size.astype(np.float64)))[:, None]) / 2
        )
        ratio = np.exp(
            np.where(np.isneginf(filtered_log_scale), 0, log_scale64 - filtered_log_scale).sum(
                axis=1
            )
        )
        opacity = sigmoid(logit_opacity).astype(np.float64) * ratio
    # Without a filter nothing changes, not even by rounding.
    is_unfiltered = size == 0
    return (
        np.where(is_unfiltered[:, None], log_scale, filtered_log_scale).astype(np.float32),
        np.where(is_unfiltered, logit_opacity, logit(opacity)).astype(np.float32),
    )
