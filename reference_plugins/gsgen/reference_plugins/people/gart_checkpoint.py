"""Reads checkpoints of GART: a state dict and the profile of the training.

The layout is that of JiahuiLei/GART, ``solver.py``: ``model.pth`` and a copy of the profile, such as
``people_30s.yaml``. The state dict holds joints and parents of SMPL and a grid of skinning weights,
so no body model is read.
"""

__all__ = ["GartCheckpoint", "read_gart"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gsgen.reference_plugins.bodies.body_models import read_parents
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import (
    Layer,
    Shape,
    layer_of,
    linear_shapes,
    load_state,
    require_tensors,
)
from gsgen.reference_plugins.loading.yaml_options import read_yaml_options
from gsgen.sdk.math import axis_angle_to_matrix

JOINTS = 24
_POSE_SIZE = 3 * (JOINTS - 1)
_BONE_SIZE = 7  # a quaternion and a translation
_MAX_DEGREE = 4
_GRID = "template.voxel_deformer"
_PARENTS = "template._template_layer.parents"
# Buffers of training, and of SMPL, that a frame does not depend on.
_IGNORED = (
    "xyz_gradient_", "max_radii2D", "_features_localcode", "template._template_layer.",
    "template.init_beta", "template.canonical_pose", f"{_GRID}.global_scale",
    f"{_GRID}.grid_denorm",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class GartCheckpoint:
    """A trained avatar of GART: Gaussians of the canonical pose, their weights, and the bones."""

    path: Path
    position: Float[Tensor, "n 3"]
    rotation: Float[Tensor, "n 4"]
    scale: Float[Tensor, "n 3"]  # standard deviations
    opacity: Float[Tensor, "n 1"]
    sh: Float[Tensor, "n k 3"]  # in the Gaussian's own axes
    weights: Float[Tensor, "n j+b"]  # of the joints, then of the additional bones
    joints: Float[Tensor, "j 3"]  # of the rest pose
    parents: tuple[int, ...]
    to_rest: Float[Tensor, "j 4 4"]  # from the canonical pose to the rest pose
    root: Float[Tensor, "3"]  # the point around which the root joint turns the bones
    bone_layers: tuple[Layer, ...] = ()  # the network of the pose that moves the bones
    bone_head: Float[Tensor, "o i"] | None = None  # its last layer, which has no bias
    bone_frames: Float[Tensor, "t b 3 4"] | None = None  # the bones of each training frame

    @property
    def degree(self) -> int:
        """The degree of the spherical harmonics, 0 to 4."""
        return int(self.sh.shape[1] ** 0.5) - 1

    def describe(self) -> str:
        """Return the sizes of the avatar as one line."""
        bones = self.weights.shape[1] - JOINTS
        motion = "moved by a network of the pose" if self.bone_head is not None else ""
        if self.bone_frames is not None:
            motion = f"of {len(self.bone_frames)} training frames"
        return (
            f"{self.path}: {len(self.position):,} Gaussians of SH degree {self.degree}, "
            f"{JOINTS} joints and {bones} bones {motion}".rstrip()
        )


def read_gart(path: Path) -> GartCheckpoint:
    """Read a checkpoint of GART: the folder of its logs, or ``model.pth`` in it."""
    folder = path.parent if path.is_file() else path
    file = path if path.is_file() else folder / "model.pth"
    state = load_state(file, "the avatar that the solver saves at the end of training")
    joints = state.get("template.A0_inv")
    if isinstance(joints, Tensor) and joints.ndim == 3 and len(joints) != JOINTS:
        message = f"has {len(joints)} joints, expected the {JOINTS} of SMPL: dogs are not supported"
        raise CheckpointInvalid(message, where=str(file))
    tensors = require_tensors(file, state, _expected_shapes(state, file), _IGNORED)
    profiles = sorted(entry.name for entry in folder.glob("*.yaml"))
    options = read_yaml_options(folder, [*profiles, "profile.yaml"], "the options of training")
    low, high = options.number("MIN_SCALE", 0.0), options.number("MAX_SCALE", 0.1)
    features = torch.cat([tensors["_features_dc"], tensors["_features_rest"]], dim=1)
    layers = [layer_of(tensors, name) for name in _layer_names(state)]
    return GartCheckpoint(
        path=file,
        position=tensors["_xyz"],
        rotation=tensors["_rotation"],
        scale=low + torch.sigmoid(tensors["_scaling"].double()).float() * (high - low),
        opacity=torch.sigmoid(tensors["_opacity"]),
        sh=features.reshape(len(features), -1, 3),
        weights=_weights(tensors),
        joints=tensors["template.J_canonical"][0],
        parents=read_parents(file, _PARENTS, tensors[_PARENTS].numpy()),
        to_rest=tensors["template.A0_inv"],
        root=tensors["template.j0_t"],
        bone_layers=tuple(layers),
        bone_head=tensors.get("add_bones.mlp_output_head.weight"),
        bone_frames=_bone_frames(tensors) if "add_bones.dr_list" in tensors else None,
    )


def _expected_shapes(state: Mapping[str, Any], file: Path) -> dict[str, Shape]:
    """Return the tensors of a frame: sizes follow from some of them, which decide on the others."""
    count, rest = _size(state, "_xyz", 0), _size(state, "_features_rest", 1)
    degrees = {3 * ((degree + 1) ** 2 - 1): degree for degree in range(_MAX_DEGREE + 1)}
    if rest not in degrees:
        message = (
            f"_features_rest has {rest} columns, expected one of {', '.join(map(str, degrees))}"
        )
        raise CheckpointInvalid(message, where=str(file))
    cells = tuple(_size(state, f"{_GRID}.lbs_voxel_base", axis) for axis in (2, 3, 4))
    expected: dict[str, Shape] = {
        "_xyz": (count, 3),
        "_rotation": (count, 4),
        "_scaling": (count, 3),
        "_opacity": (count, 1),
        "_features_dc": (count, 3),
        "_features_rest": (count, rest),
        "template.A0_inv": (JOINTS, 4, 4),
        "template.J_canonical": (1, JOINTS, 3),
        "template.j0_t": (3,),
        _PARENTS: (JOINTS,),
        f"{_GRID}.lbs_voxel_base": (1, JOINTS, *cells),
        f"{_GRID}.offset": (1, 1, 3),
        f"{_GRID}.scale": (),
        f"{_GRID}.ratio": (),
        "_w_correction_dc": (count, JOINTS if _size(state, "_w_correction_dc", 1) else 0),
        "_w_correction_rest": (count, _size(state, "_w_correction_rest", 1)),
    }
    bones = _size(state, "_w_correction_rest", 1)
    if f"{_GRID}.voxel_w_correction" in state:
        expected[f"{_GRID}.voxel_w_correction"] = (1, JOINTS, *cells)
    if f"{_GRID}.additional_correction" in state:
        bones = _size(state, f"{_GRID}.additional_correction", 1)
        expected[f"{_GRID}.additional_correction"] = (1, bones, *cells)
    return expected | _bone_shapes(state, bones)


def _bone_shapes(state: Mapping[str, Any], bones: int | None) -> dict[str, Shape]:
    if "add_bones.dr_list" in state:
        frames = _size(state, "add_bones.dr_list", 0)
        return {f"add_bones.{name}": (frames, bones, 3) for name in ("dr_list", "dt_list")}
    if not bones:
        return {}
    expected: dict[str, Shape] = {}
    inputs: int | None = _POSE_SIZE
    for name in _layer_names(state):
        outputs = _size(state, f"{name}.weight", 0)
        expected |= linear_shapes(name, inputs, outputs)
        inputs = outputs
    return expected | {"add_bones.mlp_output_head.weight": (_BONE_SIZE * bones, inputs)}


def _layer_names(state: Mapping[str, Any]) -> list[str]:
    names: list[str] = []
    while f"add_bones.mlp_layers.{len(names)}.0.weight" in state:
        names.append(f"add_bones.mlp_layers.{len(names)}.0")
    return names


def _size(state: Mapping[str, Any], name: str, axis: int) -> int | None:
    """Return the size of a tensor's axis; None without such a tensor or axis."""
    tensor = state.get(name)
    return tensor.shape[axis] if isinstance(tensor, Tensor) and tensor.ndim > axis else None


def _weights(tensors: Mapping[str, Tensor]) -> Float[Tensor, "n j+b"]:
    """Return the weights of joints and bones: of the grid at the Gaussians, and of their own.

    The grid spans ±scale around ``offset``, and ±scale / ratio along z; outside of it, the nearest
    cell counts.
    """
    grids = [tensors[f"{_GRID}.lbs_voxel_base"].double()]
    if f"{_GRID}.voxel_w_correction" in tensors:
        grids[0] = grids[0] + tensors[f"{_GRID}.voxel_w_correction"]
    if f"{_GRID}.additional_correction" in tensors:
        grids.append(tensors[f"{_GRID}.additional_correction"].double())
    offset, scale = tensors[f"{_GRID}.offset"][0].double(), tensors[f"{_GRID}.scale"].double()
    coordinates = (tensors["_xyz"] - offset) / scale
    coordinates[:, 2] *= tensors[f"{_GRID}.ratio"]
    sampled = functional.grid_sample(
        torch.cat(grids, dim=1),
        coordinates[None, :, None, None],
        padding_mode="border",
        align_corners=True,
    )
    weights = sampled[0, :, :, 0, 0].t()
    own = tensors["_w_correction_dc"]
    if own.shape[1]:
        weights[:, :JOINTS] += own
    return torch.cat([weights, tensors["_w_correction_rest"]], dim=1).float()


def _bone_frames(tensors: Mapping[str, Tensor]) -> Float[Tensor, "t b 3 4"]:
    """Return the bones of each frame: steps from frame to frame, multiplied up from the first."""
    rotations = axis_angle_to_matrix(tensors["add_bones.dr_list"].double())
    steps = torch.eye(4, dtype=torch.float64).repeat(*rotations.shape[:2], 1, 1)
    steps[:, :, :3, :3], steps[:, :, :3, 3] = rotations, tensors["add_bones.dt_list"]
    frames = [steps[0]]
    for step in steps[1:]:
        frames.append(frames[-1] @ step)
    return torch.stack(frames)[:, :, :3].float()
