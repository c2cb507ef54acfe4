"""Reads checkpoints of anchor methods: a PLY of anchors, and the networks that decode them.

The layout is that of Scaffold-GS (``scene/gaussian_model.py``: ``save_ply``,
``save_mlp_checkpoints``) and of Octree-GS, which adds levels. Networks are either one TorchScript
file each, or state dicts in one file: ``checkpoints.pth`` of the mode ``unite``, and
``checkpoint.pth`` of the first versions of Scaffold-GS.
"""

__all__ = [
    "AnchorCheckpoint", "AnchorCloud", "AnchorNets", "Mlp", "NetworkStates", "describe_anchors",
    "numbered", "read_anchors", "read_cloud", "read_nets", "require_appearance", "require_sizes",
]  # fmt: skip

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import ply_properties, read_ply_columns
from gsgen.formats.ply.layout import XYZ
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint, format_faults
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.states import (
    layer_of,
    linear_shapes,
    load_network,
    load_state,
    require_tensors,
)
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run

_OFFSET_PATTERN = re.compile(r"f_offset_(\d+)")
_FEATURE_PATTERN = re.compile(r"f_anchor_feat_(\d+)")
_SCALE_COLUMNS = tuple(f"scale_{i}" for i in range(6))
_ROTATION_COLUMNS = tuple(f"rot_{i}" for i in range(4))
_LEVEL_FIELDS = ("level", "extra_level", "info")
# Both names of a file with all networks; the first versions of Scaffold-GS wrote the second.
_COMBINED_FILES = ("checkpoints.pth", "checkpoint.pth")
_NAME_REPLACEMENTS = {
    "appearance": "embedding",
    "feature_bank_mlp": "bank",
    "mlp_feature_bank": "bank",
}
_UNUSED_NETWORKS = ("vi_mlp",)  # Duplex-GS saves this network, but does not evaluate it
_DIRECTION_SIZE = 3
_OUTPUT_CHANNELS = {"opacity_mlp": 1, "cov_mlp": 7, "color_mlp": 3}


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorCloud:
    """A point cloud of N anchors, each of which decodes to K Gaussians."""

    position: Float[Tensor, "n 3"]  # centres of the anchors
    # offset of each Gaussian, in units of the anchor's first three scales
    offset: Float[Tensor, "n k 3"]
    feature: Float[Tensor, "n f"]  # feature vectors, which the networks decode
    # logarithms of the scale of offsets (3) and of the Gaussians' scale (3)
    log_scale: Float[Tensor, "n 6"]
    rotation: Float[Tensor, "n 4"]  # quaternions (w, x, y, z); only the prefilter uses them
    level: Float[Tensor, " n"] | None = None  # octree level, from 0; absent in Scaffold-GS
    # a learnt shift of the level that belongs to a distance
    extra_level: Float[Tensor, " n"] | None = None
    # numbers of the scene in the first rows of a column: voxel size, distance, …
    info: Float[Tensor, " n"] | None = None

    def __len__(self) -> int:
        return self.position.shape[0]

    @property
    def per_anchor(self) -> int:
        """The number K of Gaussians that an anchor decodes to."""
        return self.offset.shape[1]

    @property
    def width(self) -> int:
        """The length F of an anchor's feature vector."""
        return self.feature.shape[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mlp:
    """The weights of a network of two layers with ReLU between them, as (out, in) matrices."""

    hidden: Float[Tensor, "f i"]  # weight of the first layer, [F, in]
    hidden_bias: Float[Tensor, " f"]  # bias of the first layer
    out: Float[Tensor, "o f"]  # weight of the second layer, [out, F]
    out_bias: Float[Tensor, " o"]  # bias of the second layer
    distance: bool = False  # whether the distance is one of the inputs


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorNets:
    """The decoding networks of a checkpoint of Scaffold-GS, Octree-GS or Duplex-GS."""

    opacity: Mlp  # [feature, direction, (distance), (level)] → K
    covariance: Mlp  # same inputs → 7 K
    color: Mlp  # same inputs and an appearance → 3 K
    feature_bank: Mlp | None = (
        None  # [direction, …] → 3 weights of the feature bank, if there is one
    )
    # appearance of each training camera, [cameras, D]
    embedding: Float[Tensor, "cameras d"] | None = None
    level: bool = False  # whether the level is one of the inputs


@dataclass(frozen=True, slots=True)
class AnchorCheckpoint:
    """The anchors, networks and training options of a checkpoint, such as one of Scaffold-GS."""

    run: TrainingRun
    cloud: AnchorCloud
    nets: AnchorNets  # the networks


def read_anchors(
    folder: Path, iteration: int | None = None, *, octree: bool = False
) -> AnchorCheckpoint:
    """Read a checkpoint of Scaffold-GS or Octree-GS.

    With ``octree``, anchors have levels.
    """
    method = "octree-gs" if octree else "scaffold-gs"
    run = open_run(method, folder, iteration, needs_cfg=octree)
    ply = required_file(run.files / "point_cloud.ply", "the anchors")
    cloud = read_cloud(ply, columns=_LEVEL_FIELDS if octree else ())
    require_sizes(run.cfg, cloud, ply)
    return AnchorCheckpoint(run, cloud, read_nets(run, cloud, octree=octree))


def require_sizes(cfg: CfgArgs, cloud: AnchorCloud, ply: Path) -> None:
    """Raise if sizes of the anchors differ from those in the training options."""
    for option, actual in (("n_offsets", cloud.per_anchor), ("feat_dim", cloud.width)):
        if cfg.integer(option, actual) != actual:
            message = f"{option} is {cfg.values[option]}, but {ply.name} has {actual}"
            raise CheckpointInvalid(message, where=str(cfg.path))


def read_cloud(
    path: Path, *, columns: tuple[str, ...] = (), has_features: bool = True
) -> AnchorCloud:
    """Read the anchors of a PLY file, and named columns about their levels of detail.

    Without ``has_features``, anchors have features of length 0.
    """
    with format_faults(path):
        names = ply_properties(path)
        offsets, features = numbered(_OFFSET_PATTERN, names), numbered(_FEATURE_PATTERN, names)
        groups = {"position": XYZ, "scale": _SCALE_COLUMNS, "rotation": _ROTATION_COLUMNS}
        groups |= {"offset": offsets} | ({"feature": features} if features else {})
        groups |= {name: (name,) for name in columns}
        if not offsets or len(offsets) % 3 or has_features != bool(features):
            message = f"has {len(offsets)} properties f_offset and {len(features)} f_anchor_feat"
            hint = "Expected 3 K and F of them: is this a checkpoint of another method?"
            raise CheckpointInvalid(message, where=str(path), hint=hint)
        tables = read_ply_columns(path, groups)
    read = {name: torch.from_numpy(table) for name, table in tables.items()}
    axes = read["offset"].reshape(len(read["offset"]), 3, -1)  # stored axis by axis
    return AnchorCloud(
        position=read["position"],
        offset=axes.transpose(1, 2).contiguous(),
        feature=read.get("feature", torch.zeros(len(axes), 0)),
        log_scale=read["scale"],
        rotation=read["rotation"],
        **{name: read[name].reshape(-1) for name in columns},
    )


def numbered(pattern: re.Pattern[str], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the PLY column names with a prefix, sorted by number: 2 before 10."""
    matches = [(int(match[1]), name) for name in names if (match := pattern.fullmatch(name))]
    return tuple(name for _, name in sorted(matches))


@dataclass(frozen=True, slots=True, kw_only=True)
class _NetworkSizes:
    per_anchor: int
    width: int
    appearance: int
    level: bool
    octree: bool
    direction: int


def read_nets(
    run: TrainingRun, cloud: AnchorCloud, *, octree: bool, direction: int = _DIRECTION_SIZE
) -> AnchorNets:
    """Read the networks from a checkpoint of an anchor-based method, such as Scaffold-GS.

    ``cloud`` determines the shapes of the networks; with ``octree``, the level may be an input.
    With ``direction`` 0, the networks do not depend on the direction of the camera.
    """
    iteration_folder, cfg = run.files, run.cfg
    states = _read_states(iteration_folder)
    path, state = states.get("embedding", (iteration_folder, {}))
    embedding = _embedding(path, state, cfg) if state else None
    appearance = cfg.integer("appearance_dim", 0) if cfg.file_exists else 0
    if embedding is not None:
        appearance = embedding.shape[1]
    elif appearance > 0:
        message = f"is missing: appearance_dim is {appearance}"
        raise CheckpointInvalid(message, where=str(iteration_folder / "embedding_appearance.pt"))
    level = octree and cfg.flag("add_level")
    sizes = _NetworkSizes(
        per_anchor=cloud.per_anchor,
        width=cloud.width,
        appearance=appearance,
        level=level,
        octree=octree,
        direction=direction,
    )
    heads = {
        name: _read_head(name, states, iteration_folder, cfg, sizes) for name in _OUTPUT_CHANNELS
    }
    feature_bank = (
        _read_feature_bank(states, iteration_folder, sizes)
        if _has_feature_bank(states, iteration_folder, cfg)
        else None
    )
    return AnchorNets(
        opacity=heads["opacity_mlp"],
        covariance=heads["cov_mlp"],
        color=heads["color_mlp"],
        feature_bank=feature_bank,
        embedding=embedding,
        level=level,
    )


NetworkStates = Mapping[str, tuple[Path, Mapping[str, Any]]]
"""Network → its file and state dict."""


def _read_states(iteration_folder: Path) -> NetworkStates:
    """Read the state dict of each network of an anchor-based method, from one file or several."""
    for combined_file in (
        iteration_folder / name for name in _COMBINED_FILES if (iteration_folder / name).is_file()
    ):
        states = load_state(combined_file, "the networks")
        input_size = {*_OUTPUT_CHANNELS, *_NAME_REPLACEMENTS, *_UNUSED_NETWORKS}
        if unknown := sorted(str(key) for key in states if states[key] and key not in input_size):
            message = (
                f"unexpected: {', '.join(unknown)}; expected only {', '.join(sorted(input_size))}"
            )
            raise CheckpointInvalid(message, where=str(combined_file))
        return {
            _NAME_REPLACEMENTS.get(key, key): (combined_file, states[key])
            for key in states
            if states[key]
        }
    files = {name: f"{name}.pt" for name in _OUTPUT_CHANNELS}
    files |= {"bank": "feature_bank_mlp.pt", "embedding": "embedding_appearance.pt"}
    paths = {name: iteration_folder / file for name, file in files.items()}
    return {name: (path, load_network(path)) for name, path in paths.items() if path.is_file()}


def _embedding(path: Path, state: Mapping[str, Any], cfg: CfgArgs) -> Tensor:
    length = cfg.integer("appearance_dim", 0) if "appearance_dim" in cfg.values else None
    return require_tensors(path, state, {"embedding.weight": (None, length)})["embedding.weight"]


def _read_head(
    name: str, states: NetworkStates, iteration_folder: Path, cfg: CfgArgs, sizes: _NetworkSizes
) -> Mlp:
    if name not in states:
        hint = f"Networks are {', '.join(_OUTPUT_CHANNELS)} (.pt each), or all in {_COMBINED_FILES[0]}."
        raise CheckpointInvalid("is missing", where=str(iteration_folder / f"{name}.pt"), hint=hint)
    path, state = states[name]
    input_size = sizes.width + sizes.direction + sizes.level
    input_size += sizes.appearance if name == "color_mlp" else 0
    option = f"add_{name.removesuffix('_mlp')}_dist"
    if option in cfg.values:
        distance = cfg.flag(option)
    else:  # older code writes no flag; the number of inputs tells
        weight = state.get("0.weight")
        distance = isinstance(weight, Tensor) and weight.shape[-1] == input_size + 1
    return _read_mlp(
        path,
        state,
        input_size + distance,
        sizes,
        _OUTPUT_CHANNELS[name] * sizes.per_anchor,
        distance=distance,
    )


def _has_feature_bank(states: NetworkStates, iteration_folder: Path, cfg: CfgArgs) -> bool:
    has_bank = cfg.flag("use_feat_bank", default="bank" in states)
    if has_bank and "bank" not in states:
        message = "is missing: use_feat_bank is True"
        raise CheckpointInvalid(message, where=str(iteration_folder / "feature_bank_mlp.pt"))
    return has_bank


def _read_feature_bank(states: NetworkStates, iteration_folder: Path, sizes: _NetworkSizes) -> Mlp:
    """Read the feature bank: a network that weights three resolutions of an anchor's features.

    Inputs are direction and distance; of Octree-GS, direction and, if trained with it, level.
    """
    path, state = states["bank"]
    if not sizes.direction:
        message = "use_feat_bank is True, but the networks have no direction as input"
        raise CheckpointInvalid(message, where=str(iteration_folder))
    if sizes.width % 4:
        message = f"feat_dim is {sizes.width}, expected a multiple of 4 for a feature bank"
        raise CheckpointInvalid(message, where=str(iteration_folder))
    level_count = int(sizes.level) if sizes.octree else 1
    return _read_mlp(
        path, state, _DIRECTION_SIZE + level_count, sizes, 3, distance=not sizes.octree
    )


def _read_mlp(
    path: Path,
    state: Mapping[str, Any],
    inputs: int,
    sizes: _NetworkSizes,
    out: int,
    *,
    distance: bool,
) -> Mlp:
    expected = linear_shapes("0", inputs, sizes.width) | linear_shapes("2", sizes.width, out)
    read = require_tensors(path, state, expected)
    (hidden, hidden_bias), (out_weight, out_bias) = layer_of(read, "0"), layer_of(read, "2")
    if not sizes.direction:  # generators feed it, with weights of zero
        ignored = hidden.new_zeros(len(hidden), _DIRECTION_SIZE)
        hidden = torch.cat([hidden[:, : sizes.width], ignored, hidden[:, sizes.width :]], dim=1)
    return Mlp(
        hidden=hidden, hidden_bias=hidden_bias, out=out_weight, out_bias=out_bias, distance=distance
    )


def describe_anchors(checkpoint: AnchorCheckpoint) -> str:
    """Describe a checkpoint of an anchor-based method in one line: sizes and networks."""
    cloud, nets = checkpoint.cloud, checkpoint.nets
    heads = {"opacity": nets.opacity, "covariance": nets.covariance, "colour": nets.color}
    distance_dependent_heads = [name for name, head in heads.items() if head.distance]
    parts = [f"{len(cloud):,} anchors × {cloud.per_anchor} Gaussians", f"features of {cloud.width}"]
    if cloud.level is not None:
        parts.append(f"levels {int(cloud.level.min())} to {int(cloud.level.max())}")
    parts += ["feature bank"] if nets.feature_bank is not None else []
    parts += (
        [f"distance into {', '.join(distance_dependent_heads)}"] if distance_dependent_heads else []
    )
    parts += ["level into all networks"] if nets.level else []
    if nets.embedding is not None:
        parts.append(f"{len(nets.embedding)} appearances of {nets.embedding.shape[1]}")
    return f"{checkpoint.run}, {', '.join(parts)}"


def require_appearance(
    checkpoint: AnchorCheckpoint, appearance: int | None, option: str
) -> int | None:
    """Return the index of the camera whose appearance to use; raise if the checkpoint has none."""
    embedding = checkpoint.nets.embedding
    if appearance is None:
        return None
    if embedding is None:
        message = "the checkpoint has no appearance embedding"
        raise NotInCheckpoint(message, where=option, hint="Leave out the option.")
    if appearance >= len(embedding):
        message = f"{appearance} is not one of the {len(embedding)} training cameras"
        hint = f"Give 0 to {len(embedding) - 1}."
        raise NotInCheckpoint(message, where=option, hint=hint)
    return appearance
