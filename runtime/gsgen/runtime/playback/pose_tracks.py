"""Reads the poses of a body, frame by frame, from motion files.

- an .npy or a .json of nested lists: ``[J, 3]``, or ``[F, J, 3]`` (quaternions: 4),
- an .npz of one such array, or of AMASS (``poses``, ``trans``), or with ``R`` or ``Rh`` and
  ``Th`` in place of ``trans``,
- a .json of LHM's motion estimator (``root_pose``, ``body_pose``, …), one frame or a list,
- a folder of files of one kind, a frame each, in the order of the numbers in their names.

Nothing is unpickled.
"""

__all__ = ["named_file", "pose_tracks"]

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.array_files import ArraysUnreadable, read_array_file
from gsgen.runtime.playback.input_tracks import ARRAY_SUFFIXES, Track, numbers_of
from gsgen.runtime.sources.source import Source

_MOTION_FORMATS: Final = (
    "Give an .npy, .npz or .json of [joints, 3] or [frames, joints, 3], an .npz of AMASS, "
    "LHM's .json, or a folder of such files."
)
_RATE_FIELDS: Final = ("mocap_framerate", "mocap_frame_rate")
_POSE_NAMES: Final = ("poses", "pose")
# An array of a motion file → the role of the input that it feeds, and its numbers a frame.
_EXTRA_ARRAYS: Final = {
    "trans": ("root_translation", 3),
    "Th": ("root_translation", 3),
    "Rh": ("root_rotation", 3),
    "R": ("root_rotation", 9),
}
_ARRAY_NAMES: Final = (*_POSE_NAMES, *_EXTRA_ARRAYS, *_RATE_FIELDS)
# LHM's names for the parts of an SMPL-X pose, in order, with their numbers of values.
_BODY_PARTS: Final = {
    "root_pose": 3,
    "body_pose": 63,
    "jaw_pose": 3,
    "leye_pose": 3,
    "reye_pose": 3,
    "lhand_pose": 45,
    "rhand_pose": 45,
}
_SHARED_JOINT_COUNT: Final = 22  # joints that SMPL, SMPL+H and SMPL-X have in common: root and body
_HAND_JOINTS: Final = 30  # joints of the hands, the last of SMPL+H and SMPL-X
_BODY_JOINT_COUNTS: Final = (_SHARED_JOINT_COUNT, 24, 52, 55)


@dataclass(frozen=True, slots=True)
class _PoseMotion:
    """The arrays of a motion file, each with frames along the first axis."""

    pose: Float[np.ndarray, "t ..."]
    extra_inputs: Mapping[str, Float[np.ndarray, "t ..."]]
    fps: float | None = None


def pose_tracks(text: str, source: Source) -> tuple[list[Track], float | None]:
    """Parse the value of ``--pose``, FILE or NAME=FILE, and read its file.

    Returns:
        A track for each of those inputs, and the frames per second if the file has them.
    """
    input_name, path = named_file(text)
    motion, where = _read_motion(path), f"--pose {path}"
    pose_input = source.named(input_name)[0]
    shape = source.shape(pose_input.name)
    pose = _fit_pose(motion.pose, shape, pose_input.convention, where)
    tracks = [Track(input_name, pose, where)]
    for role, values in motion.extra_inputs.items():
        for spec in source.named(role):
            shape = source.shape(spec.name)
            fitted_values = _fit_rotation(values, shape) if role == "root_rotation" else values
            tracks.append(Track(spec.name, fitted_values, f"{where}, {role}"))
    return tracks, motion.fps


def _fit_rotation(
    rotations: Float[np.ndarray, "t x"], shape: tuple[int, ...]
) -> Float[np.ndarray, "t y"]:
    """Convert rotations between axis-angles and matrices, as the input's shape needs."""
    if rotations.shape[1] == np.prod(shape):
        return rotations
    from scipy.spatial.transform import Rotation

    if rotations.shape[1] == 9:
        return np.asarray(Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec())
    return np.asarray(Rotation.from_rotvec(rotations).as_matrix()).reshape(-1, 9)


def named_file(text: str) -> tuple[str, Path]:
    """Split ``NAME=FILE`` of ``--pose``; the default name is the role ``pose``."""
    input_name, equals_sign, name = text.partition("=")
    if equals_sign and input_name and not Path(text).exists():
        return input_name, Path(name)
    return "pose", Path(text)


def _fit_pose(
    pose: Float[np.ndarray, "t ..."], shape: tuple[int, ...], convention: str | None, where: str
) -> Float[np.ndarray, "t ..."]:
    """Convert poses between SMPL bodies; joints that the file lacks stay at zero."""
    frames, frame_size = len(pose), int(np.prod(pose.shape[1:]))
    expected_size = int(np.prod(shape))
    flat = pose.reshape(frames, frame_size)
    if frame_size == expected_size:
        return flat.reshape(frames, *shape)
    joints, file_joints = shape[0], frame_size // 3
    known_formats = (
        shape[1:] == (3,)
        and file_joints in _BODY_JOINT_COUNTS
        and joints in _BODY_JOINT_COUNTS
        and frame_size % 3 == 0
    )
    if not (known_formats and convention == "smpl-axis-angle"):
        raise ConfigInvalid(
            f"the file holds poses of {list(pose.shape[1:])}, expected {list(shape)}",
            where=where,
            hint=_MOTION_FORMATS,
        )
    padded = np.zeros((frames, joints, 3))
    file_pose = flat.reshape(frames, file_joints, 3)
    padded[:, :_SHARED_JOINT_COUNT] = file_pose[:, :_SHARED_JOINT_COUNT]
    if min(joints, file_joints) >= _SHARED_JOINT_COUNT + _HAND_JOINTS:
        padded[:, -_HAND_JOINTS:] = file_pose[:, -_HAND_JOINTS:]
    return padded


def _read_motion(path: Path) -> _PoseMotion:
    if not path.is_dir():
        return _read_file(path)
    for suffix in ARRAY_SUFFIXES:
        files = sorted(path.glob(f"*{suffix}"), key=_frame_number_key)
        if files:
            return _join_frames(path, [_read_file(file) for file in files])
    raise ConfigInvalid(
        "is a folder without .npy, .npz or .json files", where=str(path), hint=_MOTION_FORMATS
    )


def _frame_number_key(path: Path) -> tuple[int, str]:
    match = re.search(r"(\d+)$", path.stem)
    return (int(match[1]) if match else -1, path.stem)


def _join_frames(path: Path, frames: list[_PoseMotion]) -> _PoseMotion:
    try:
        extra_inputs = {
            name: np.concatenate([frame.extra_inputs[name] for frame in frames])
            for name in frames[0].extra_inputs
        }
        return _PoseMotion(
            np.concatenate([frame.pose for frame in frames]), extra_inputs, frames[0].fps
        )
    except (KeyError, ValueError) as error:
        message = f"has files that differ in kind: {error}"
        raise ConfigInvalid(message, where=str(path)) from error


def _read_file(path: Path) -> _PoseMotion:
    try:
        if path.exists() and not path.is_file():
            raise ValueError("the file is a pipe or a device")
        if path.suffix.lower() == ".json":
            return _motion_from_json(json.loads(path.read_text("utf-8")), str(path))
        arrays = read_array_file(path, _ARRAY_NAMES)
        if "" in arrays:
            return _PoseMotion(_with_frame_axis(arrays[""], str(path)), {})
        has_pose = any(name in arrays for name in _POSE_NAMES)
        return _motion_from_arrays(arrays if has_pose else read_array_file(path), str(path))
    except ArraysUnreadable as error:
        raise ConfigInvalid(error.message, where=str(path), hint=_MOTION_FORMATS) from error
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(path), hint=_MOTION_FORMATS) from error
    except (ValueError, TypeError, RecursionError) as error:
        raise ConfigInvalid(
            f"cannot be read: {error}", where=str(path), hint=_MOTION_FORMATS
        ) from error


def _with_frame_axis(array: np.ndarray, where: str) -> Float[np.ndarray, "t ..."]:
    """Add the frame axis to a single pose, such as [joints, 3]."""
    numbers = numbers_of(array, where).astype(np.float64)
    if numbers.ndim not in (1, 2, 3):
        message = f"has shape {list(array.shape)}, expected [joints, 3] or [frames, joints, 3]"
        raise ConfigInvalid(message, where=where, hint=_MOTION_FORMATS)
    is_single_pose = numbers.ndim == 1 or (numbers.ndim == 2 and numbers.shape[1] in (3, 4))
    return numbers[None] if is_single_pose else numbers


def _motion_from_json(document: object, where: str) -> _PoseMotion:
    if (
        isinstance(document, list)
        and document
        and all(isinstance(entry, dict) for entry in document)
    ):
        return _join_frames(
            Path(where),
            [_motion_from_json(entry, f"{where}, frame {k}") for k, entry in enumerate(document)],
        )
    if isinstance(document, dict) and "body_pose" in document:
        return _motion_from_lhm(document, where)
    if isinstance(document, dict):
        return _motion_from_arrays(
            {name: np.asarray(values) for name, values in document.items()}, where
        )
    return _PoseMotion(_with_frame_axis(np.asarray(document), where), {})


def _motion_from_lhm(document: Mapping[str, list[float]], where: str) -> _PoseMotion:
    parts = []
    for name, size in _BODY_PARTS.items():
        part = np.asarray(document.get(name, ()), np.float64).ravel()
        if len(part) != size:
            message = f"has {len(part)} numbers, expected {size}"
            raise ConfigInvalid(message, where=f"{where}, {name}")
        parts.append(part)
    extra_inputs = {
        role: numbers_of(np.asarray(document[name]), f"{where}, {name}").reshape(1, -1)
        for name, role in {"trans": "root_translation", "expr": "expression"}.items()
        if name in document
    }
    return _PoseMotion(numbers_of(np.concatenate(parts), where)[None], extra_inputs)


def _motion_from_arrays(arrays: Mapping[str, np.ndarray], where: str) -> _PoseMotion:
    names = [name for name in _POSE_NAMES if name in arrays]
    if not names and len(arrays) == 1:
        names = list(arrays)
    if not names:
        message = f"has the arrays {', '.join(arrays) or '(none)'}, expected `poses` or `pose`"
        raise ConfigInvalid(message, where=where, hint=_MOTION_FORMATS)
    pose = _with_frame_axis(arrays[names[0]], where)
    extra_inputs = {}
    for name, (role, size) in _EXTRA_ARRAYS.items():
        if name in arrays:
            rows = numbers_of(np.asarray(arrays[name]), f"{where}, {name}").astype(np.float64)
            if rows.size != len(pose) * size:
                message = f"has shape {list(rows.shape)}, expected [{len(pose)}, {size}]: {size} numbers a frame"
                raise ConfigInvalid(message, where=f"{where}, {name}")
            extra_inputs[role] = rows.reshape(len(pose), size)
    rates = [(name, arrays[name]) for name in _RATE_FIELDS if name in arrays]
    return _PoseMotion(pose, extra_inputs, _frame_rate(*rates[0], where) if rates else None)


def _frame_rate(name: str, array: np.ndarray, where: str) -> float:
    rate = numbers_of(np.asarray(array), f"{where}, {name}")
    if rate.size != 1 or not rate.item() > 0:
        message = f"is {rate.ravel()[:3].tolist()}, expected frames per second above 0"
        raise ConfigInvalid(message, where=f"{where}, {name}")
    return float(rate.item())
