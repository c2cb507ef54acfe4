"""Checkpoints of R3-Avatar: Gaussians, a hexplane with its decoder, and GauHuman's two networks.

``chkpntN.pth`` holds all of it, with its networks pickled as objects of classes that only the
training code has. ``torch.load(weights_only=True)`` is told to put an inert class in their place
(Yifever20002/R3Avatars, ``scene/gaussian_model.py``: ``capture``).
"""

__all__ = ["DATASETS", "R3Checkpoint", "guessed_dataset", "read_r3"]

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_networks import PoseNets, read_pose_nets
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.loading.cfg_args import CfgArgs, read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.loading.folder import likely_folders, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method
from gsgen.reference_plugins.loading.states import Shape, require_tensors
from gsgen.reference_plugins.loading.tensor_files import Inert, load_tensors
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_body_of

# Data set → the pose id at which time is 0 (R3-Avatar, gaussian_renderer/__init__.py).
DATASETS = {"dna": 50, "zju": 150, "hifi4g": 75, "mvhuman": 75}
# What a path holds by which training picks the reader, in its order (its scene/__init__.py).
_MARKS = {
    "zju_mocap": "zju",
    "DNA-Rendering": "dna",
    "HiFi4G": "hifi4g",
    "MVHumanNet": "mvhuman",
}
# Which body each data set is fitted with (its scripts).
_BODIES = {"dna": "smplx", "zju": "smpl", "hifi4g": "smpl", "mvhuman": "smplx"}

_FILE = re.compile(r"chkpnt(\d+)\.pth")
_FIELDS = 19
_HEADS = {"warp": 3, "opacity": 1, "rotation": 4, "scaling": 3}
_PLANES = 6
_CLASSES = (
    "nets.gaussian_decoder.GaussianDecoder",
    "nets.mlp_delta_body_pose.BodyPoseRefiner",
    "nets.mlp_delta_body_pose.RodriguesModule",
    "nets.mlp_delta_weight_lbs.LBSOffsetDecoder",
    *(
        f"torch.nn.modules.{name}"
        for name in (
            "activation.ReLU",
            "container.ModuleList",
            "container.ParameterList",
            "container.Sequential",
            "conv.Conv1d",
            "linear.Linear",
        )
    ),
)

Layer = tuple[Float[Tensor, "o i"], Float[Tensor, " o"]]


class _Shell(Inert):
    """Stands for a module of the file, whose tensors are wanted."""

    def tensors(self, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
        """Yield what ``state_dict`` would."""
        for name, value in dict(self.given.get("_parameters", {})).items():
            if isinstance(value, Tensor):
                yield prefix + name, value
        for name, child in dict(self.given.get("_modules", {})).items():
            if isinstance(child, _Shell):
                yield from child.tensors(f"{prefix}{name}.")


@dataclass(frozen=True, slots=True)
class R3Checkpoint:
    """Everything that inference needs, but for poses.

    Attributes:
        path: The file.
        cfg: Options of the training run.
        canonical: The Gaussians; opacity, rotation and scale are the decoder's, and these unused.
        aabb: Lower and upper corner of the hexplane.
        grids: Sets of six planes [C, h, w].
        inner: Layers of the decoder.
        heads: What it says of each Gaussian, as layers.
        nets: Networks that correct joints and weights.
        body: The body model.
        origin: The pose id at which time is 0.
    """

    path: Path
    cfg: CfgArgs
    canonical: Canonical
    aabb: Float[Tensor, "2 3"]
    grids: tuple[tuple[Tensor, ...], ...]
    inner: tuple[Layer, ...]
    heads: Mapping[str, Layer]
    nets: PoseNets
    body: Body
    origin: int

    def describe(self) -> str:
        """Say in one line what it holds."""
        return (
            f"{self.path}: {self.canonical.describe()}, "
            f"{len(self.grids)} × 6 planes, time 0 at pose "
            f"{self.origin}; {self.body.describe()}"
        )


def read_r3(
    folder: Path,
    iteration: int | None = None,
    body: Path | None = None,
    dataset: str | None = None,
) -> R3Checkpoint:
    """Read a checkpoint of R3-Avatar.

    Args:
        folder: What training wrote, or its ``chkpntN.pth``.
        iteration: The last where absent.
        body: The body model; looked for under ``assets`` where absent.
        dataset: Which reader training used; guessed from ``cfg_args`` where absent.

    Raises:
        CheckpointInvalid: Something is missing, or does not fit the rest.
    """
    path = _find(folder, iteration)
    folder = path.parent
    cfg = read_cfg_args(folder)
    origin = DATASETS[dataset or guessed_dataset(cfg)]
    model = read_body_of(folder, cfg, body)
    fields = _fields(path)
    nets = read_pose_nets(
        path, _state(path, fields[12]), _state(path, fields[13]), model.joints
    )
    grids = _grids(path, _state(path, fields[16]))
    features = sum(six[0].shape[0] for six in grids)
    inner, heads = _decoder(path, _state(path, fields[18]), features)
    aabb = require_tensors(path, {"aabb": fields[14]}, {"aabb": (2, 3)})["aabb"]
    if not (aabb[0] < aabb[1]).all():
        what = f"aabb is {aabb.tolist()}, wanted the lower corner before the upper"
        raise CheckpointInvalid(what, where=str(path))
    canonical = _canonical(path, fields)
    return R3Checkpoint(
        path, cfg, canonical, aabb, grids, inner, heads, nets, model, origin
    )


def _find(folder: Path, iteration: int | None) -> Path:
    named = _FILE.fullmatch(folder.name) if folder.is_file() else None
    if named and iteration in (None, -1, int(named[1])):
        return folder
    folder, iteration = within_run(folder, iteration)
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "does not exist"
        hint = "Give the folder that training wrote, or its chkpntN.pth."
        raise CheckpointInvalid(what, where=str(folder), hint=hint)
    matches = ((_FILE.fullmatch(child.name), child) for child in folder.iterdir())
    found = {int(match[1]): child for match, child in matches if match}
    if not found:
        refuse_other_method("r3-avatar", folder, _last(folder))
        hint = "Give the folder that training wrote: the planes are in no other file."
        hint = likely_folders(folder, lambda one: any(one.glob("chkpnt*.pth"))) or hint
        raise CheckpointInvalid("holds no chkpntN.pth", where=str(folder), hint=hint)
    wanted = max(found) if iteration is None else iteration
    if wanted not in found:
        known = ", ".join(map(str, sorted(found)))
        what = f"has no iteration {wanted}"
        raise NotInCheckpoint(what, where=str(folder), hint=f"There are: {known}.")
    return found[wanted]


def _last(folder: Path) -> Path:
    """Return an iteration's folder, by which other methods are told; the run's if there is none."""
    places = (folder / "point_cloud").glob("iteration_*")
    return max(places, default=folder)


def guessed_dataset(cfg: CfgArgs) -> str:
    """Return whose data a run was trained on: by its path, or else by the name of the run.

    Raises:
        CheckpointInvalid: Neither says so.
    """
    source, name = cfg.word("source_path", ""), cfg.word("exp_name", "")
    body = cfg.word("smpl_type", "smpl")
    for mark, dataset in _MARKS.items():
        if mark in source:
            return dataset
    for text in (source, name):
        found = [one for one in DATASETS if one in text.lower()]
        fitting = [one for one in found if _BODIES[one] == body]
        if len(found) == 1 or len(fitting) == 1:
            return (found if len(found) == 1 else fitting)[0]
    known = ", ".join(DATASETS)
    what = f"source_path is {source!r}, which does not say the kind of data"
    hint = f"Say which reader training used: --dataset, one of {known}."
    raise CheckpointInvalid(what, where=str(cfg.path), hint=hint)


def _fields(path: Path) -> Any:
    hint = "Wanted what R3-Avatar's training saves; code in files is not run."
    read = load_tensors(path, hint, [(_Shell, name) for name in _CLASSES])
    fields = read[0] if isinstance(read, tuple) and len(read) == 2 else None
    if not isinstance(fields, tuple) or len(fields) != _FIELDS:
        what = f"is no pair of {_FIELDS} fields and an iteration"
        raise CheckpointInvalid(what, where=str(path), hint=hint)
    return fields


def _state(path: Path, shell: Any) -> dict[str, Tensor]:
    if not isinstance(shell, _Shell):
        what = f"holds a {type(shell).__name__}, wanted a network"
        raise CheckpointInvalid(what, where=str(path))
    return dict(shell.tensors())


def _canonical(path: Path, fields: Any) -> Canonical:
    names = ("xyz", "f_dc", "f_rest", "scaling", "rotation", "opacity")
    given = dict(zip(names, fields[1:7], strict=True))
    xyz = given["xyz"]
    count = xyz.shape[0] if isinstance(xyz, Tensor) and xyz.ndim else None
    wanted: dict[str, Shape] = {
        "xyz": (count, 3),
        "f_dc": (count, 1, 3),
        "f_rest": (count, None, 3),
        "scaling": (count, 3),
        "rotation": (count, 4),
        "opacity": (count, 1),
    }
    read = require_tensors(path, given, wanted)
    sh = torch.cat([read["f_dc"], read["f_rest"]], dim=1)
    if sh.shape[1] not in (1, 4, 9, 16):
        what = f"f_rest has {sh.shape[1] - 1} coefficients, wanted 0, 3, 8 or 15"
        raise CheckpointInvalid(what, where=str(path))
    return Canonical(
        position=read["xyz"],
        rotation=read["rotation"],
        log_scale=read["scaling"],
        logit_opacity=read["opacity"],
        sh=sh,
    )


def _grids(path: Path, state: Mapping[str, Tensor]) -> tuple[tuple[Tensor, ...], ...]:
    scales = {name.partition(".")[0] for name in state}
    sizes: dict[str, Shape] = {
        f"{scale}.{plane}": (1, None, None, None)
        for scale in range(len(scales))
        for plane in range(_PLANES)
    }
    read = require_tensors(path, state, sizes)
    return tuple(
        tuple(read[f"{scale}.{plane}"][0] for plane in range(_PLANES))
        for scale in range(len(scales))
    )


def _decoder(
    path: Path, state: Mapping[str, Tensor], features: int
) -> tuple[tuple[Layer, ...], dict[str, Layer]]:
    count = sum(bool(re.fullmatch(r"linear\.\d+\.weight", name)) for name in state)
    first = state.get("linear.0.weight")
    wide = first.shape[0] if first is not None and first.ndim else None
    wanted: dict[str, Shape] = {}
    for index in range(count):
        inputs = wide if index else features
        wanted |= {f"linear.{index}.weight": (wide, inputs)}
        wanted |= {f"linear.{index}.bias": (wide,)}
    for head, outputs in _HEADS.items():
        wanted |= {f"gaussian_{head}.weight": (outputs, wide)}
        wanted |= {f"gaussian_{head}.bias": (outputs,)}
    read = require_tensors(path, state, wanted)

    def layer(name: str) -> Layer:
        return read[f"{name}.weight"], read[f"{name}.bias"]

    inner = tuple(layer(f"linear.{index}") for index in range(count))
    return inner, {head: layer(f"gaussian_{head}") for head in _HEADS}
