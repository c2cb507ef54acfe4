"""Reads checkpoints of Octree-AnyGS, which trains Scaffold-GS, 3DGS or 2DGS with levels of detail.

The layout is that of city-super/Octree-AnyGS, commit 4ffd0e2 (``scene/gs_model_*``: ``save_ply``,
``save_mlp_checkpoints``): ``cfg_args`` holds the model's options as ``model_config``; the PLY has
the distance of level 0 and the number of levels as ``obj_info``, and no voxel size. Explicit
Gaussians (3DGS, 2DGS) have SH colours and opacities in place of features and networks.
"""

__all__ = ["AnyGSCheckpoint", "ExplicitColors", "describe_anygs", "read_anygs"]

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import read_ply_columns
from gsgen.formats.ply.layout import splat_degree, splat_groups
from gsgen.formats.ply.table import ply_infos, ply_properties
from gsgen.reference_plugins.anchors.anchor_checkpoint import (
    AnchorCheckpoint,
    AnchorCloud,
    describe_anchors,
    read_cloud,
    read_nets,
    require_sizes,
)
from gsgen.reference_plugins.anchors.octree_gs import LEVEL_ROUNDING, Levels
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run

_NEURAL_BASE = "scaffoldgs"
_BASE_MODELS = (_NEURAL_BASE, "3dgs", "2dgs")
_CLASS_HAS_LEVELS = {"GaussianModel": False, "GaussianLoDModel": True}
_COLOR_COLUMNS = ("logit_opacity", "sh")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplicitColors:
    """Opacities and SH colours stored for each Gaussian, not decoded by networks."""

    logit_opacity: Float[Tensor, "n 1"]
    sh: Float[Tensor, "n k 3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnyGSCheckpoint:
    """A checkpoint of Octree-AnyGS: anchors with networks, or Gaussians with explicit colours."""

    run: TrainingRun  # its options are those of the model
    base: str  # scaffoldgs, 3dgs or 2dgs
    cloud: AnchorCloud  # explicit Gaussians have features of length 0
    anchors: AnchorCheckpoint | None = None  # with networks
    colors: ExplicitColors | None = None  # of explicit Gaussians
    levels: Levels | None = None  # absent if the model has no levels of detail


def read_anygs(folder: Path, iteration: int | None = None) -> AnyGSCheckpoint:
    """Read a checkpoint of Octree-AnyGS: the folder that training wrote."""
    run = open_run("octree-anygs", folder, iteration, needs_cfg=True)
    run = replace(run, cfg=_model_options(run.cfg))
    base = run.cfg.word("base_model", "", _BASE_MODELS)
    has_levels = _CLASS_HAS_LEVELS[run.cfg.word("name", "", _CLASS_HAS_LEVELS)]
    ply = required_file(run.files / "point_cloud.ply", "the anchors")
    names = ("level", "extra_level") if has_levels else ()
    cloud = read_cloud(ply, columns=names, has_features=base == _NEURAL_BASE)
    require_sizes(run.cfg, cloud, ply)
    levels = _levels(run.cfg, ply) if has_levels else None
    if base == _NEURAL_BASE:
        view_dim = run.cfg.integer("view_dim", 3)
        if view_dim not in (0, 3):
            message = f"view_dim is {view_dim}, expected 0 or 3"
            raise CheckpointInvalid(message, where=str(run.cfg.path))
        nets = read_nets(run, cloud, octree=True, direction=view_dim)
        anchors = AnchorCheckpoint(run, cloud, nets)
        return AnyGSCheckpoint(run=run, base=base, cloud=cloud, anchors=anchors, levels=levels)
    if cloud.per_anchor != 1:
        message = f"has {cloud.per_anchor} offsets per anchor, expected 1 of explicit Gaussians"
        raise CheckpointInvalid(message, where=str(ply))
    return AnyGSCheckpoint(run=run, base=base, cloud=cloud, colors=_colors(ply), levels=levels)


def _model_options(cfg: CfgArgs) -> CfgArgs:
    """Merge the model's options, nested in ``model_config``, into the other training options."""
    config = cfg.values.get("model_config")
    if not isinstance(config, dict) or not isinstance(config.get("kwargs"), dict):
        message = "model_config is missing, or has no kwargs"
        hint = "Copy cfg_args from the folder that training wrote."
        raise CheckpointInvalid(message, where=str(cfg.path), hint=hint)
    if "gs_attr" in config["kwargs"]:
        message = "model_config has gs_attr: the layout of a later version, which is not supported"
        hint = "Expected that of commit 4ffd0e2, whose base_model is scaffoldgs, 3dgs or 2dgs."
        raise CheckpointInvalid(message, where=str(cfg.path), hint=hint)
    values: dict[str, Any] = cfg.values | config["kwargs"] | {"name": config.get("name")}
    return replace(cfg, values=values)


def _levels(cfg: CfgArgs, ply: Path) -> Levels:
    """Return the levels of detail: their number and reference distance are in the PLY header."""
    words = [line.split() for line in ply_infos(ply)]
    infos = {entry[0]: entry[1] for entry in words if len(entry) == 2}
    try:
        standard, count = float(infos["standard_dist"]), round(float(infos["levels"]))
    except (KeyError, ValueError, OverflowError) as error:
        message = "the header lacks `obj_info standard_dist NUMBER` or `obj_info levels NUMBER`"
        raise CheckpointInvalid(message, where=str(ply)) from error
    fork = cfg.number("fork", 2)
    if not (0 < standard < float("inf") and count >= 1 and fork > 1):
        message = f"standard_dist is {standard:g}, levels {count} and fork {fork:g}"
        hint = "Expected a distance above 0, at least one level, and a fork above 1."
        raise CheckpointInvalid(message, where=str(ply), hint=hint)
    mode = cfg.word("dist2level", "round", LEVEL_ROUNDING)
    # Distances reach to the anchor itself, so the size of a cell is not needed.
    return Levels(mode=mode, fork=fork, voxel=0.0, standard=standard, top=count - 1)


def _colors(ply: Path) -> ExplicitColors:
    with format_faults(ply):
        groups = splat_groups(splat_degree(ply_properties(ply)))
        tables = read_ply_columns(ply, {name: list(groups[name]) for name in _COLOR_COLUMNS})
    opacity, sh = (torch.from_numpy(tables[name]) for name in _COLOR_COLUMNS)
    return ExplicitColors(logit_opacity=opacity, sh=sh.reshape(len(sh), -1, 3))


def describe_anygs(checkpoint: AnyGSCheckpoint) -> str:
    """Return kind, sizes and levels of detail of an Octree-AnyGS checkpoint as one line."""
    levels = checkpoint.levels
    parts = [f"base model {checkpoint.base}"]
    if checkpoint.anchors is not None:
        parts.insert(0, describe_anchors(checkpoint.anchors))
    else:
        parts.insert(0, f"{checkpoint.run}, {len(checkpoint.cloud):,} explicit Gaussians")
    if levels is not None:
        parts.append(f"{levels.top + 1} levels, {levels.mode} to whole ones, fork {levels.fork:g}")
    return "; ".join(parts)
