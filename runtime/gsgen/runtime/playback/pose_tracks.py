"""Motions: poses of a body frame after frame, as files have them.

- an .npy or a .json of nested lists: ``[J, 3]``, or ``[F, J, 3]`` (quaternions: 4),
- an .npz of one such array, or as AMASS has them (``poses``, ``trans``), or with ``R`` or ``Rh``
  and ``Th`` in place of ``trans``,
- a .json as LHM estimates it from videos (``root_pose``, ``body_pose``, …), one frame or a list,
- a folder of files of one kind, a frame each, in the order of the numbers in their names.

Nothing is unpickled.
"""

__all__ = ["named_file", "pose_tracks"]

import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.playback.input_tracks import Track, numbers_of
from gsgen.runtime.sources.source import Source

_KINDS: Final = (
    "Give an .npy, .npz or .json of [joints, 3] or [frames, joints, 3], an .npz of AMASS, "
    "LHM's .json, or a folder of such files."
)
_SUFFIXES: Final = (".npy", ".npz", ".json")
_SPEED: Final = ("mocap_framerate", "mocap_frame_rate")
# How LHM calls the parts of a pose of SMPL-X, in its order, and how many numbers each has.
_PARTS: Final = {
    "root_pose": 3,
    "body_pose": 63,
    "jaw_pose": 3,
    "leye_pose": 3,
    "reye_pose": 3,
    "lhand_pose": 45,
    "rhand_pose": 45,
}
_SHARED: Final = 22  # joints that SMPL, SMPL+H and SMPL-X have in common: root and body
_HANDS: Final = 30  # the last joints of SMPL+H and SMPL-X
_BODIES: Final = (_SHARED, 24, 52, 55)


@dataclass(frozen=True, slots=True)
class _Read:
    """What a file holds: arrays by what they are, each with an axis for the frames."""

    pose: Float[np.ndarray, "t ..."]
    extra_inputs: Mapping[str, Float[np.ndarray, "t ..."]]
    fps: float | None = None


def pose_tracks(text: str, source: Source) -> tuple[list[Track], float | None]:
    """Read what a user typed for ``--pose``: FILE or NAME=FILE.

    Args:
        text: As it was typed.
        source: Whose inputs take the pose and what else the file tells of a body.

    Returns:
        A track for each of those inputs; and frames a second, if the file says so.

    Raises:
        ConfigInvalid: It cannot be read, or is of another body.
    """
    word, path = named_file(text)
    read, where = _read(path), f"--pose {path}"
    taker = source.named(word)[0]
    pose = _fitted(read.pose, source.shape(taker.name), taker.convention, where)
    tracks = [Track(word, pose, where)]
    for role, values in read.extra_inputs.items():
        for spec in source.named(role):
            shape = source.shape(spec.name)
            turned = _turned(values, shape) if role == "root_rotation" else values
            tracks.append(Track(spec.name, turned, f"{where}, {role}"))
    return tracks, read.fps


def _turned(
    rotations: Float[np.ndarray, "t x"], shape: tuple[int, ...]
) -> Float[np.ndarray, "t y"]:
    """Return axis-angles as matrices or the other way round, where an input wants the other."""
    if rotations.shape[1] == np.prod(shape):
        return rotations
    from scipy.spatial.transform import Rotation

    if rotations.shape[1] == 9:
        return np.asarray(Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec())
    return np.asarray(Rotation.from_rotvec(rotations).as_matrix()).reshape(-1, 9)


def named_file(text: str) -> tuple[str, Path]:
    """Split ``NAME=FILE``; the name is the role where there is none."""
    word, sign, name = text.partition("=")
    if sign and word and not Path(text).exists():
        return word, Path(name)
    return "pose", Path(text)


def _fitted(
    pose: Float[np.ndarray, "t ..."],
    shape: tuple[int, ...],
    convention: str | None,
    where: str,
) -> Float[np.ndarray, "t ..."]:
    """Return poses of one body as those of another; what the file does not have stays still."""
    frames, frame_size = len(pose), int(np.prod(pose.shape[1:]))
    expected_size = int(np.prod(shape))
    flat = pose.reshape(frames, frame_size)
    if frame_size == expected_size:
        return flat.reshape(frames, *shape)
    joints, file_joints = shape[0], frame_size // 3
    known = (
        shape[1:] == (3,)
        and file_joints in _BODIES
        and joints in _BODIES
        and frame_size % 3 == 0
    )
    if not (known and convention == "smpl-axis-angle"):
        raise ConfigInvalid(
            f"holds poses of {list(pose.shape[1:])}, and the model takes {list(shape)}",
            where=where,
            hint=_KINDS,
        )
    padded = np.zeros((frames, joints, 3))
    file_pose = flat.reshape(frames, file_joints, 3)
    padded[:, :_SHARED] = file_pose[:, :_SHARED]
    if min(joints, file_joints) >= _SHARED + _HANDS:
        padded[:, -_HANDS:] = file_pose[:, -_HANDS:]
    return padded


def _read(path: Path) -> _Read:
    if not path.is_dir():
        return _read_file(path)
    for suffix in _SUFFIXES:
        files = sorted(path.glob(f"*{suffix}"), key=_number)
        if files:
            return _joined(path, [_read_file(file) for file in files])
    raise ConfigInvalid("holds neither .npy, .npz nor .json", where=str(path), hint=_KINDS)


def _number(path: Path) -> tuple[int, str]:
    match = re.search(r"(\d+)$", path.stem)
    return (int(match[1]) if match else -1, path.stem)


def _joined(path: Path, frames: list[_Read]) -> _Read:
    try:
        extra_inputs = {
            name: np.concatenate([frame.extra_inputs[name] for frame in frames])
            for name in frames[0].extra_inputs
        }
        return _Read(
            np.concatenate([frame.pose for frame in frames]), extra_inputs, frames[0].fps
        )
    except (KeyError, ValueError) as error:
        message = f"its files are not of one kind: {error}"
        raise ConfigInvalid(message, where=str(path)) from error


def _read_file(path: Path) -> _Read:
    try:
        if path.suffix.lower() == ".json":
            return _of_json(json.loads(path.read_text("utf-8")), str(path))
        with path.open("rb") as file:
            contents = np.load(file, allow_pickle=False)
            if isinstance(contents, np.ndarray):
                return _Read(_framed(contents, str(path)), {})
            return _of_arrays({name: contents[name] for name in contents.files}, str(path))
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(path), hint=_KINDS) from error
    except (ValueError, EOFError, RecursionError, zipfile.BadZipFile) as error:
        raise ConfigInvalid(
            f"cannot be read: {error}", where=str(path), hint=_KINDS
        ) from error


def _framed(array: np.ndarray, where: str) -> Float[np.ndarray, "t ..."]:
    """Return poses with an axis for the frames, which [joints, 3] has not."""
    checked = numbers_of(array, where).astype(np.float64)
    if checked.ndim not in (1, 2, 3):
        message = (
            f"has shape {list(array.shape)}, wanted [joints, 3] or [frames, joints, 3]"
        )
        raise ConfigInvalid(message, where=where, hint=_KINDS)
    alone = checked.ndim == 1 or (checked.ndim == 2 and checked.shape[1] in (3, 4))
    return checked[None] if alone else checked


def _of_json(read: Any, where: str) -> _Read:
    if isinstance(read, list) and read and all(isinstance(entry, dict) for entry in read):
        return _joined(
            Path(where),
            [_of_json(entry, f"{where}, frame {k}") for k, entry in enumerate(read)],
        )
    if isinstance(read, dict) and "body_pose" in read:
        return _of_lhm(read, where)
    if isinstance(read, dict):
        return _of_arrays(
            {name: np.asarray(values) for name, values in read.items()}, where
        )
    return _Read(_framed(np.asarray(read), where), {})


def _of_lhm(read: Mapping[str, Any], where: str) -> _Read:
    parts = []
    for name, size in _PARTS.items():
        part = np.asarray(read.get(name, ()), np.float64).ravel()
        if len(part) != size:
            message = f"{name} has {len(part)} numbers, wanted {size}"
            raise ConfigInvalid(message, where=where)
        parts.append(part)
    extra_inputs = {
        role: numbers_of(np.asarray(read[name]), f"{where}, {name}").reshape(1, -1)
        for name, role in {"trans": "root_translation", "expr": "expression"}.items()
        if name in read
    }
    return _Read(numbers_of(np.concatenate(parts), where)[None], extra_inputs)


def _of_arrays(read: Mapping[str, np.ndarray], where: str) -> _Read:
    names = [name for name in ("poses", "pose") if name in read]
    if not names and len(read) == 1:
        names = list(read)
    if not names:
        message = f"has no poses, but {', '.join(read) or 'nothing'}"
        raise ConfigInvalid(message, where=where, hint=_KINDS)
    pose = _framed(read[names[0]], where)
    extra_inputs = {}
    for name, role, size in (
        ("trans", "root_translation", 3),
        ("Th", "root_translation", 3),
        ("Rh", "root_rotation", 3),
        ("R", "root_rotation", 9),
    ):
        if name in read:
            rows = numbers_of(np.asarray(read[name]), f"{where}, {name}").astype(np.float64)
            if rows.size != len(pose) * size:
                message = (
                    f"is {list(rows.shape)}, wanted {size} numbers for {len(pose)} frames"
                )
                raise ConfigInvalid(message, where=f"{where}, {name}")
            extra_inputs[role] = rows.reshape(len(pose), size)
    speed = next((float(np.ravel(read[n])[0]) for n in _SPEED if n in read), None)
    return _Read(pose, extra_inputs, speed)
