"""Checkpoints of anchor methods: a PLY of anchors and, beside it, the networks that decode them.

The layout is that of Scaffold-GS (``scene/gaussian_model.py``: ``save_ply``,
``save_mlp_checkpoints``) and of Octree-GS, which adds levels. Networks are either one TorchScript
file each, or state dicts in one file: ``checkpoints.pth`` of the mode ``unite``, and
``checkpoint.pth`` of the first versions of Scaffold-GS.
"""

__all__ = [
    "AnchorCheckpoint",
    "AnchorCloud",
    "AnchorNets",
    "Mlp",
    "States",
    "describe_anchors",
    "numbered",
    "read_anchors",
    "read_nets",
    "require_appearance",
    "require_sizes",
]

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import FormatError, ply_properties, read_ply_columns
from gsgen.reference_plugins.loading.cfg_args import CfgArgs, read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.loading.folder import find_iteration, required_file, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method
from gsgen.reference_plugins.loading.states import (
    Shape,
    load_network,
    load_state,
    require_tensors,
)

_OFFSET = re.compile(r"f_offset_(\d+)")
_FEATURE = re.compile(r"f_anchor_feat_(\d+)")
_XYZ = ("x", "y", "z")
_SCALES = tuple(f"scale_{i}" for i in range(6))
_ROTATION = tuple(f"rot_{i}" for i in range(4))
_LEVELS = ("level", "extra_level", "info")
# The first versions of Scaffold-GS wrote the latter.
_UNITED = ("checkpoints.pth", "checkpoint.pth")
_RENAMED = {
    "appearance": "embedding",
    "feature_bank_mlp": "bank",
    "mlp_feature_bank": "bank",
}
_UNUSED = ("vi_mlp",)  # Duplex-GS saves it, and does not ask it
_DIRECTION = 3
_CHANNELS = {"opacity_mlp": 1, "cov_mlp": 7, "color_mlp": 3}


@dataclass(frozen=True, slots=True)
class AnchorCloud:
    """N anchors, each of which stands for K Gaussians.

    Attributes:
        position: Where anchors are.
        offset: Of each Gaussian, in units of the anchor's first three scales.
        feature: What networks decode.
        log_scale: Logarithms of the scale of offsets, and of that of Gaussians.
        rotation: Quaternions (w, x, y, z); only the prefilter uses them.
        level: Octree level, from 0; absent in Scaffold-GS.
        extra_level: A learnt shift of the level that a distance asks for.
        info: What the method stores in the first rows of a column: voxel size, distance, …
    """

    position: Float[Tensor, "n 3"]
    offset: Float[Tensor, "n k 3"]
    feature: Float[Tensor, "n f"]
    log_scale: Float[Tensor, "n 6"]
    rotation: Float[Tensor, "n 4"]
    level: Float[Tensor, " n"] | None = None
    extra_level: Float[Tensor, " n"] | None = None
    info: Float[Tensor, " n"] | None = None

    def __len__(self) -> int:
        return self.position.shape[0]

    @property
    def per_anchor(self) -> int:
        """Gaussians of one anchor, K."""
        return self.offset.shape[1]

    @property
    def width(self) -> int:
        """Length of a feature, F."""
        return self.feature.shape[1]


@dataclass(frozen=True, slots=True)
class Mlp:
    """Two layers with ReLU between them, as (out, in) matrices.

    Attributes:
        hidden: Weight of the first layer, [F, in].
        hidden_bias: Its bias.
        out: Weight of the second, [out, F].
        out_bias: Its bias.
        distance: Whether the distance is one of the inputs.
    """

    hidden: Float[Tensor, "f i"]
    hidden_bias: Float[Tensor, " f"]
    out: Float[Tensor, "o f"]
    out_bias: Float[Tensor, " o"]
    distance: bool = False


@dataclass(frozen=True, slots=True)
class AnchorNets:
    """The networks of one checkpoint.

    Attributes:
        opacity: [feature, direction, (distance), (level)] → K.
        covariance: The same → 7 K.
        color: The same and an appearance → 3 K.
        bank: [direction, …] → 3 weights of the feature bank, where there is one.
        embedding: Appearance of each training camera, [cameras, D].
        level: Whether the level is one of the inputs.
    """

    opacity: Mlp
    covariance: Mlp
    color: Mlp
    bank: Mlp | None = None
    embedding: Float[Tensor, "cameras d"] | None = None
    level: bool = False


@dataclass(frozen=True, slots=True)
class AnchorCheckpoint:
    """Everything that inference needs.

    Attributes:
        folder: Of the training run.
        iteration: Which one.
        cfg: Its options.
        cloud: The anchors.
        nets: The networks.
    """

    folder: Path
    iteration: int
    cfg: CfgArgs
    cloud: AnchorCloud
    nets: AnchorNets


def read_anchors(
    folder: Path, iteration: int | None = None, *, octree: bool = False
) -> AnchorCheckpoint:
    """Read an anchor checkpoint.

    Args:
        folder: What training wrote, or what is in it of an iteration.
        iteration: The last where absent.
        octree: Anchors have levels (Octree-GS).

    Raises:
        CheckpointInvalid: Something is missing, or does not fit the rest.
    """
    folder, iteration = within_run(folder, iteration)
    number, place = find_iteration(folder, iteration)
    refuse_other_method("octree-gs" if octree else "scaffold-gs", folder, place)
    cfg = read_cfg_args(folder, required=octree)
    ply = required_file(place / "point_cloud.ply", "the anchors")
    cloud = _read_cloud(ply, octree)
    require_sizes(cfg, cloud, ply)
    return AnchorCheckpoint(
        folder, number, cfg, cloud, read_nets(place, cfg, cloud, octree)
    )


def require_sizes(cfg: CfgArgs, cloud: AnchorCloud, ply: Path) -> None:
    """Refuse anchors of other sizes than the options say.

    Raises:
        CheckpointInvalid: They are of another run.
    """
    for option, seen in (("n_offsets", cloud.per_anchor), ("feat_dim", cloud.width)):
        if cfg.integer(option, seen) != seen:
            what = f"{option} is {cfg.values[option]}, but {ply.name} has {seen}"
            raise CheckpointInvalid(what, where=str(cfg.path))


def _read_cloud(path: Path, octree: bool) -> AnchorCloud:
    try:
        names = ply_properties(path)
        offsets, features = numbered(_OFFSET, names), numbered(_FEATURE, names)
        groups = {"position": _XYZ, "scale": _SCALES, "rotation": _ROTATION}
        groups |= {"offset": offsets, "feature": features}
        groups |= {name: (name,) for name in _LEVELS} if octree else {}
        if not offsets or len(offsets) % 3 or not features:
            what = f"{len(offsets)} properties f_offset and {len(features)} f_anchor_feat"
            hint = "Expected 3 K and F of them: is this a checkpoint of another method?"
            raise CheckpointInvalid(what, where=str(path), hint=hint)
        tables = read_ply_columns(path, groups)
    except FormatError as error:
        raise CheckpointInvalid(
            str(error).replace(f"{path}: ", ""), where=str(path)
        ) from error
    read = {name: torch.from_numpy(table) for name, table in tables.items()}
    axes = read["offset"].reshape(len(read["offset"]), 3, -1)  # stored axis by axis
    columns = {name: read[name].reshape(-1) for name in _LEVELS if octree}
    return AnchorCloud(
        read["position"],
        axes.transpose(1, 2).contiguous(),
        read["feature"],
        read["scale"],
        read["rotation"],
        **columns,
    )


def numbered(pattern: re.Pattern[str], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names that fit, by number: files may list them in the order of text."""
    found = [(int(match[1]), name) for name in names if (match := pattern.fullmatch(name))]
    return tuple(name for _, name in sorted(found))


@dataclass(frozen=True, slots=True)
class _Sizes:
    """What the shapes of networks follow from."""

    per_anchor: int
    width: int
    appearance: int
    level: bool
    octree: bool


def read_nets(place: Path, cfg: CfgArgs, cloud: AnchorCloud, octree: bool) -> AnchorNets:
    """Read the networks beside the anchors.

    Args:
        place: The folder of the iteration.
        cfg: The options of the run.
        cloud: The anchors, whose sizes the networks' shapes follow from.
        octree: Networks may know the level.

    Raises:
        CheckpointInvalid: One is missing, or does not fit.
    """
    states = _states(place)
    path, state = states.get("embedding", (place, {}))
    embedding = _embedding(path, state, cfg) if state else None
    appearance = cfg.integer("appearance_dim", 0) if cfg.present else 0
    if embedding is not None:
        appearance = embedding.shape[1]
    elif appearance > 0:
        what = f"is missing: appearance_dim is {appearance}"
        raise CheckpointInvalid(what, where=str(place / "embedding_appearance.pt"))
    level = octree and cfg.flag("add_level")
    sizes = _Sizes(cloud.per_anchor, cloud.width, appearance, level, octree)
    heads = {name: _head(name, states, place, cfg, sizes) for name in _CHANNELS}
    bank = _bank(states, place, sizes) if _has_bank(states, place, cfg) else None
    return AnchorNets(
        heads["opacity_mlp"], heads["cov_mlp"], heads["color_mlp"], bank, embedding, level
    )


States = Mapping[str, tuple[Path, Mapping[str, Any]]]


def _states(place: Path) -> States:
    """Return each network's file and state dict, from one file or from many."""
    for united in (place / name for name in _UNITED if (place / name).is_file()):
        found = load_state(united, "the networks")
        known = {*_CHANNELS, *_RENAMED, *_UNUSED}
        if unknown := sorted(str(key) for key in found if found[key] and key not in known):
            what = f"unexpected: {', '.join(unknown)}; known are {', '.join(sorted(known))}"
            raise CheckpointInvalid(what, where=str(united))
        return {_RENAMED.get(key, key): (united, found[key]) for key in found if found[key]}
    files = {name: f"{name}.pt" for name in _CHANNELS}
    files |= {"bank": "feature_bank_mlp.pt", "embedding": "embedding_appearance.pt"}
    paths = {name: place / file for name, file in files.items()}
    return {
        name: (path, load_network(path)) for name, path in paths.items() if path.is_file()
    }


def _embedding(path: Path, state: Mapping[str, Any], cfg: CfgArgs) -> Tensor:
    wide = cfg.integer("appearance_dim", 0) if "appearance_dim" in cfg.values else None
    return require_tensors(path, state, {"embedding.weight": (None, wide)})["embedding.weight"]


def _head(name: str, states: States, place: Path, cfg: CfgArgs, sizes: _Sizes) -> Mlp:
    if name not in states:
        hint = f"Networks are {', '.join(_CHANNELS)} (.pt each), or all in {_UNITED[0]}."
        raise CheckpointInvalid("is missing", where=str(place / f"{name}.pt"), hint=hint)
    path, state = states[name]
    known = sizes.width + _DIRECTION + sizes.level
    known += sizes.appearance if name == "color_mlp" else 0
    option = f"add_{name.removesuffix('_mlp')}_dist"
    if option in cfg.values:
        distance = cfg.flag(option)
    else:  # older code writes no flag, so the width has to say it
        weight = state.get("0.weight")
        distance = isinstance(weight, Tensor) and weight.shape[-1] == known + 1
    return _mlp(
        path, state, known + distance, sizes, _CHANNELS[name] * sizes.per_anchor, distance
    )


def _has_bank(states: States, place: Path, cfg: CfgArgs) -> bool:
    wanted = cfg.flag("use_feat_bank", default="bank" in states)
    if wanted and "bank" not in states:
        what = "is missing: use_feat_bank is True"
        raise CheckpointInvalid(what, where=str(place / "feature_bank_mlp.pt"))
    return wanted


def _bank(states: States, place: Path, sizes: _Sizes) -> Mlp:
    """Scaffold-GS asks by direction and distance, Octree-GS by direction and (level)."""
    path, state = states["bank"]
    if sizes.width % 4:
        what = f"a feature bank needs features of 4 n numbers, not {sizes.width}"
        raise CheckpointInvalid(what, where=str(place))
    extra = int(sizes.level) if sizes.octree else 1
    return _mlp(path, state, _DIRECTION + extra, sizes, 3, not sizes.octree)


def _mlp(
    path: Path, state: Mapping[str, Any], wide: int, sizes: _Sizes, out: int, distance: bool
) -> Mlp:
    f = sizes.width
    wanted: dict[str, Shape] = {
        "0.weight": (f, wide),
        "0.bias": (f,),
        "2.weight": (out, f),
        "2.bias": (out,),
    }
    read = require_tensors(path, state, wanted)
    hidden, hidden_bias, last, last_bias = (read[name] for name in wanted)
    return Mlp(hidden, hidden_bias, last, last_bias, distance)


def describe_anchors(read: AnchorCheckpoint) -> str:
    """Say in one line what a checkpoint holds."""
    cloud, nets = read.cloud, read.nets
    heads = {"opacity": nets.opacity, "covariance": nets.covariance, "colour": nets.color}
    by_distance = [name for name, head in heads.items() if head.distance]
    parts = [
        f"iteration {read.iteration}",
        f"{len(cloud):,} anchors × {cloud.per_anchor} Gaussians",
        f"features of {cloud.width}",
    ]
    if cloud.level is not None:
        parts.append(f"levels {int(cloud.level.min())} to {int(cloud.level.max())}")
    parts += ["feature bank"] if nets.bank is not None else []
    parts += [f"distance into {', '.join(by_distance)}"] if by_distance else []
    parts += ["level into all networks"] if nets.level else []
    if nets.embedding is not None:
        parts.append(f"{len(nets.embedding)} appearances of {nets.embedding.shape[1]}")
    return f"{read.folder}: {', '.join(parts)}"


def require_appearance(
    read: AnchorCheckpoint, appearance: int | None, option: str
) -> int | None:
    """Return ``appearance`` if the checkpoint has it.

    Raises:
        NotInCheckpoint: It has none, or not so many; ``option`` is what the user gave.
    """
    embedding = read.nets.embedding
    if appearance is None:
        return None
    if embedding is None:
        what = "the checkpoint has no appearance embedding"
        raise NotInCheckpoint(what, where=option, hint="Leave the option out.")
    if appearance >= len(embedding):
        what = f"{appearance} is not one of the {len(embedding)} training cameras"
        hint = f"Give 0 to {len(embedding) - 1}."
        raise NotInCheckpoint(what, where=option, hint=hint)
    return appearance
