"""Reads motion files, which hold the poses of a body in each frame, in several layouts.

- an ``.npz`` of AMASS (``poses``, ``trans``, ``mocap_framerate``),
- a folder of ``.npz``, one per frame, as R3-Avatar caches its data sets (``poses``, ``R``, ``Th``,
  ``shapes``), or one ``.npz`` of the same arrays for all frames,
- a folder of ``.npy`` of ZJU-MoCap, one per frame: a pickled dict of ``poses``, ``Rh``,
  ``Th`` and ``shapes``,
- a ``.json`` or a folder of them, as LHM estimates them from videos (``root_pose``, ``body_pose``, …),
- GART's ``training_poses.pth`` (``pose_base_list``, ``pose_rest_list``, ``global_trans_list``).

Only arrays are read from pickles. Poses are converted to the requested body: joints of hands and
face that the file lacks do not rotate, and those that the body lacks are dropped.
"""

__all__ = ["Motion", "read_motion"]

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from gsgen.reference_plugins.bodies.rest_pose import rodrigues
from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

# Numbers of a pose for root and body, which all body models share; and for both hands.
_BODY_POSE_SIZE = 66
_HAND_POSE_SIZE = 90
# Numbers of a pose: root and body alone, SMPL, SMPL+H, SMPL-X.
_POSE_SIZES = (66, 72, 156, 165)
_JSON_FIELD_SIZES = {
    "root_pose": 3, "body_pose": 63, "jaw_pose": 3, "leye_pose": 3, "reye_pose": 3,
    "lhand_pose": 45, "rhand_pose": 45,
}  # fmt: skip
UpAxis: TypeAlias = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
_UP_AXES: tuple[tuple[UpAxis, UpAxis], ...] = (("+x", "-x"), ("+y", "-y"), ("+z", "-z"))
_KNOWN_ARRAYS = (
    *("poses", "trans", "mocap_framerate", "mocap_frame_rate"),
    *("R", "Rh", "Th", "shapes"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """A motion of a body over T frames."""

    path: Path  # the file or folder
    pose: Float[np.ndarray, "t j 3"]  # Axis-angles of J joints
    shift: Float[np.ndarray, "t 3"]  # root translation
    # root rotation; None if the pose's first joint holds it
    turn: Float[np.ndarray, "t 3 3"] | None = None
    # Shape coefficients of the person that the avatar was trained on, if the file has them. The
    # betas of AMASS and LHM belong to another person and are not read.
    shape: Float[np.ndarray, " s"] | None = None
    # expression coefficients, if the file has them
    expression: Float[np.ndarray, "t e"] | None = None
    fps: float | None = None  # frames per second, if the file has it

    @property
    def up(self) -> UpAxis:
        """The upward world axis of a body motion: where the body's y axis points on average."""
        rotations = rodrigues(self.pose[:, 0])
        up_axes = (rotations if self.turn is None else self.turn @ rotations)[:, :, 1].mean(axis=0)
        axis = int(np.abs(up_axes).argmax())
        return _UP_AXES[axis][int(up_axes[axis] < 0)]

    def __len__(self) -> int:
        return len(self.pose)

    def describe(self) -> str:
        """Describe the motion in one line: file, frames and speed."""
        rate_text = f" at {self.fps:g} frames per second" if self.fps else ""
        return f"{self.path}: {len(self)} frames{rate_text}"


def read_motion(path: Path, joints: int) -> Motion:
    """Read a motion file for a body with a given number of joints."""
    if path.is_dir():
        return _read_folder(path, joints)
    if not path.is_file():
        raise CheckpointInvalid("is missing", where=str(path), hint=_supported_motions())
    if path.suffix == ".json":
        read = _read_json(path)
        return _motion_from_json(path, read if isinstance(read, list) else [read], joints)
    is_state = path.suffix.startswith(".pt")  # .pt, .pth
    arrays = _read_training_poses(path) if is_state else _read_arrays(path)
    return _motion_from_arrays(path, arrays, joints)


def _supported_motions() -> str:
    return (
        "Expected an .npz of AMASS, a folder of .npz or .npy with R or Rh, Th and poses, "
        "LHM's .json, or GART's training_poses.pth."
    )


def _read_folder(path: Path, joints: int) -> Motion:
    for suffix in ("npz", "npy", "json"):
        files = sorted(path.glob(f"*.{suffix}"), key=_frame_number)
        if files and suffix == "json":
            return _motion_from_json(path, [_read_json(file) for file in files], joints)
        if files:
            frames = [_read_arrays(file) for file in files]
            names = set(frames[0])
            for file, frame in zip(files, frames, strict=True):
                if set(frame) != names:
                    message = f"has the arrays {sorted(frame)}, expected {sorted(names)} as in {files[0].name}"
                    raise CheckpointInvalid(message, where=str(file))
            try:
                joined_arrays = {
                    name: np.stack([frame[name].reshape(-1) for frame in frames]) for name in names
                }
            except ValueError as error:
                message = f"has frames of different sizes: {error}"
                raise CheckpointInvalid(message, where=str(path)) from error
            return _motion_from_arrays(path, joined_arrays, joints)
    message = "holds no .npz, .npy or .json"
    raise CheckpointInvalid(message, where=str(path), hint=_supported_motions())


def _frame_number(path: Path) -> tuple[int, str]:
    match = re.search(r"(\d+)$", path.stem)
    return (int(match[1]) if match else -1, path.stem)


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".npy":
        read = read_array_pickle(path, _KNOWN_ARRAYS)
    else:
        read = read_npz(path, _KNOWN_ARRAYS, _supported_motions())
    for name, array in read.items():
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            message = f"{name} holds {array.dtype}, expected finite numbers"
            raise CheckpointInvalid(message, where=str(path))
    return {name: array.astype(np.float64) for name, array in read.items()}


def _read_training_poses(path: Path) -> dict[str, np.ndarray]:
    """Return the poses of GART's training frames, the root joint first, and their translations."""
    from gsgen.reference_plugins.loading.states import load_state, require_tensors

    shapes = {"pose_base_list": (None, 1, 3), "pose_rest_list": (None, 23, 3)}
    expected = {**shapes, "global_trans_list": (None, 3)}
    ignored = ("pose_list_original", "global_trans_list_original")
    read = require_tensors(path, load_state(path, "the poses of training"), expected, ignored)
    base, rest, translation = (read[name].double().numpy() for name in expected)
    if len({len(base), len(rest), len(translation)}) > 1:
        message = f"has {len(base)} root poses, {len(rest)} poses and {len(translation)} places"
        raise CheckpointInvalid(message, where=str(path))
    return {"poses": np.concatenate([base, rest], axis=1).reshape(len(base), -1), "Th": translation}


def _motion_from_arrays(path: Path, read: Mapping[str, np.ndarray], joints: int) -> Motion:
    if "poses" not in read or not read["poses"].size:
        names = ", ".join(read) or "no known array"
        message = f"has no array poses (has: {names})"
        raise CheckpointInvalid(message, where=str(path), hint=_supported_motions())
    poses = read["poses"]
    frames = len(poses) if poses.ndim > 1 else 1
    pose = _convert_poses(path, poses.reshape(frames, -1), joints)
    translation = read.get("Th", read.get("trans"))
    shift = (
        np.zeros((frames, 3)) if translation is None else _rows(path, "Th", translation, frames, 3)
    )
    turn = None
    if "R" in read:
        turn = _rows(path, "R", read["R"], frames, 9).reshape(-1, 3, 3)
    elif "Rh" in read:
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_rotvec(_rows(path, "Rh", read["Rh"], frames, 3)).as_matrix()
    shape = read.get("shapes")
    if shape is not None:  # the same person in every frame
        shape = shape[0].ravel() if shape.ndim > 1 and len(shape) else shape.ravel()
    frame_rate = read.get("mocap_framerate", read.get("mocap_frame_rate"))
    fps = float(frame_rate.ravel()[0]) if frame_rate is not None and frame_rate.size else None
    return Motion(path=path, pose=pose, shift=shift, turn=turn, shape=shape, fps=fps)


def _rows(
    path: Path, name: str, array: np.ndarray, frames: int, width: int
) -> Float[np.ndarray, "t w"]:
    if array.size != frames * width:
        message = (
            f"{name} is {list(array.shape)}, expected {width} numbers for each of {frames} frames"
        )
        raise CheckpointInvalid(message, where=str(path))
    return array.reshape(frames, width)


def _convert_poses(
    path: Path, poses: Float[np.ndarray, "t p"], joints: int
) -> Float[np.ndarray, "t j 3"]:
    """Convert poses of one body model to another with a different number of joints."""
    frames, width = poses.shape
    if width not in _POSE_SIZES:
        message = f"a pose has {width} numbers, expected {', '.join(map(str, _POSE_SIZES))}"
        raise CheckpointInvalid(message, where=str(path))
    converted_poses = np.zeros((frames, 3 * joints))
    converted_poses[:, :_BODY_POSE_SIZE] = poses[:, :_BODY_POSE_SIZE]
    if 3 * joints == width:
        converted_poses = poses.copy()
    elif joints == 55 and width == 156:
        converted_poses[:, -_HAND_POSE_SIZE:] = poses[:, -_HAND_POSE_SIZE:]
    return converted_poses.reshape(frames, joints, 3)


def _read_json(path: Path) -> Any:
    try:
        if not path.is_file():
            raise ValueError("the file is a pipe or a device")
        return json.loads(path.read_text("utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error


def _motion_from_json(path: Path, frames: Sequence[Any], joints: int) -> Motion:
    poses, translations, expressions = [], [], []
    for number, frame in enumerate(frames):
        where = f"{path}, frame {number}"
        if not isinstance(frame, dict):
            message = f"is a {type(frame).__name__}, expected an object of {', '.join(_JSON_FIELD_SIZES)}, trans"
            raise CheckpointInvalid(message, where=where)
        parts = [
            _json_numbers(where, frame, name, size) for name, size in _JSON_FIELD_SIZES.items()
        ]
        poses.append(np.concatenate(parts))
        translations.append(_json_numbers(where, frame, "trans", 3))
        expressions.append(np.asarray(frame.get("expr", ()), np.float64).ravel())
    if not poses:
        raise CheckpointInvalid("has no frames of poses, expected at least one", where=str(path))
    pose = _convert_poses(path, np.stack(poses), joints)
    expression = None
    if len({len(values) for values in expressions}) == 1 and len(expressions[0]):
        expression = np.stack(expressions)
    return Motion(path=path, pose=pose, shift=np.stack(translations), expression=expression)


def _json_numbers(where: str, frame: Mapping[str, Any], name: str, size: int) -> np.ndarray:
    try:
        numbers = np.asarray(frame[name], np.float64).ravel()
    except (KeyError, ValueError, TypeError) as error:
        message = f"{name} is missing or not a list of numbers"
        raise CheckpointInvalid(message, where=where) from error
    if len(numbers) != size or not np.isfinite(numbers).all():
        message = f"{name} has {len(numbers)} numbers, expected {size}, all finite"
        raise CheckpointInvalid(message, where=where)
    return numbers
