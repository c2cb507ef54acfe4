"""Reads checkpoints of SC-GS: a 3DGS PLY with features, control nodes and their network.

``deform/iteration_N/deform.pth`` is the state dict of ``ControlNodeWarp`` (yihua7/SC-GS,
``utils/time_utils.py``). Sizes follow from its tensors; ``cfg_args`` tells how they are used.
"""

__all__ = ["ControlNodes", "NodeOptions", "ScGsCheckpoint", "read_sc_gs"]

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import FormatWarning, ply_properties, read_ply_columns
from gsgen.reference_plugins.deformation.deformation_checkpoint import Deformation, read_layers
from gsgen.reference_plugins.loading.canonical import Canonical, read_canonical
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.states import (
    Layer,
    Shape,
    entries_below,
    layer_of,
    linear_shapes,
    load_state,
    require_tensors,
)
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run

_FEATURE_PATTERN = re.compile(r"fea_(\d+)")
_NETWORK_PREFIX = "network."
_COLOR_LAYERS = ("gaussian_color.0", "gaussian_color.2", "gaussian_color.4")
# Option → head of the network that it adds, by its first weight.
_CHANNELS_BY_HEAD = {
    "local_frame": "local_rotation.weight",
    "pred_opacity": "gaussian_opacity.weight",
    "pred_color": "gaussian_color.0.weight",
}
# Options with which the published code computes something else, and their only value here.
_REQUIRED_SETTINGS: dict[str, object] = {
    "use_hash": False, "skinning": False, "is_scene_static": False,
    "progressive_brand_time": False, "deform_type": "node",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeOptions:
    """The training options of SC-GS that inference needs."""

    neighbours: int  # number of nodes that move a Gaussian
    adds_identity: bool  # whether the identity is added to quaternions, too
    max_scale: float  # the largest factor of a scale; no limit if 0 or less

    @classmethod
    def of(cls, cfg: CfgArgs) -> "NodeOptions":
        """Read the SC-GS options from ``cfg_args``; raise for variants that cannot be exported."""
        for name, expected in _REQUIRED_SETTINGS.items():
            if cfg.values.get(name, expected) != expected:
                message = f"{name} is {cfg.values[name]!r}, expected {expected!r}"
                hint = "Other variants of SC-GS cannot be exported."
                raise CheckpointInvalid(message, where=str(cfg.path), hint=hint)
        is_residual = cfg.flag("d_rot_as_res", default=True) and not cfg.flag("d_rot_as_rotmat")
        return cls(
            neighbours=cfg.integer("K", 3),
            adds_identity=not is_residual,
            max_scale=cfg.number("max_d_scale", -1.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlNodes:
    """The M control nodes of SC-GS, and the network that moves the nodes over time."""

    position: Float[Tensor, "m 3"]
    hyper_features: Float[Tensor, "m h"]  # further coordinates, in which neighbours are found, too
    log_radius: Float[Tensor, " m"]  # logarithm of the radius of influence
    logit_weight: Float[Tensor, " m"]  # weight before the sigmoid
    net: Deformation
    local_rotation: Layer | None  # rotation around the node
    opacity: Layer | None  # change of the opacity
    color: tuple[Layer, Layer, Layer] | None  # change of the constant SH coefficient


@dataclass(frozen=True, slots=True, kw_only=True)
class ScGsCheckpoint:
    """The Gaussians, control nodes and options of an SC-GS checkpoint."""

    run: TrainingRun
    canonical: Canonical
    hyper_features: Float[Tensor, "n h"]  # hyper coordinates of the Gaussians
    logit_mask: Float[Tensor, "n 1"] | None  # share of the motion, before the sigmoid
    nodes: ControlNodes
    options: NodeOptions

    def describe(self) -> str:
        """Describe an SC-GS checkpoint in one line: Gaussians, control nodes and active heads."""
        nodes = self.nodes
        heads = {
            "local frames": nodes.local_rotation,
            "opacity": nodes.opacity,
            "colour": nodes.color,
            "motion mask": self.logit_mask,
        }
        parts = [name for name, part in heads.items() if part is not None]
        return ", ".join(
            [
                f"{self.run}, {self.canonical.describe()}",
                f"{len(nodes.position)} nodes in {3 + nodes.hyper_features.shape[1]} dimensions",
                f"{self.options.neighbours} for each Gaussian",
                *parts,
            ]
        )


def read_sc_gs(folder: Path, iteration: int | None = None) -> ScGsCheckpoint:
    """Read a checkpoint of SC-GS."""
    run = open_run("sc-gs", folder, iteration, needs_cfg=True)
    options = NodeOptions.of(run.cfg)
    path = run.folder / "deform" / f"iteration_{run.iteration}" / "deform.pth"
    nodes = _read_nodes(path, load_state(path, "the control nodes"), run.cfg)
    if not 1 <= options.neighbours <= len(nodes.position):
        message = f"K is {options.neighbours}, but there are {len(nodes.position)} nodes"
        raise CheckpointInvalid(message, where=str(run.cfg.path))
    cloud = run.files / "point_cloud.ply"
    with warnings.catch_warnings():
        # The features, which splat files do not have.
        warnings.filterwarnings("ignore", ".* properties fea_", FormatWarning)
        canonical = read_canonical(cloud)
    size, is_masked = nodes.hyper_features.shape[1], run.cfg.flag("gs_with_motion_mask")
    features = _read_features(cloud, size + is_masked)
    mask = features[:, size:] if is_masked else None
    return ScGsCheckpoint(
        run=run,
        canonical=canonical,
        hyper_features=features[:, :size],
        logit_mask=mask,
        nodes=nodes,
        options=options,
    )


def _read_features(path: Path, count: int) -> Float[Tensor, "n f"]:
    with format_faults(path):
        stored_names = [name for name in ply_properties(path) if _FEATURE_PATTERN.fullmatch(name)]
        if len(stored_names) != count:
            message = f"has {len(stored_names)} properties fea_N, expected {count}"
            hint = "hyper coordinates of the nodes, and one more with gs_with_motion_mask"
            raise CheckpointInvalid(message, where=str(path), hint=f"They are the {hint}.")
        names = [f"fea_{index}" for index in range(count)]
        if not names:
            return torch.zeros((1, 0))
        return torch.from_numpy(read_ply_columns(path, {"features": names})["features"])


def _read_nodes(path: Path, state: Mapping[str, Any], cfg: CfgArgs) -> ControlNodes:
    nodes = state.get("nodes")
    shape = tuple(nodes.shape) if isinstance(nodes, Tensor) else ()
    if len(shape) != 2 or shape[0] < 1 or shape[1] < 3:
        message = f"nodes is {list(shape)}, expected [nodes, 3 or more coordinates]"
        hint = "" if "nodes" in state else "Only checkpoints with control nodes can be exported."
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    count, size = shape
    expected: dict[str, Shape] = {
        "nodes": (count, size), "_node_radius": (count,), "_node_weight": (count, 1),
    }  # fmt: skip
    control_nodes = require_tensors(
        path, state, expected, ignored=(_NETWORK_PREFIX, "gs_", "inited")
    )
    network = entries_below(state, _NETWORK_PREFIX)
    heads = {option for option, weight in _CHANNELS_BY_HEAD.items() if weight in network}
    for option in _CHANNELS_BY_HEAD:
        if cfg.flag(option, default=option in heads) != (option in heads):
            message = f"{option} is {option not in heads}, but the network in {path} differs"
            raise CheckpointInvalid(message, where=str(cfg.path))
    net, tensors = read_layers(
        path, network, {"gaussian_warp": 3}, lambda *sizes: _head_shapes(heads, *sizes)
    )
    first_columns, second_columns, third_columns = (
        layer_of(tensors, name) if "pred_color" in heads else None for name in _COLOR_LAYERS
    )
    return ControlNodes(
        position=control_nodes["nodes"][:, :3],
        hyper_features=control_nodes["nodes"][:, 3:],
        log_radius=control_nodes["_node_radius"],
        logit_weight=control_nodes["_node_weight"][:, 0],
        net=net,
        local_rotation=layer_of(tensors, "local_rotation") if "local_frame" in heads else None,
        opacity=layer_of(tensors, "gaussian_opacity") if "pred_opacity" in heads else None,
        color=(first_columns, second_columns, third_columns)
        if first_columns and second_columns and third_columns
        else None,
    )


def _head_shapes(heads: set[str], embedded_size: int, width: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {}
    if "local_frame" in heads:
        shapes |= linear_shapes("local_rotation", width, 4)
    if "pred_opacity" in heads:
        shapes |= linear_shapes("gaussian_opacity", width, 1)
    if "pred_color" in heads:
        sizes = (embedded_size + width, None, None, 3)
        for index, name in enumerate(_COLOR_LAYERS):
            shapes |= linear_shapes(name, sizes[index], sizes[index + 1])
    return shapes
