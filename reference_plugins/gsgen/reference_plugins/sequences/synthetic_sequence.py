"""Writes synthetic sequences: a torus knot that bends and turns, with Gaussians that come and go."""

__all__ = ["moving_knot", "write_sequence"]

from dataclasses import replace
from pathlib import Path

import numpy as np

from gsgen.formats import Splats, write_ply
from gsgen.reference_plugins.writing.knot import torus_knot

_BEND_ANGLE, _RISE = 0.9, 0.15
_FADING_STRIDE = 8
_INVISIBLE_LOGIT = -12.0


def moving_knot(time: float, rows: int) -> Splats:
    """Return the knot at a time in [0, 1]; rows correspond, and every eighth one is born and dies."""
    knot = torus_knot(rows)
    x, y, z = knot.position.astype(np.float64).T
    angle = _BEND_ANGLE * np.sin(2 * np.pi * time) * y
    cos, sin = np.cos(angle), np.sin(angle)
    position = np.stack(
        [cos * x + sin * z, y + _RISE * np.sin(2 * np.pi * time + 2 * x), cos * z - sin * x], axis=1
    )
    # The quaternion of the turn around y, times each Gaussian's own.
    half_cos, half_sin = np.cos(angle / 2), np.sin(angle / 2)
    w, i, j, k = knot.rotation.astype(np.float64).T
    rotation = np.stack(
        [
            half_cos * w - half_sin * j,
            half_cos * i + half_sin * k,
            half_cos * j + half_sin * w,
            half_cos * k - half_sin * i,
        ],
        axis=1,
    )
    logit = knot.logit_opacity.copy()
    # A window of a third of the time, at another moment for each Gaussian that fades.
    birth = np.linspace(0, 1, len(logit[::_FADING_STRIDE]))
    window = np.clip(1 - np.abs(time - birth) * 6, 0, 1)
    logit[::_FADING_STRIDE] = np.where(
        window > 0, logit[::_FADING_STRIDE] + np.log(np.maximum(window, 1e-6)), _INVISIBLE_LOGIT
    )
    return replace(
        knot,
        position=position.astype(np.float32),
        rotation=rotation.astype(np.float32),
        logit_opacity=logit.astype(np.float32),
    )


def write_sequence(folder: Path, *, rows: int, frames: int) -> list[Path]:
    """Write the knot's frames as numbered PLY files, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{number:04d}.ply" for number in range(frames)]
    for number, path in enumerate(paths):
        write_ply(path, moving_knot(number / frames, rows))
    return paths
