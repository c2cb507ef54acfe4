"""Writes synthetic checkpoints of Ex4DGS, as its training code does.

The Gaussians are a torus knot: one half drifts, the other swings from key frame to key frame,
appears and fades.
"""

__all__ = ["write_ex4dgs"]

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from gsgen.formats import Splats
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.reference_plugins.writing.run_files import splat_columns, write_cfg_args, write_columns

_ITERATION_NUMBER = 40_000
_PREFIX = "motion_"
_TIME_PAD = 2
# The duration is value 19 of the 40 of capture().
_VALUES_BEFORE_DURATION, _VALUES_AFTER_DURATION = 19, 20


def write_ex4dgs(
    folder: Path,
    *,
    count: int = 64,
    degree: int = 3,
    interpolation: str = "cube",
    frames: int = 50,
    interval: int = 10,
    captured_duration: int | None = None,
    sway: float = 0.6,
    seed: int = 0,
) -> Path:
    """Write a synthetic checkpoint of Ex4DGS, and return the folder.

    ``interpolation`` is that of the centres; ``interval`` is that of the key frames;
    ``captured_duration`` adds a ``chkpntN.pth`` in which only that is filled in; ``sway`` is the approximate movement, of a
    knot that is three units wide.
    """
    rng = np.random.default_rng(seed)
    still = torus_knot((count + 1) // 2, degree=degree, seed=seed)
    moving = torus_knot(count // 2, degree=degree, seed=seed + 1)
    columns = splat_columns(still)
    # Trained quaternions are nearly of length 1, and drawn as they are.
    length = np.linalg.norm(still.rotation, axis=1) / rng.normal(1, 0.02, len(still))
    columns |= {f"rot_{i}": still.rotation[:, i] / length for i in range(4)}
    drift = rng.normal(0, 0.1 * sway, (len(still), 3))
    columns |= {f"xyz_disp_{i}": drift[:, i] for i in range(3)}
    options: dict[str, Any] = {
        "model": "cubic", "interp_type": interpolation, "rot_interp_type": "slerp",
        "sh_degree": degree, "duration": frames, "time_interval": interval,
        "time_pad": _TIME_PAD, "var_pad": 3,
    }  # fmt: skip
    write_cfg_args(folder, options)
    files = folder / f"point_cloud/iteration_{_ITERATION_NUMBER}"
    write_columns(files / "point_cloud.ply", columns)
    shift = _TIME_PAD + (0 if interpolation == "linear" else interval)
    moving_columns = _key_frame_columns(moving, frames, interval, shift, sway, rng)
    write_columns(files / "dynamic_point_cloud.ply", moving_columns)
    if captured_duration is not None:
        before, after = (None,) * _VALUES_BEFORE_DURATION, (None,) * _VALUES_AFTER_DURATION
        values = (*before, captured_duration, *after)
        torch.save((values, _ITERATION_NUMBER), folder / f"chkpnt{_ITERATION_NUMBER}.pth")
    return folder


def _key_frame_columns(
    splats: Splats, frames: int, interval: int, shift: int, sway: float, rng: np.random.Generator
) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the columns of Gaussians that swing around their places."""
    count, keys = len(splats), math.ceil((frames + 2 * shift + 1) / interval) + 3
    phase = np.arctan2(splats.position[:, 2], splats.position[:, 0])[:, None]
    # Once up and down, and a turn around the axis y, over all key frames.
    swing = 2 * np.pi * np.arange(keys) / keys + 3 * phase
    sideways = 0.5 * np.cos(2 * swing)
    offset = [np.cos(phase) * sideways, np.sin(swing), np.sin(phase) * sideways]
    position = splats.position[:, None] + sway * np.stack(offset, axis=2)
    turn = np.cumsum(rng.normal(0, 0.35, (count, keys, 4)), axis=1)
    rotation = splats.rotation[:, None] + turn
    # Gaussians appear one after another along the knot; each third lasts as long as the scene.
    middle = np.linspace(0, frames, count) + shift
    half = np.where(np.arange(count) % 3 == 0, frames, rng.uniform(0.05, 0.3, count) * frames)
    visible = np.stack([middle - half, middle + half], axis=1) / interval
    swapped = np.arange(count) % 7 == 1  # training does not sort the two
    visible[swapped] = visible[swapped, ::-1]
    columns = {
        f"{_PREFIX}xyz_{key}_{axis}": position[:, key, axis]
        for key in range(keys) for axis in range(3)
    }  # fmt: skip
    colors = splat_columns(splats)
    columns |= {f"{_PREFIX}{name}": value for name, value in colors.items() if name[:2] == "f_"}
    columns |= {f"{_PREFIX}scale_{i}": splats.log_scale[:, i] for i in range(3)}
    columns |= {f"{_PREFIX}opacity": splats.logit_opacity}
    columns |= {f"{_PREFIX}opacity_c_{i}": visible[:, i] for i in range(2)}
    log_width = rng.normal(-1.0, 0.5, (count, 2))
    columns |= {f"{_PREFIX}opacity_v_{i}": log_width[:, i] for i in range(2)}
    columns |= {
        f"{_PREFIX}rot_{key}_{part}": rotation[:, key, part]
        for key in range(keys) for part in range(4)
    }  # fmt: skip
    return columns
