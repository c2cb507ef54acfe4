"""Motion files: poses of a body, frame after frame.

- an ``.npz`` as AMASS has them (``poses``, ``trans``, ``mocap_framerate``),
- a folder of ``.npz``, one a frame, as R3-Avatar caches its data sets (``poses``, ``R``, ``Th``,
  ``shapes``), or one ``.npz`` of the same arrays for all frames,
- a folder of ``.npy``, one a frame, as ZJU-MoCap has them: a pickled dict of ``poses``, ``Rh``,
  ``Th`` and ``shapes``,
- a ``.json`` or a folder of them, as LHM estimates from videos (``root_pose``, ``body_pose``, …).

Of pickles only arrays are read. Poses become those of the body asked for: hands and faces that a
file does not have stay still, and those that the body does not have are left out.
"""

__all__ = ["Motion", "read_motion"]

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

# Of root and body, which all bodies share.
_BODY = 66
_HANDS = 90
# Numbers of a pose → what it is: SMPL, root and body alone, SMPL+H, SMPL-X.
_WIDTHS = (66, 72, 156, 165)
_JSON = {
    "root_pose": 3,
    "body_pose": 63,
    "jaw_pose": 3,
    "leye_pose": 3,
    "reye_pose": 3,
    "lhand_pose": 45,
    "rhand_pose": 45,
}
_KNOWN = (
    *("poses", "trans", "mocap_framerate", "mocap_frame_rate"),
    *("R", "Rh", "Th", "shapes"),
)


@dataclass(frozen=True, slots=True)
class Motion:
    """T frames.

    Attributes:
        path: Where they were read.
        pose: Axis-angles of J joints.
        shift: Where the body is moved.
        turn: Rotation of the body as a whole; none if the pose's root is all.
        shape: Shape coefficients of the person whose data set it is, where they are given. The
            betas of AMASS and LHM are of somebody else.
        expression: Expression coefficients, where they are given.
        fps: Frames a second, where it is given.
    """

    path: Path
    pose: Float[np.ndarray, "t j 3"]
    shift: Float[np.ndarray, "t 3"]
    turn: Float[np.ndarray, "t 3 3"] | None = None
    shape: Float[np.ndarray, " s"] | None = None
    expression: Float[np.ndarray, "t e"] | None = None
    fps: float | None = None

    def __len__(self) -> int:
        return len(self.pose)

    def describe(self) -> str:
        """Say in one line what it holds."""
        speed = f" at {self.fps:g} frames a second" if self.fps else ""
        return f"{self.path}: {len(self)} frames{speed}"


def read_motion(path: Path, joints: int) -> Motion:
    """Read the motion at ``path`` for a body of ``joints`` joints.

    Raises:
        CheckpointInvalid: It is missing, damaged, or of no known kind.
    """
    if path.is_dir():
        return _read_folder(path, joints)
    if not path.is_file():
        raise CheckpointInvalid("is missing", where=str(path), hint=_kinds())
    if path.suffix == ".json":
        read = _json(path)
        return _from_json(path, read if isinstance(read, list) else [read], joints)
    return _from_arrays(path, _arrays(path), joints)


def _kinds() -> str:
    return (
        "Wanted an .npz of AMASS, a folder of .npz or .npy with R or Rh, Th and poses, or LHM's "
        ".json."
    )


def _read_folder(path: Path, joints: int) -> Motion:
    for suffix in ("npz", "npy", "json"):
        files = sorted(path.glob(f"*.{suffix}"), key=_number)
        if files and suffix == "json":
            return _from_json(path, [_json(file) for file in files], joints)
        if files:
            frames = [_arrays(file) for file in files]
            names = set(frames[0])
            for file, frame in zip(files, frames, strict=True):
                if set(frame) != names:
                    what = f"has {sorted(frame)}, and {files[0].name} {sorted(names)}"
                    raise CheckpointInvalid(what, where=str(file))
            try:
                joined = {
                    name: np.stack([frame[name].reshape(-1) for frame in frames])
                    for name in names
                }
            except ValueError as error:
                what = f"frames are of different sizes: {error}"
                raise CheckpointInvalid(what, where=str(path)) from error
            return _from_arrays(path, joined, joints)
    raise CheckpointInvalid("holds no .npz, .npy or .json", where=str(path), hint=_kinds())


def _number(path: Path) -> tuple[int, str]:
    found = re.search(r"(\d+)$", path.stem)
    return (int(found[1]) if found else -1, path.stem)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".npy":
        whole = read_array_pickle(path)
        read = {name: np.asarray(whole[name]) for name in _KNOWN if name in whole}
    else:
        read = read_npz(path, _KNOWN, _kinds())
    for name, array in read.items():
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            what = f"{name} holds {array.dtype}, wanted finite numbers"
            raise CheckpointInvalid(what, where=str(path))
    return {name: array.astype(np.float64) for name, array in read.items()}


def _from_arrays(path: Path, read: Mapping[str, np.ndarray], joints: int) -> Motion:
    if "poses" not in read or not read["poses"].size:
        found = ", ".join(read) or "nothing that is known"
        raise CheckpointInvalid(f"has no poses ({found})", where=str(path), hint=_kinds())
    poses = read["poses"]
    frames = len(poses) if poses.ndim > 1 else 1
    pose = _posed(path, poses.reshape(frames, -1), joints)
    place = read.get("Th", read.get("trans"))
    shift = np.zeros((frames, 3)) if place is None else _rows(path, "Th", place, frames, 3)
    turn = None
    if "R" in read:
        turn = _rows(path, "R", read["R"], frames, 9).reshape(-1, 3, 3)
    elif "Rh" in read:
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_rotvec(_rows(path, "Rh", read["Rh"], frames, 3)).as_matrix()
    shape = read.get("shapes")
    if shape is not None:  # one person, however often it is told
        shape = shape.reshape(len(shape), -1)[0] if shape.ndim > 1 else shape
    speed = read.get("mocap_framerate", read.get("mocap_frame_rate"))
    fps = float(speed.ravel()[0]) if speed is not None and speed.size else None
    return Motion(path, pose, shift, turn, shape, None, fps)


def _rows(
    path: Path, name: str, array: np.ndarray, frames: int, width: int
) -> Float[np.ndarray, "t w"]:
    if array.size != frames * width:
        what = f"{name} is {list(array.shape)}, wanted {width} numbers for {frames} frames"
        raise CheckpointInvalid(what, where=str(path))
    return array.reshape(frames, width)


def _posed(
    path: Path, poses: Float[np.ndarray, "t p"], joints: int
) -> Float[np.ndarray, "t j 3"]:
    """Turn poses of one body into those of another."""
    frames, width = poses.shape
    if width not in _WIDTHS:
        what = f"a pose has {width} numbers, wanted {', '.join(map(str, _WIDTHS))}"
        raise CheckpointInvalid(what, where=str(path))
    made = np.zeros((frames, 3 * joints))
    made[:, :_BODY] = poses[:, :_BODY]
    if 3 * joints == width:
        made = poses.copy()
    elif joints == 55 and width == 156:
        made[:, -_HANDS:] = poses[:, -_HANDS:]
    return made.reshape(frames, joints, 3)


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error


def _from_json(path: Path, frames: Sequence[Any], joints: int) -> Motion:
    poses, shifts, expressions = [], [], []
    for number, frame in enumerate(frames):
        where = f"{path}, frame {number}"
        if not isinstance(frame, dict):
            what = f"is a {type(frame).__name__}, wanted {', '.join(_JSON)}, trans"
            raise CheckpointInvalid(what, where=where)
        parts = [_list(where, frame, name, size) for name, size in _JSON.items()]
        poses.append(np.concatenate(parts))
        shifts.append(_list(where, frame, "trans", 3))
        expressions.append(np.asarray(frame.get("expr", ()), np.float64).ravel())
    if not poses:
        raise CheckpointInvalid("holds no frame", where=str(path))
    pose = _posed(path, np.stack(poses), joints)
    expression = None
    if len({len(one) for one in expressions}) == 1 and len(expressions[0]):
        expression = np.stack(expressions)
    return Motion(path, pose, np.stack(shifts), None, None, expression, None)


def _list(where: str, frame: Mapping[str, Any], name: str, size: int) -> np.ndarray:
    try:
        made = np.asarray(frame[name], np.float64).ravel()
    except (KeyError, ValueError, TypeError) as error:
        what = f"{name} is missing or no list of numbers"
        raise CheckpointInvalid(what, where=where) from error
    if len(made) != size or not np.isfinite(made).all():
        what = f"{name} has {len(made)} numbers, wanted {size}, all finite"
        raise CheckpointInvalid(what, where=where)
    return made
