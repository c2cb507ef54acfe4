"""Converts packed rows, such as a frame of a generator, to splats."""

import numpy as np
from jaxtyping import Float32

from gsgen.contract.spec.geometry import symmetric
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.quantities import SH_C0, log, logit, rotations
from gsgen.formats.shared.splats import SH_COUNTS, PackedRows, Splats

__all__ = ["splats_of_rows"]


def splats_of_rows(rows: PackedRows) -> Splats:
    """Convert packed rows to splats with the same covariances, opacities and colours.

    The axes are the eigenvectors of the covariance, the scales the roots of its eigenvalues (0
    if rounding made one negative). Three or four channels are raw colour.
    """
    rows64 = rows.gaussians.astype(np.float64)
    if not np.isfinite(rows64).all():
        row = int(np.argmin(np.isfinite(rows64).all(axis=1)))
        raise ValueInvalid(f"row {row} is not finite", where="gaussians", expected="finite numbers")
    variances, axes = np.linalg.eigh(symmetric(rows64[:, 4:]))
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    return Splats(
        position=rows.gaussians[:, :3].astype(np.float32),
        rotation=rotations(axes),
        log_scale=log(np.sqrt(np.maximum(variances, 0))),
        logit_opacity=logit(np.clip(rows64[:, 3], 0, 1)),
        sh=_harmonics(rows.appearance.astype(np.float32)),
    )


def _harmonics(appearance: Float32[np.ndarray, "n c"]) -> Float32[np.ndarray, "n k 3"]:
    channels = appearance.shape[1]
    if channels in (3, 4):
        return np.asarray((appearance[:, None, :3] - 0.5) / SH_C0, np.float32)
    if channels not in [3 * count for count in SH_COUNTS]:
        raise ValueInvalid(
            f"{channels} channels",
            where="appearance",
            expected="3 or 4 of colour, or 12, 27, 48 or 75 of harmonics",
        )
    return appearance.reshape(len(appearance), channels // 3, 3)
