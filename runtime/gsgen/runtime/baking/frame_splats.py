"""Converts the drawn Gaussians of successive frames to the splat parameters that files store."""

__all__ = ["FrameConverter"]

import math
from typing import Literal, final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

from gsgen.contract.spec.layout import CULL_OPACITY, DecodedGaussians
from gsgen.formats import Splats
from gsgen.formats.shared.principal_axes import scales_and_quaternions
from gsgen.formats.shared.quantities import SH_C0, log, logit

# Below this, float32 cannot square a scale; formats and viewers need a finite logarithm.
_MIN_SCALE = 1e-19


def _finite_rows(array: Float[np.ndarray, "n ..."]) -> Bool[np.ndarray, " n"]:
    with np.errstate(over="ignore", invalid="ignore"):
        if math.isfinite(array.sum()):  # only where all summands are; reads each number once
            return np.ones(len(array), bool)
    return np.asarray(np.isfinite(array.reshape(len(array), -1)).all(axis=1))


def _colors(gaussians: DecodedGaussians) -> Float[np.ndarray, "n ..."]:
    colors = gaussians.rgb if gaussians.sh is None else gaussians.sh
    assert colors is not None
    return colors


@final
class FrameConverter:
    """Converts the drawn Gaussians of successive frames to splats; positions stay bit for bit.

    Most generators move Gaussians that keep their colours, and many their covariances. A covariance
    with the bits of the row's last one is not decomposed again.
    """

    def __init__(
        self, *, antialiased: bool = False, color_space: Literal["srgb", "linear"] = "srgb"
    ) -> None:
        self._antialiased = antialiased
        self._color_space: Literal["srgb", "linear"] = color_space
        self._bits = np.empty((0, 3), np.uint64)  # of the covariances that were decomposed
        self._log_scale = np.empty((0, 3), np.float32)
        self._rotation = np.empty((0, 4), np.float32)
        self._colors = np.empty((0, 3), np.float32)
        self._has_finite_colors = np.empty(0, bool)

    def drawn_mask(self, gaussians: DecodedGaussians) -> tuple[Bool[np.ndarray, " n"], int]:
        """Return the mask of drawn Gaussians, and the number of rows that are not finite.

        A Gaussian is drawn if all its numbers are finite and its opacity is at least 1/255.
        """
        if self._colors is not _colors(gaussians):
            self._colors = _colors(gaussians)
            self._has_finite_colors = _finite_rows(self._colors)
        finite = self._has_finite_colors & _finite_rows(gaussians.position)
        finite &= _finite_rows(gaussians.opacity) & _finite_rows(gaussians.covariance)
        return finite & (gaussians.opacity >= np.float32(CULL_OPACITY)), int((~finite).sum())

    def convert(self, gaussians: DecodedGaussians, is_drawn: Bool[np.ndarray, " n"]) -> Splats:
        """Convert a frame's drawn Gaussians to the parameters of splat files, such as log scales.

        Drawn Gaussians are finite. The colours are those of ``gaussians`` where all are drawn, and
        no copy.
        """
        self._decompose(np.ascontiguousarray(gaussians.covariance, np.float32), is_drawn)
        rows = _selection(is_drawn)
        colors = np.asarray(_colors(gaussians)[rows], np.float32)
        if gaussians.sh is None:
            colors = ((colors.astype(np.float64)[:, None, :] - 0.5) / SH_C0).astype(np.float32)
        return Splats(
            position=np.array(gaussians.position[rows], np.float32, order="C"),
            rotation=np.array(self._rotation[rows]),
            log_scale=np.array(self._log_scale[rows]),
            logit_opacity=logit(np.clip(gaussians.opacity[rows], 0, 1)),
            sh=np.ascontiguousarray(colors),
            antialiased=self._antialiased,
            color_space=self._color_space,
        )

    def _decompose(
        self, covariance: Float32[np.ndarray, "n 6"], is_drawn: Bool[np.ndarray, " n"]
    ) -> None:
        """Update scales and rotations of the drawn rows whose covariance changed."""
        bits = covariance.view(np.uint64)
        if len(bits) != len(self._bits):
            self._bits = np.full_like(bits, np.iinfo(np.uint64).max)  # NaN: no row is up to date
            self._log_scale = np.empty((len(bits), 3), np.float32)
            self._rotation = np.empty((len(bits), 4), np.float32)
        changed = np.logical_or.reduce([bits[:, i] != self._bits[:, i] for i in range(3)])
        rows = _selection(is_drawn & changed)
        scales, self._rotation[rows] = scales_and_quaternions(covariance[rows])
        self._log_scale[rows] = log(np.maximum(scales, _MIN_SCALE))
        self._bits[rows] = bits[rows]


def _selection(mask: Bool[np.ndarray, " n"]) -> slice | Int64[np.ndarray, " m"]:
    """Return an index for the rows that a mask selects: for all rows a slice, without copying."""
    return slice(None) if mask.all() else np.flatnonzero(mask)
