"""Converts the drawn Gaussians of successive frames to the splat parameters that files store."""

__all__ = ["FrameConverter"]

import math
from typing import Literal, final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

from gsgen.contract.spec.layout import CULL_OPACITY, DecodedGaussians
from gsgen.formats import Splats
from gsgen.formats.shared.principal_axes import variances_and_quaternions
from gsgen.formats.shared.quantities import SH_C0, logit

# Of a scale that float32 can still square; formats and viewers need a finite logarithm.
_MIN_VARIANCE = 1e-19**2


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
        self._is_antialiased = antialiased
        self._color_space: Literal["srgb", "linear"] = color_space
        self._bits = np.empty((0, 3), np.uint64)  # of the covariances that were decomposed
        self._log_scale = np.empty((0, 3), np.float32)
        self._rotation = np.empty((0, 4), np.float32)
        self._colors = np.empty((0, 3), np.float32)
        self._has_finite_colors = np.empty(0, bool)
        self._selected_colors = self._colors  # of which, and of which rows, the coefficients are
        self._selected_rows = self._has_finite_colors
        self._sh = np.empty((0, 1, 3), np.float32)

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
        self._decompose_covariances(np.array(gaussians.covariance, np.float32, order="C"), is_drawn)
        rows = _selection(is_drawn)
        return Splats(
            position=np.array(gaussians.position[rows], np.float32, order="C"),
            rotation=self._rotation[rows],
            log_scale=self._log_scale[rows],
            logit_opacity=logit(np.clip(gaussians.opacity[rows], 0, 1)),
            sh=self._coefficients(gaussians, is_drawn),
            antialiased=self._is_antialiased,
            color_space=self._color_space,
        )

    def _coefficients(
        self, gaussians: DecodedGaussians, is_drawn: Bool[np.ndarray, " n"]
    ) -> Float32[np.ndarray, "m k 3"]:
        """Return the SH coefficients of the drawn rows: the last frame's array where they are."""
        colors = _colors(gaussians)
        if self._selected_colors is colors and np.array_equal(self._selected_rows, is_drawn):
            return self._sh
        self._selected_colors, self._selected_rows = colors, is_drawn
        sh = np.asarray(colors[_selection(is_drawn)], np.float32)
        if gaussians.sh is None:
            sh = ((sh.astype(np.float64)[:, None, :] - 0.5) / SH_C0).astype(np.float32)
        self._sh = np.ascontiguousarray(sh)
        return self._sh

    def _decompose_covariances(
        self, covariance: Float32[np.ndarray, "n 6"], is_drawn: Bool[np.ndarray, " n"]
    ) -> None:
        """Update scales and rotations of the drawn rows whose covariance changed."""
        bits = covariance.view(np.uint64)
        if len(bits) != len(self._bits):
            self._bits = np.full_like(bits, np.iinfo(np.uint64).max)  # NaN: no row is up to date
            self._log_scale = np.empty((len(bits), 3), np.float32)
            self._rotation = np.empty((len(bits), 4), np.float32)
        is_changed_column = np.logical_or.reduce([bits[:, i] != self._bits[:, i] for i in range(3)])
        rows = _selection(is_drawn & is_changed_column)
        variances, rotation = variances_and_quaternions(covariance[rows])
        log_scale = np.empty((len(rotation), 3), np.float32)
        for axis, variance in enumerate(variances):
            log_scale[:, axis] = 0.5 * np.log(np.maximum(variance, _MIN_VARIANCE))
        if isinstance(rows, slice):
            self._bits, self._rotation, self._log_scale = bits, rotation, log_scale
        elif len(rows):
            # The arrays of the last frame may be in a file's queue: they stay as they are.
            self._bits[rows] = bits[rows]
            self._rotation = self._rotation.copy()
            self._rotation[rows] = rotation
            self._log_scale = self._log_scale.copy()
            self._log_scale[rows] = log_scale


def _selection(mask: Bool[np.ndarray, " n"]) -> slice | Int64[np.ndarray, " m"]:
    """Return an index for the rows that a mask selects: for all rows a slice, without copying."""
    return slice(None) if mask.all() else np.flatnonzero(mask)
