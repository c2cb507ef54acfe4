"""Fits the local rotation of Gaussians between two model runs, from their neighbours."""

__all__ = ["LocalRotations", "fit_local_rotations"]

from dataclasses import dataclass

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.spec.layout import POSITION

# A neighbourhood moves rigidly if this fraction of its size remains after the fit, or less.
_RIGID = 0.05
# Neighbours that lie on a line leave the rotation about it open.
_COLLINEAR = 0.15
_SMALLEST = 1e-30


@dataclass(frozen=True, kw_only=True)
class LocalRotations:
    """The rotation of each sampled Gaussian's neighbourhood between two model runs.

    Attributes:
        rotation: The fitted rotations, [m, 3, 3].
        angle: Their angles, in radians, [m].
        is_rigid: Whether the fit explains the motion, [m].
    """

    rotation: Float[np.ndarray, "m 3 3"]
    angle: Float[np.ndarray, " m"]
    is_rigid: Bool[np.ndarray, " m"]


def fit_local_rotations(sample: DrawnSample, later: Float[np.ndarray, "n 10"]) -> LocalRotations:
    """Fit the rotation of each Gaussian's neighbourhood between two runs (Kabsch 1976).

    Args:
        sample: Drawn rows of the first run.
        later: The same rows of the second run, in the order of ``sample.rows``, float64.
    """
    position = later[:, POSITION]
    a, b = sample.offsets, position[sample.neighbours] - position[sample.inner][:, None]
    left, stretch, right = np.linalg.svd(b.transpose(0, 2, 1) @ a)
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= np.where(sign == 0, 1, sign)[:, None]
    rotation = left @ right
    size = np.maximum(np.sqrt(np.square(a).sum(axis=(1, 2))), _SMALLEST)
    residual = np.sqrt(np.square(b - a @ rotation.transpose(0, 2, 1)).sum(axis=(1, 2))) / size
    spread = np.sqrt(stretch[:, 1] / np.maximum(stretch[:, 0], _SMALLEST))
    cosine = (np.trace(rotation, axis1=1, axis2=2) - 1) / 2
    return LocalRotations(
        rotation=rotation,
        angle=np.arccos(np.clip(cosine, -1, 1)),
        is_rigid=(residual <= _RIGID) & (spread >= _COLLINEAR),
    )
