"""Body models: SMPL and SMPL-X, as the files that their makers hand out.

Both are gated: whoever registers may use them, nobody may pass them on. So nothing of them is kept
here, and a file is known by the shapes in it (Loper et al. 2015, "SMPL"; Pavlakos et al. 2019,
"Expressive Body Capture").
"""

__all__ = ["Body", "joints_of_file", "read_body", "required_body"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

# Joints → what the model is called, and where it can be had.
KINDS = {
    24: ("SMPL", "https://smpl.is.tue.mpg.de"),
    55: ("SMPL-X", "https://smpl-x.is.tue.mpg.de"),
}
_NEEDED = ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table")
_HANDS = ("hands_meanl", "hands_meanr")
# What stands for "no parent" in the file.
_NO_PARENT = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class Body:
    """A skinned body of V vertices and J joints, in float64.

    Attributes:
        path: Where it was read.
        template: Vertices at rest, [V, 3].
        shape_dirs: What each shape coefficient adds, [V, 3, S].
        pose_dirs: What each entry of the joints' R − I adds (the root's left out), [V, 3, 9(J−1)].
        weights: How much each vertex hangs on each joint, [V, J].
        regressor: Joints from vertices, [J, V].
        parents: The parent of each joint; −1 for the root.
        hand_mean: What SMPL-X adds to the poses of both hands, [90], where the file says so.
    """

    path: Path
    template: Float[np.ndarray, "v 3"]
    shape_dirs: Float[np.ndarray, "v 3 s"]
    pose_dirs: Float[np.ndarray, "v 3 p"]
    weights: Float[np.ndarray, "v j"]
    regressor: Float[np.ndarray, "j v"]
    parents: tuple[int, ...]
    hand_mean: Float[np.ndarray, "90"] | None = None

    @property
    def joints(self) -> int:
        """How many there are."""
        return len(self.parents)

    @property
    def kind(self) -> str:
        """SMPL or SMPL-X."""
        return KINDS[self.joints][0]

    def describe(self) -> str:
        """Say in one line what it is."""
        return (
            f"{self.path}: {self.kind} of {len(self.template):,} vertices, {self.joints} joints "
            f"and {self.shape_dirs.shape[2]} shape coefficients"
        )


def required_body(given: Path | None, places: Mapping[str, Path], joints: int) -> Path:
    """Return the file of a body model: the one given, or the first that exists.

    Args:
        given: What the user said.
        places: Where the training code keeps it, in words → path.
        joints: 24 or 55.

    Raises:
        CheckpointInvalid: There is none; the error says where it comes from and what is in it.
    """
    for path in (given,) if given is not None else places.values():
        if path.is_file():
            return path
    name, home = KINDS[joints]
    looked = ", ".join(str(path) for path in places.values()) or "nowhere else"
    where = str(given) if given is not None else "--body"
    what = f"the body model {name} is missing" + (
        "" if given else f" (looked for {looked})"
    )
    suffix = ".pkl or .npz" if joints == 24 else ".npz"
    raise CheckpointInvalid(
        what,
        where=where,
        hint=f"Register at {home}, accept the licence, download the model and give it: "
        f"--body {name.replace('-', '')}_NEUTRAL{suffix}. Wanted {', '.join(_NEEDED)} of "
        f"{joints} joints; it may not be passed on, so it cannot be fetched for you.",
    )


def read_body(path: Path, joints: int) -> Body:
    """Read a body model of ``joints`` joints from a ``.pkl`` or ``.npz``.

    Raises:
        CheckpointInvalid: The file is damaged, lacks arrays, or is of another body.
    """
    required_body(path, {}, joints)
    read = _arrays(path)
    missing = [name for name in _NEEDED if name not in read]
    if missing:
        hint = f"Wanted {', '.join(_NEEDED)}, as the file from {KINDS[joints][1]} has them."
        raise CheckpointInvalid(f"lacks {', '.join(missing)}", where=str(path), hint=hint)
    arrays = {name: _numbers(path, name, read[name]) for name in _NEEDED}
    _check_shapes(path, arrays, joints)
    hands = [_numbers(path, name, read[name]).ravel() for name in _HANDS if name in read]
    mean = np.concatenate(hands) if len(hands) == 2 else None
    if mean is not None and mean.shape != (90,):
        what = f"hands_meanl and hands_meanr hold {mean.size} numbers, wanted 90"
        raise CheckpointInvalid(what, where=str(path))
    return Body(
        path,
        arrays["v_template"],
        arrays["shapedirs"],
        arrays["posedirs"],
        arrays["weights"],
        arrays["J_regressor"],
        _parents(path, arrays["kintree_table"][0]),
        mean,
    )


def joints_of_file(path: Path) -> int:
    """Return how many joints the body in a file has; 0 where it does not say.

    Raises:
        CheckpointInvalid: The file is damaged.
    """
    shape = np.shape(_arrays(path).get("kintree_table", ()))
    return int(shape[-1]) if shape else 0


def _arrays(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        zipped = file.read(4) == b"PK\x03\x04"
    if not zipped:
        return read_array_pickle(path)
    # Only what is needed: the published files hold pickled objects besides.
    return read_npz(path, (*_NEEDED, *_HANDS))


def _numbers(path: Path, name: str, value: Any) -> Float[np.ndarray, "..."]:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        what = f"{name} holds {array.dtype}, wanted numbers"
        raise CheckpointInvalid(what, where=str(path))
    made = array.astype(np.float64)
    if not np.isfinite(made).all():
        raise CheckpointInvalid(f"{name} holds NaN or infinity", where=str(path))
    return made


def _check_shapes(path: Path, arrays: Mapping[str, np.ndarray], joints: int) -> None:
    vertices = len(arrays["v_template"])
    shapes = arrays["shapedirs"].shape[2] if arrays["shapedirs"].ndim == 3 else 1
    wanted = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, shapes),
        "posedirs": (vertices, 3, 9 * (joints - 1)),
        "weights": (vertices, joints),
        "J_regressor": (joints, vertices),
        "kintree_table": (2, joints),
    }
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            seen = list(arrays[name].shape)
            hint = f"Give the {KINDS[joints][0]} model, from {KINDS[joints][1]}."
            what = f"{name} is {seen}, wanted {list(shape)}"
            raise CheckpointInvalid(what, where=str(path), hint=hint)


def _parents(path: Path, table: Float[np.ndarray, " j"]) -> tuple[int, ...]:
    parents = [-1 if p in (-1, _NO_PARENT) else int(p) for p in table]
    for joint, parent in enumerate(parents):
        if not (parent == -1 if joint == 0 else 0 <= parent < joint):
            what = f"kintree_table gives joint {joint} the parent {parent}"
            hint = "Wanted the root first, and every parent before its children."
            raise CheckpointInvalid(what, where=str(path), hint=hint)
    return tuple(parents)
