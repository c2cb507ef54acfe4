"""Reads checkpoints of Duplex-GS, which resemble Octree-GS but have ellipsoidal cells as anchors.

The PLY (``scene/gaussian_model.py``: ``save_ply``) has a size and a rotation for each anchor in
place of scales, and spherical harmonics of the cell's visibility from a direction. The column
``info`` holds numbers of the scene in its first rows.
"""

__all__ = ["CellCheckpoint", "CellWeighting", "describe_cells", "read_cells"]

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.formats import ply_properties, read_ply_columns
from gsgen.reference_plugins.anchors.anchor_checkpoint import (
    AnchorCheckpoint,
    AnchorCloud,
    describe_anchors,
    numbered,
    read_nets,
    require_sizes,
)
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.training_run import open_run

_COLUMN_SHAPES = {
    "position": ("x", "y", "z"),
    "level": ("level",),
    "extra_level": ("extra_level",),
    "info": ("info",),
    "size": tuple(f"anchor_size_{i}" for i in range(3)),
    "rotation": tuple(f"anchor_rot_{i}" for i in range(4)),
    "constant": ("anchor_shd_0",),
}
_NUMBERED_COLUMNS = {
    "offset": re.compile(r"f_offset_(\d+)"),
    "feature": re.compile(r"f_anchor_feat_(\d+)"),
    "rest": re.compile(r"anchor_shv_(\d+)"),
}
# Voxel size, distance of level 0, sigma, background weight, transmittance grade.
_INFO_FIELDS = 5
_MIN_BACKGROUND = 0.1


@dataclass(frozen=True, slots=True)
class CellWeighting:
    """The parameters of Duplex-GS' weighted blending."""

    sigma: float  # the depth at which a weight falls to 0
    background: float  # weight of the background: ReLU of the stored number, plus 0.1
    opacity_divisor: float  # divisor of opacities in the transmittance
    depth: bool  # whether weights fall with depth


@dataclass(frozen=True, slots=True)
class CellCheckpoint:
    """The contents of a Duplex-GS checkpoint."""

    anchors: AnchorCheckpoint  # the cells as anchors, with the cell's size as both scales
    # SH coefficients of each cell's visibility before the sigmoid, [N, K]
    visibility: Float[Tensor, "n k"]
    weighting: CellWeighting  # weights of the method's renderer


def read_cells(folder: Path, iteration: int | None = None) -> CellCheckpoint:
    """Read a checkpoint of Duplex-GS."""
    run = open_run("duplex-gs", folder, iteration, needs_cfg=True)
    cfg = run.cfg
    ply = required_file(run.files / "point_cloud.ply", "the cells")
    columns = _columns(ply)
    cloud = _cloud(columns)
    require_sizes(cfg, cloud, ply)
    visibility = torch.cat([columns["constant"], columns["rest"]], dim=1)
    expected = (cfg.integer("max_sh_degree", _visibility_degree(visibility, ply)) + 1) ** 2
    if expected != visibility.shape[1]:
        message = (
            f"max_sh_degree is {cfg.values['max_sh_degree']}, which needs {expected - 1} "
            f"properties anchor_shv, but {ply.name} has {visibility.shape[1] - 1}"
        )
        raise CheckpointInvalid(message, where=str(cfg.path))
    anchors = AnchorCheckpoint(run, cloud, read_nets(run, cloud, octree=True))
    return CellCheckpoint(
        anchors, visibility, _cell_weighting(columns["info"].reshape(-1), cfg, ply)
    )


def _columns(path: Path) -> dict[str, Tensor]:
    with format_faults(path):
        names = ply_properties(path)
        groups = {name: numbered(pattern, names) for name, pattern in _NUMBERED_COLUMNS.items()}
        if not groups["offset"] or len(groups["offset"]) % 3 or not groups["feature"]:
            message = f"{len(groups['offset'])} properties f_offset and {len(groups['feature'])} "
            message += "f_anchor_feat, expected 3 K and F"
            raise CheckpointInvalid(message, where=str(path))
        harmonics = groups["rest"]
        groups = {name: group for name, group in groups.items() if group}
        tables = read_ply_columns(path, _COLUMN_SHAPES | groups)
    columns = {name: torch.from_numpy(table) for name, table in tables.items()}
    return columns if harmonics else columns | {"rest": columns["constant"][:, :0]}


def _cloud(columns: Mapping[str, Tensor]) -> AnchorCloud:
    axes = columns["offset"].reshape(len(columns["offset"]), 3, -1)  # stored axis by axis
    return AnchorCloud(
        position=columns["position"],
        offset=axes.transpose(1, 2).contiguous().clamp(-1.0, 1.0),
        feature=columns["feature"],
        log_scale=torch.cat([columns["size"], columns["size"]], dim=1),
        rotation=columns["rotation"],
        **{name: columns[name].reshape(-1) for name in ("level", "extra_level", "info")},
    )


def _visibility_degree(visibility: Tensor, path: Path) -> int:
    degree_by_count = {(degree + 1) ** 2: degree for degree in range(MAX_DEGREE + 1)}
    if visibility.shape[1] not in degree_by_count:
        message = f"{visibility.shape[1] - 1} properties anchor_shv, expected 0, 3, 8 or 15"
        raise CheckpointInvalid(message, where=str(path))
    return degree_by_count[visibility.shape[1]]


def _cell_weighting(info: Tensor, cfg: CfgArgs, path: Path) -> CellWeighting:
    if len(info) < _INFO_FIELDS:
        message = f"has {len(info)} cells, expected at least {_INFO_FIELDS} for the numbers of info"
        raise CheckpointInvalid(message, where=str(path))
    sigma, background, opacity_divisor = (
        _shortest_decimal(float(value)) for value in info[2:_INFO_FIELDS]
    )
    if not (
        sigma > 0
        and opacity_divisor > 0
        and all(map(math.isfinite, (sigma, background, opacity_divisor)))
    ):
        message = (
            f"info is {info[:_INFO_FIELDS].tolist()}, expected finite numbers, "
            "and sigma and ET_grade above 0"
        )
        raise CheckpointInvalid(message, where=str(path))
    weight = _shortest_decimal(max(background, 0.0) + _MIN_BACKGROUND)
    return CellWeighting(sigma, weight, opacity_divisor, cfg.flag("depth_correct"))


def _shortest_decimal(value: float) -> float:
    """Return the shortest decimal that rounds to a float32 number: 0.15, not 0.15000000596."""
    return float(str(np.float32(value)))


def describe_cells(checkpoint: CellCheckpoint) -> str:
    """Return the sizes and weights of a Duplex-GS checkpoint as one line."""
    weighting = checkpoint.weighting
    depth = f", which falls to 0 at depth {weighting.sigma:.4g}" if weighting.depth else ""
    text = describe_anchors(checkpoint.anchors).replace(" anchors × ", " cells × ")
    degree = round(checkpoint.visibility.shape[1] ** 0.5) - 1
    return (
        f"{text}, visibility of degree {degree}; weighted sum{depth}, background "
        f"{weighting.background:.4g}, ET {weighting.opacity_divisor:.4g}"
    )
