"""Converts one frame of an ONNX generator (packed Gaussians and colours) to splats."""

import numpy as np
from jaxtyping import Float32

from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.principal_axes import scales_and_quaternions
from gsgen.formats.shared.quantities import SH_C0, log, logit
from gsgen.formats.shared.splats import SH_COUNTS, PackedRows, Splats

__all__ = ["splats_of_rows"]


def splats_of_rows(rows: PackedRows) -> Splats:
    """Convert packed Gaussians of an ONNX generator to splats of equal covariance and colour.

    Scales and rotations are those of :func:`scales_and_quaternions`. Three or four channels are
    raw colour.
    """
    rows64 = rows.gaussians.astype(np.float64)
    if not np.isfinite(rows64).all():
        row = int(np.argmin(np.isfinite(rows64).all(axis=1)))
        raise ValueInvalid(
            f"row {row} of the packed Gaussians is not finite",
            where="gaussians",
            expected="finite numbers",
        )
    scales, quaternions = scales_and_quaternions(rows.gaussians[:, 4:])
    return Splats(
        position=rows.gaussians[:, :3].astype(np.float32),
        rotation=quaternions,
        log_scale=log(scales),
        logit_opacity=logit(np.clip(rows64[:, 3], 0, 1)),
        sh=_harmonics(rows.appearance.astype(np.float32)),
    )


def _harmonics(appearance: Float32[np.ndarray, "n c"]) -> Float32[np.ndarray, "n k 3"]:
    channels = appearance.shape[1]
    if channels in (3, 4):
        return np.asarray((appearance[:, None, :3] - 0.5) / SH_C0, np.float32)
    if channels not in [3 * count for count in SH_COUNTS]:
        raise ValueInvalid(
            f"the appearance has {channels} channels",
            where="appearance",
            expected="3 or 4 channels of RGB, or 12, 27, 48 or 75 of SH",
        )
    return appearance.reshape(len(appearance), channels // 3, 3)
