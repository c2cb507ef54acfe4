"""Reads checkpoints of Ex4DGS: Gaussians that drift, and Gaussians with key frames.

The layout is that of juno181/Ex4DGS (``scene/c_gaussian_model.py``): two PLY files for each
iteration. ``cfg_args`` has the distance of key frames, without which they have no meaning.
"""

__all__ = [
    "DriftingSplats",
    "Ex4DGSCheckpoint",
    "Interpolation",
    "KeyFrameSplats",
    "KeyFrameTimes",
    "read_ex4dgs",
]

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, coefficients
from gsgen.formats import ply_properties, read_ply_columns
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.tensor_files import load_tensors
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run

Interpolation = Literal["cube", "pchip", "linear"]

_KEY_FRAME_PATTERN = re.compile(r"motion_xyz_(\d+)_0")
_REST_PATTERN = re.compile(r"(?:motion_)?f_rest_\d+")
# Key frames that a moment needs: the first, relative to the one before it, and the last.
_NEEDED_KEY_FRAMES: dict[Interpolation, tuple[int, int]] = {
    "cube": (-1, 2), "pchip": (-1, 2), "linear": (0, 1),
}  # fmt: skip
# Of the values of capture() in chkpntN.pth, only the duration is read.
_CAPTURE_LENGTH, _DURATION_FIELD = 40, 19
# The published code divides var_pad by this, and adds it to each width.
_WIDTH_DIVISOR = 2.36


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftingSplats:
    """N Gaussians that move along a line, before activation, float32."""

    position: Float[Tensor, "n 3"]  # centres in the first frame
    drift: Float[Tensor, "n 3"]  # movement over ``KeyFrameTimes.drift_duration``
    rotation: Float[Tensor, "n 4"]  # quaternions (w, x, y, z), which are not normalised
    log_scale: Float[Tensor, "n 3"]  # logarithms of the standard deviations
    logit_opacity: Float[Tensor, "n 1"]  # opacity before the sigmoid
    sh: Float[Tensor, "n c 3"]  # SH coefficients

    def __len__(self) -> int:
        return self.position.shape[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFrameSplats:
    """M Gaussians with K key frames each, before activation, float32."""

    position: Float[Tensor, "m k 3"]  # centres in the key frames
    rotation: Float[Tensor, "m k 4"]  # quaternions (w, x, y, z) in the key frames
    log_scale: Float[Tensor, "m 3"]  # logarithms of the standard deviations
    logit_opacity: Float[Tensor, "m 1"]  # highest opacity before the sigmoid
    # Key frame numbers between which the opacity is highest; either may be the first.
    visible: Float[Tensor, "m 2"]
    log_width: Float[Tensor, "m 2"]  # logarithms of how fast it rises and falls
    sh: Float[Tensor, "m c 3"]  # SH coefficients

    def __len__(self) -> int:
        return self.position.shape[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFrameTimes:
    """When the key frames are, in frames of the video, and what is between them."""

    frames: int  # frames of the video
    interval: int  # frames from one key frame to the next
    shift: int  # frames from the first key frame to the first frame
    drift_duration: float  # frames after which a drift is complete
    min_width: float  # what is added to each width, in intervals
    interpolation: Interpolation

    @property
    def last_frame(self) -> int:
        """The frame at time 1; a video of one frame is continued to a second one."""
        return max(self.frames - 1, 1)

    @property
    def needed(self) -> tuple[int, int]:
        """Key frames that a moment needs, relative to the one before it: first and last."""
        return _NEEDED_KEY_FRAMES[self.interpolation]

    @classmethod
    def of(cls, cfg: CfgArgs, captured_duration: float | None) -> "KeyFrameTimes":
        """Read the options of Ex4DGS from ``cfg_args``, and check them.

        ``captured_duration`` is the one with which training ended; if absent, it is taken to be
        the number of frames, as the published code takes it.
        """
        interpolation = cfg.word("interp_type", "cube", get_args(Interpolation))
        cfg.word("rot_interp_type", "slerp", ("slerp",))
        frames, interval = cfg.integer("duration", -1), cfg.integer("time_interval", 5)
        pad = cfg.integer("time_pad", 3)
        for name, value, least in (
            ("duration", frames, 1), ("time_interval", interval, 1), ("time_pad", pad, 0),
        ):  # fmt: skip
            if value < least:
                message = f"{name} is {value}, expected at least {least}"
                raise CheckpointInvalid(message, where=str(cfg.path))
        width = cfg.number("var_pad", 3)
        if not 0 <= width < math.inf:
            raise CheckpointInvalid(
                f"var_pad is {width:g}, expected 0 or more", where=str(cfg.path)
            )
        return cls(
            frames=frames,
            interval=interval,
            # A curve needs a key frame more before the first frame than a line.
            shift=pad if interpolation == "linear" else pad + interval,
            drift_duration=captured_duration or float(frames),
            min_width=width / interval / _WIDTH_DIVISOR,
            interpolation=interpolation,  # type: ignore[arg-type]  # one of the known words
        )


@dataclass(frozen=True, slots=True)
class Ex4DGSCheckpoint:
    """The Gaussians of an Ex4DGS checkpoint, and the times of its key frames."""

    run: TrainingRun
    drifting: DriftingSplats
    moving: KeyFrameSplats
    times: KeyFrameTimes

    def describe(self) -> str:
        """Describe an Ex4DGS checkpoint in one line: Gaussians, key frames and frames."""
        times = self.times
        degree = math.isqrt(self.moving.sh.shape[1]) - 1
        return (
            f"{self.run}, {len(self.drifting):,} drifting Gaussians and {len(self.moving):,} with "
            f"{self.moving.position.shape[1]} key frames ({times.interpolation}), one every "
            f"{times.interval} of {times.frames} frames, SH degree {degree}"
        )


def read_ex4dgs(path: Path, iteration: int | None = None) -> Ex4DGSCheckpoint:
    """Read a checkpoint of Ex4DGS: the folder of a run, an iteration, or a file in either."""
    run = open_run("ex4dgs", path, iteration, needs_cfg=True)
    times = KeyFrameTimes.of(run.cfg, _captured_duration(run))
    drifting_file = required_file(run.files / "point_cloud.ply", "the Gaussians that drift")
    moving_file = required_file(
        run.files / "dynamic_point_cloud.ply", "the Gaussians with key frames"
    )
    with format_faults(drifting_file):
        drifting = _read_drifting(drifting_file)
    with format_faults(moving_file):
        moving = _read_moving(moving_file, times)
    if drifting.sh.shape[1] != moving.sh.shape[1]:
        message = (
            f"has {moving.sh.shape[1]} SH coefficients, point_cloud.ply {drifting.sh.shape[1]}"
        )
        raise CheckpointInvalid(message, where=str(moving_file))
    return Ex4DGSCheckpoint(run, drifting, moving, times)


def _captured_duration(run: TrainingRun) -> float | None:
    """Return the duration with which training ended, or None without ``chkpntN.pth``."""
    path = run.folder / f"chkpnt{run.iteration}.pth"
    if not path.is_file():
        return None
    hint = "Training of Ex4DGS writes chkpntN.pth; without it, drifts are those of the PLY alone."
    content = load_tensors(path, hint)
    values = content[0] if isinstance(content, tuple) and len(content) == 2 else None
    if not isinstance(values, tuple) or len(values) != _CAPTURE_LENGTH:
        message = f"is not the pair of {_CAPTURE_LENGTH} values of capture() and the iteration"
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    duration = values[_DURATION_FIELD]
    is_number = isinstance(duration, int | float) and not isinstance(duration, bool)
    if not is_number or not 0 < duration < math.inf:
        message = f"the duration, value {_DURATION_FIELD} of capture(), is {duration!r:.80}"
        raise CheckpointInvalid(message, where=str(path), hint="Expected a number of frames.")
    return float(duration)


def _read_drifting(path: Path) -> DriftingSplats:
    groups = {
        "position": list("xyz"),
        "drift": _numbered_names("xyz_disp", 3),
        "rotation": _numbered_names("rot", 4),
        "log_scale": _numbered_names("scale", 3),
        "logit_opacity": ["opacity"],
    }
    tables = read_ply_columns(path, groups | _sh_groups(path, ""))
    sh = _sh(tables)
    return DriftingSplats(sh=sh, **{name: torch.from_numpy(tables[name]) for name in groups})


def _read_moving(path: Path, times: KeyFrameTimes) -> KeyFrameSplats:
    matches = (_KEY_FRAME_PATTERN.fullmatch(name) for name in ply_properties(path))
    count = 1 + max((int(match[1]) for match in matches if match), default=-1)
    # The key frame before the last frame, and those after it.
    needed = (times.last_frame + times.shift) // times.interval + times.needed[1] + 1
    if count < needed:
        message = f"has {count} key frames, but {times.frames} frames need {needed}"
        hint = "cfg_args must be the one of this run: duration, time_interval, time_pad."
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    groups = {
        "position": [f"motion_xyz_{key}_{axis}" for key in range(count) for axis in range(3)],
        "rotation": [f"motion_rot_{key}_{axis}" for key in range(count) for axis in range(4)],
        "log_scale": _numbered_names("motion_scale", 3),
        "logit_opacity": ["motion_opacity"],
        "visible": _numbered_names("motion_opacity_c", 2),
        "log_width": _numbered_names("motion_opacity_v", 2),
    }
    tables = read_ply_columns(path, groups | _sh_groups(path, "motion_"))
    tensors = {name: torch.from_numpy(tables[name]) for name in groups}
    for name, columns in (("position", 3), ("rotation", 4)):
        tensors[name] = tensors[name].reshape(-1, count, columns)
    return KeyFrameSplats(sh=_sh(tables), **tensors)


def _sh_groups(path: Path, prefix: str) -> dict[str, list[str]]:
    """Return the columns of SH coefficients; raise if their number is that of no degree."""
    rest = sum(_REST_PATTERN.fullmatch(name) is not None for name in ply_properties(path))
    if rest not in {3 * (coefficients(degree) - 1) for degree in range(MAX_DEGREE + 1)}:
        message = f"has {rest} columns {prefix}f_rest, expected those of degree 0 to {MAX_DEGREE}"
        raise CheckpointInvalid(message, where=str(path))
    return {
        "dc": _numbered_names(f"{prefix}f_dc", 3),
        "rest": _numbered_names(f"{prefix}f_rest", rest),
    }


def _sh(tables: Mapping[str, Float[np.ndarray, "n m"]]) -> Float[Tensor, "n c 3"]:
    dc, rest = torch.from_numpy(tables["dc"]), torch.from_numpy(tables["rest"])
    # All coefficients of red come first.
    return torch.cat([dc[:, None], rest.reshape(len(dc), 3, -1).transpose(1, 2)], dim=1)


def _numbered_names(name: str, count: int) -> list[str]:
    return [f"{name}_{index}" for index in range(count)]
