"""Reads checkpoints of rotor 4DGS: 4-D Gaussians with two quaternions each.

``chkpntN.pth`` is the pair of ``capture()`` and the iteration (fudan-zvg/4d-gaussian-splatting,
``scene/gaussian_model.py``). No file of a run has the times of its first and last frame; they are
``time_duration`` in the configuration of the training.
"""

__all__ = ["RotorCheckpoint", "RotorSplats", "read_rotor", "read_time_duration"]

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.loading.cfg_args import read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.loading.folder import likely_folders, required_file
from gsgen.reference_plugins.loading.states import Shape, require_tensors
from gsgen.reference_plugins.loading.tensor_files import load_tensors
from gsgen.reference_plugins.loading.training_run import TrainingRun

_FILE_PATTERN = re.compile(r"chkpnt(\d+)\.pth")
_BEST_FILE = "chkpnt_best.pth"
# The values of capture() that are read: name → index and columns; all of N rows.
_CHECKPOINT_FIELDS = {
    "position": (1, 3), "log_scale": (4, 3), "rotation": (5, 4), "logit_opacity": (6, 1),
    "temporal_centre": (13, 1), "log_temporal_scale": (14, 1),
}  # fmt: skip
# Only there where ``rot_4d`` is on: without it, the training stores an empty tensor.
_RIGHT_ROTATION_FIELD = {"right_rotation": (15, 4)}
_CAPTURE_LENGTH, _STATIC_CAPTURE_LENGTH = 19, 12
_DC_FIELD, _REST_FIELD, _ROT_4D_FIELD, _ENVIRONMENT_FIELD, _TIME_DEGREE = 2, 3, 16, 17, 18
_SH_DEGREE = 3
_SH_COEFFICIENTS = 16
# Stored coefficients → whether they change with time. 33 is 4-D SH that the training left off.
_HAS_CHANGING_COLOR = {16: False, 33: False, 48: True}

_NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# The top-level key of a YAML file, with its two numbers in one line or in one line each.
_DURATION_PATTERN = re.compile(
    rf"^time_duration:\s*(?:\[\s*({_NUMBER_PATTERN})\s*,\s*({_NUMBER_PATTERN})\s*\]|"
    rf"\n\s*-\s*({_NUMBER_PATTERN})\s*\n\s*-\s*({_NUMBER_PATTERN}))\s*(?:#.*)?$",
    re.MULTILINE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RotorSplats:
    """N Gaussians in space and time before activation, float32."""

    position: Float[Tensor, "n 3"]  # centres at the temporal centre
    log_scale: Float[Tensor, "n 3"]  # logarithms of the standard deviations in space
    rotation: Float[Tensor, "n 4"]  # left quaternion of the 4-D rotation, or that of space
    logit_opacity: Float[Tensor, "n 1"]  # opacity before the sigmoid
    temporal_centre: Float[Tensor, "n 1"]  # time of the highest opacity
    # logarithm of the standard deviation in time; of the variance where space alone is rotated
    log_temporal_scale: Float[Tensor, "n 1"]
    # right quaternion of the 4-D rotation; None where space alone is rotated (``rot_4d`` off)
    right_rotation: Float[Tensor, "n 4"] | None
    sh: Float[Tensor, "n k 3"]  # SH coefficients that do not change
    changing_sh: Float[Tensor, "n h k 3"]  # amplitudes of cos 2πt, cos 4πt, …

    def __len__(self) -> int:
        return self.position.shape[0]


@dataclass(frozen=True, slots=True)
class RotorCheckpoint:
    """The Gaussians of a rotor 4DGS checkpoint, and its options."""

    run: TrainingRun
    path: Path  # the file chkpntN.pth
    splats: RotorSplats
    has_environment: bool  # whether the training also learnt a background

    def describe(self) -> str:
        """Describe a rotor 4DGS checkpoint in one line: Gaussians, rotation and harmonics."""
        splats = self.splats
        harmonics = splats.changing_sh.shape[1]
        colors = f"with {harmonics} harmonics of time" if harmonics else "constant"
        is_4d = splats.right_rotation is not None
        rotation = "4-D rotations" if is_4d else "rotations of space alone"
        degree = int(splats.sh.shape[1] ** 0.5) - 1
        return (
            f"{self.path}: iteration {self.run.iteration}, {len(splats):,} Gaussians, {rotation}, "
            f"SH degree {degree}, {colors}"
        )


def read_time_duration(path: Path, frame_ratio: int = 1) -> tuple[float, float]:
    """Return the times of the first and last frame, ``time_duration`` of a training's YAML."""
    required_file(path, "the configuration of the training")
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error
    match = _DURATION_PATTERN.search(text)
    if match is None:
        message = "has no time_duration of two numbers"
        hint = "Give the YAML that the training was started with, or --time-duration 0 1."
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    first, last = (float(number) for number in match.groups() if number is not None)
    return first / frame_ratio, last / frame_ratio


def read_rotor(path: Path, iteration: int | None = None) -> RotorCheckpoint:
    """Read a checkpoint of rotor 4DGS: the folder of a run, or one of its ``chkpntN.pth``.

    Without ``iteration``, the last one is read; ``chkpnt_best.pth`` only if there is no other.
    """
    file = _find_file(path, iteration)
    hint = "Expected a file of tensors, as torch.save writes it; code in files is not run."
    values, number = _capture_values(file, load_tensors(file, hint))
    run = TrainingRun(file.parent, number, file.parent, read_cfg_args(file.parent))
    return RotorCheckpoint(run, file, _splats(file, values), values[_ENVIRONMENT_FIELD] is not None)


def _find_file(path: Path, iteration: int | None) -> Path:
    if path.is_file() and path.name != "cfg_args":
        return path
    folder = path.parent if path.is_file() else path
    matches = ((_FILE_PATTERN.fullmatch(file.name), file) for file in folder.glob("chkpnt*.pth"))
    files = {int(match[1]): file for match, file in matches if match}
    if iteration not in (None, -1):
        if iteration not in files:
            known = ", ".join(map(str, sorted(files))) or "none"
            message = f"has no chkpnt{iteration}.pth"
            raise NotInCheckpoint(message, where=str(folder), hint=f"There are: {known}.")
        return files[iteration]
    best_file = folder / _BEST_FILE
    if files or best_file.is_file():
        return files[max(files)] if files else best_file
    hint = "Give the folder of a training run, or its chkpntN.pth."
    hint = likely_folders(folder, lambda candidate: any(candidate.glob("chkpnt*.pth"))) or hint
    raise CheckpointInvalid("holds no chkpntN.pth", where=str(folder), hint=hint)


def _capture_values(path: Path, content: Any) -> tuple[tuple[Any, ...], int]:
    """Return the saved ``capture()`` tuple and iteration; raise unless rotor 4DGS wrote both."""
    is_capture_pair = (
        isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], tuple)
    )
    values = content[0] if is_capture_pair else ()
    if len(values) == _STATIC_CAPTURE_LENGTH:
        message = "holds Gaussians without time (gaussian_dim 3)"
        raise CheckpointInvalid(
            message, where=str(path), hint=f"Export them with `gsgen export static {path}`."
        )
    if len(values) != _CAPTURE_LENGTH or not isinstance(content[1], int):
        message = f"holds {_describe_content(content)}, expected ({_CAPTURE_LENGTH} values of capture, iteration)"
        hint = "Training of rotor 4DGS writes chkpntN.pth."
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    for index, kind in ((0, int), (_ROT_4D_FIELD, bool), (_TIME_DEGREE, int)):
        if not isinstance(values[index], kind):
            raise CheckpointInvalid(
                f"value {index} of capture() is {_describe_content(values[index])}, "
                f"expected {kind.__name__}",
                where=str(path),
            )
    return values, content[1]


def _describe_content(content: Any) -> str:
    size = f" of {len(content)}" if isinstance(content, tuple | list | dict) else ""
    return f"a {type(content).__name__}{size}"


def _splats(path: Path, values: tuple[Any, ...]) -> RotorSplats:
    fields = _CHECKPOINT_FIELDS | (_RIGHT_ROTATION_FIELD if values[_ROT_4D_FIELD] else {})
    position = values[fields["position"][0]]
    count = position.shape[0] if isinstance(position, Tensor) and position.ndim else None
    expected: dict[str, Shape] = {name: (count, columns) for name, (_, columns) in fields.items()}
    state = {name: values[index] for name, (index, _) in fields.items()}
    state |= {"f_dc": values[_DC_FIELD], "f_rest": values[_REST_FIELD]}
    expected |= {"f_dc": (count, 1, 3), "f_rest": (count, None, 3)}
    tensors = require_tensors(path, state, expected)
    right_rotation = tensors.pop("right_rotation", None)
    if not count:
        raise CheckpointInvalid("holds no Gaussians", where=str(path))
    sh = torch.cat([tensors.pop("f_dc"), tensors.pop("f_rest")], dim=1)
    stored_coefficients = sh.shape[1]
    degree, time_degree = values[0], values[_TIME_DEGREE]
    if stored_coefficients not in _HAS_CHANGING_COLOR or not 0 <= degree <= _SH_DEGREE:
        raise CheckpointInvalid(
            f"has {stored_coefficients} SH coefficients and the active degree {degree}; expected "
            f"{', '.join(map(str, _HAS_CHANGING_COLOR))} coefficients and degree 0 to {_SH_DEGREE}",
            where=str(path),
        )
    # The published code adds harmonics of time only once all degrees are active.
    harmonics = (
        time_degree if _HAS_CHANGING_COLOR[stored_coefficients] and degree == _SH_DEGREE else 0
    )
    if not 0 <= harmonics < stored_coefficients // _SH_COEFFICIENTS:
        message = f"time degree {harmonics} does not fit {stored_coefficients} SH coefficients"
        raise CheckpointInvalid(message, where=str(path))
    blocks = sh[:, : stored_coefficients // _SH_COEFFICIENTS * _SH_COEFFICIENTS]
    blocks = blocks.reshape(count, -1, _SH_COEFFICIENTS, 3)
    return RotorSplats(
        **tensors,
        right_rotation=right_rotation,
        sh=blocks[:, 0, : (degree + 1) ** 2],
        changing_sh=blocks[:, 1 : 1 + harmonics],
    )
