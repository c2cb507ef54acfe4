"""Reads checkpoints of R3-Avatar: Gaussians, a hexplane with decoder, and GauHuman's networks.

``chkpntN.pth`` holds all of them, with networks pickled as objects of classes that only the
training code has. ``torch.load(weights_only=True)`` replaces these by an inert class
(Yifever20002/R3Avatars, ``scene/gaussian_model.py``: ``capture``).
"""

__all__ = ["FRAMES_BY_DATASET", "R3Checkpoint", "guess_dataset", "read_r3"]

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
from gsgen.reference_plugins.loading.folder import last_iteration, likely_folders, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method
from gsgen.reference_plugins.loading.states import (
    Layer,
    Shape,
    layer_of,
    linear_shapes,
    require_tensors,
)
from gsgen.reference_plugins.loading.tensor_files import PlaceholderObject, load_tensors
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_body_of
from gsgen.reference_plugins.tensors.hexplane import PLANE_COUNT

# Data set → the pose id at which time is 0 (R3-Avatar, gaussian_renderer/__init__.py).
FRAMES_BY_DATASET = {"dna": 50, "zju": 150, "hifi4g": 75, "mvhuman": 75}
# Part of the path by which training selects the reader, in its order (its scene/__init__.py).
_DATASET_NAMES = {
    "zju_mocap": "zju",
    "DNA-Rendering": "dna",
    "HiFi4G": "hifi4g",
    "MVHumanNet": "mvhuman",
}
# Body model that each data set is fitted with (its scripts).
_BODY_MODEL_OF_DATASET = {"dna": "smplx", "zju": "smpl", "hifi4g": "smpl", "mvhuman": "smplx"}

_FILE_PATTERN = re.compile(r"chkpnt(\d+)\.pth")
_FIELD_COUNT = 19
_CHANNELS_BY_HEAD = {"warp": 3, "opacity": 1, "rotation": 4, "scaling": 3}
_TRAINING_CLASSES = (
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


class _PlaceholderModule(PlaceholderObject):
    """Inert stand-in for a pickled network; it gives access to the network's tensors."""

    def tensors(self, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
        """Yield the names and tensors of a pickled network, as ``state_dict`` would return them."""
        for name, value in dict(self.given_state.get("_parameters", {})).items():
            if isinstance(value, Tensor):
                yield prefix + name, value
        for name, child in dict(self.given_state.get("_modules", {})).items():
            if isinstance(child, _PlaceholderModule):
                yield from child.tensors(f"{prefix}{name}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class R3Checkpoint:
    """A trained avatar of R3-Avatar, without poses."""

    path: Path
    cfg: CfgArgs  # options of the training run
    # the Gaussians; their opacity, rotation and scale are replaced by the decoder's
    canonical: Canonical
    aabb: Float[Tensor, "2 3"]  # lower and upper corner of the hexplane
    grids: tuple[tuple[Tensor, ...], ...]  # sets of six planes [C, h, w], one for each resolution
    inner: tuple[Layer, ...]  # hidden layers of the decoder
    heads: Mapping[str, Layer]  # output layers of the decoder, by attribute
    nets: PoseNets  # networks that correct joints and weights
    body: Body  # the body model
    origin: int  # the pose id at which time is 0

    def describe(self) -> str:
        """Describe an R3-Avatar checkpoint in one line: Gaussians, hexplane, frames, body model."""
        return (
            f"{self.path}: {self.canonical.describe()}, "
            f"{len(self.grids)} × 6 planes, time 0 at pose "
            f"{self.origin}; {self.body.describe()}"
        )


def read_r3(
    folder: Path, iteration: int | None = None, body: Path | None = None, dataset: str | None = None
) -> R3Checkpoint:
    """Read a checkpoint of R3-Avatar.

    ``folder`` is the training run, or its ``chkpntN.pth``. Without ``body``, the body model is
    searched under ``assets``; without ``dataset``, it is guessed from ``cfg_args``.
    """
    path = _checkpoint_file(folder, iteration)
    folder = path.parent
    cfg = read_cfg_args(folder)
    origin = FRAMES_BY_DATASET[dataset or guess_dataset(cfg)]
    model = read_body_of(folder, cfg, body)
    fields = _read_fields(path)
    nets = read_pose_nets(path, _state(path, fields[12]), _state(path, fields[13]), model.joints)
    grids = _read_grids(path, _state(path, fields[16]))
    features = sum(planes[0].shape[0] for planes in grids)
    inner, heads = _decoder(path, _state(path, fields[18]), features)
    aabb = require_tensors(path, {"aabb": fields[14]}, {"aabb": (2, 3)})["aabb"]
    if not (aabb[0] < aabb[1]).all():
        message = f"aabb is {aabb.tolist()}, expected the lower corner before the upper corner"
        raise CheckpointInvalid(message, where=str(path))
    canonical = _read_canonical(path, fields)
    return R3Checkpoint(
        path=path,
        cfg=cfg,
        canonical=canonical,
        aabb=aabb,
        grids=grids,
        inner=inner,
        heads=heads,
        nets=nets,
        body=model,
        origin=origin,
    )


def _checkpoint_file(folder: Path, iteration: int | None) -> Path:
    name_match = _FILE_PATTERN.fullmatch(folder.name) if folder.is_file() else None
    if name_match and iteration in (None, -1, int(name_match[1])):
        return folder
    folder, iteration = within_run(folder, iteration)
    if not folder.is_dir():
        message = "is not a folder" if folder.exists() else "does not exist"
        hint = "Give the folder of a training run, or its chkpntN.pth."
        raise CheckpointInvalid(message, where=str(folder), hint=hint)
    matches = ((_FILE_PATTERN.fullmatch(child.name), child) for child in folder.iterdir())
    files = {int(match[1]): child for match, child in matches if match}
    if not files:
        refuse_other_method("r3-avatar", folder, last_iteration(folder))
        hint = "Give the folder of a training run: only chkpntN.pth holds the planes."
        hint = likely_folders(folder, lambda candidate: any(candidate.glob("chkpnt*.pth"))) or hint
        raise CheckpointInvalid("holds no chkpntN.pth", where=str(folder), hint=hint)
    number = max(files) if iteration is None else iteration
    if number not in files:
        known = ", ".join(map(str, sorted(files)))
        message = f"has no iteration {number}"
        raise NotInCheckpoint(message, where=str(folder), hint=f"The iterations are {known}.")
    return files[number]


def guess_dataset(cfg: CfgArgs) -> str:
    """Guess the data set of a training run from the path of its data, or from the run's name."""
    source, name = cfg.word("source_path", ""), cfg.word("exp_name", "")
    body = cfg.word("smpl_type", "smpl")
    for name_mark, dataset in _DATASET_NAMES.items():
        if name_mark in source:
            return dataset
    for text in (source, name):
        mentioned_datasets = [
            dataset_name for dataset_name in FRAMES_BY_DATASET if dataset_name in text.lower()
        ]
        matching_datasets = [
            dataset_name
            for dataset_name in mentioned_datasets
            if _BODY_MODEL_OF_DATASET[dataset_name] == body
        ]
        if len(mentioned_datasets) == 1 or len(matching_datasets) == 1:
            return (mentioned_datasets if len(mentioned_datasets) == 1 else matching_datasets)[0]
    known = ", ".join(FRAMES_BY_DATASET)
    message = f"source_path is {source!r}, which names no known data set"
    hint = f"Give the data set of training: --dataset, one of {known}."
    raise CheckpointInvalid(message, where=str(cfg.path), hint=hint)


def _read_fields(path: Path) -> Any:
    hint = "Expected a checkpoint of R3-Avatar's training; code in files is not executed."
    read = load_tensors(path, hint, [(_PlaceholderModule, name) for name in _TRAINING_CLASSES])
    fields = read[0] if isinstance(read, tuple) and len(read) == 2 else None
    if not isinstance(fields, tuple) or len(fields) != _FIELD_COUNT:
        message = f"is not a pair of {_FIELD_COUNT} fields and an iteration"
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    return fields


def _state(path: Path, module: Any) -> dict[str, Tensor]:
    if not isinstance(module, _PlaceholderModule):
        message = f"holds a {type(module).__name__}, expected a network"
        raise CheckpointInvalid(message, where=str(path))
    return dict(module.tensors())


def _read_canonical(path: Path, fields: Any) -> Canonical:
    names = ("xyz", "f_dc", "f_rest", "scaling", "rotation", "opacity")
    tensors = dict(zip(names, fields[1:7], strict=True))
    xyz = tensors["xyz"]
    count = xyz.shape[0] if isinstance(xyz, Tensor) and xyz.ndim else None
    expected: dict[str, Shape] = {
        "xyz": (count, 3),
        "f_dc": (count, 1, 3),
        "f_rest": (count, None, 3),
        "scaling": (count, 3),
        "rotation": (count, 4),
        "opacity": (count, 1),
    }
    read = require_tensors(path, tensors, expected)
    sh = torch.cat([read["f_dc"], read["f_rest"]], dim=1)
    if sh.shape[1] not in (1, 4, 9, 16):
        message = f"f_rest has {sh.shape[1] - 1} coefficients, expected 0, 3, 8 or 15"
        raise CheckpointInvalid(message, where=str(path))
    return Canonical(
        position=read["xyz"],
        rotation=read["rotation"],
        log_scale=read["scaling"],
        logit_opacity=read["opacity"],
        sh=sh,
    )


def _read_grids(path: Path, state: Mapping[str, Tensor]) -> tuple[tuple[Tensor, ...], ...]:
    scales = {name.partition(".")[0] for name in state}
    sizes: dict[str, Shape] = {
        f"{scale}.{plane}": (1, None, None, None)
        for scale in range(len(scales))
        for plane in range(PLANE_COUNT)
    }
    read = require_tensors(path, state, sizes)
    return tuple(
        tuple(read[f"{scale}.{plane}"][0] for plane in range(PLANE_COUNT))
        for scale in range(len(scales))
    )


def _decoder(
    path: Path, state: Mapping[str, Tensor], features: int
) -> tuple[tuple[Layer, ...], dict[str, Layer]]:
    count = sum(bool(re.fullmatch(r"linear\.\d+\.weight", name)) for name in state)
    first = state.get("linear.0.weight")
    width = first.shape[0] if first is not None and first.ndim else None
    expected: dict[str, Shape] = {}
    for index in range(count):
        expected |= linear_shapes(f"linear.{index}", width if index else features, width)
    for head, outputs in _CHANNELS_BY_HEAD.items():
        expected |= linear_shapes(f"gaussian_{head}", width, outputs)
    read = require_tensors(path, state, expected)
    inner = tuple(layer_of(read, f"linear.{index}") for index in range(count))
    return inner, {head: layer_of(read, f"gaussian_{head}") for head in _CHANNELS_BY_HEAD}
