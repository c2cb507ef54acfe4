"""Checkpoints of Duplex-GS: those of Octree-GS whose anchors are ellipsoidal cells.

The PLY (``scene/gaussian_model.py``: ``save_ply``) has a size and a rotation for each anchor in
place of scales, and spherical harmonics of how visible the cell is from a direction. The column
``info`` holds numbers of the whole scene in its first rows.
"""

__all__ = ["CellCheckpoint", "Weighting", "describe_cells", "read_cells"]

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import FormatError, ply_properties, read_ply_columns
from gsgen.reference_plugins.anchors.anchor_checkpoint import (
    AnchorCheckpoint,
    AnchorCloud,
    describe_anchors,
    numbered,
    read_nets,
    require_sizes,
)
from gsgen.reference_plugins.loading.cfg_args import CfgArgs, read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import find_iteration, required_file, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method

_MAX_DEGREE = 3
_COLUMNS = {
    "position": ("x", "y", "z"),
    "level": ("level",),
    "extra_level": ("extra_level",),
    "info": ("info",),
    "size": tuple(f"anchor_size_{i}" for i in range(3)),
    "rotation": tuple(f"anchor_rot_{i}" for i in range(4)),
    "constant": ("anchor_shd_0",),
}
_NUMBERED = {
    "offset": re.compile(r"f_offset_(\d+)"),
    "feature": re.compile(r"f_anchor_feat_(\d+)"),
    "rest": re.compile(r"anchor_shv_(\d+)"),
}
# Voxel size, distance of level 0, sigma, background weight, transmittance grade.
_INFO = 5
_LEAST_BACKGROUND = 0.1


@dataclass(frozen=True, slots=True)
class Weighting:
    """How the method's own renderer weighs Gaussians.

    Attributes:
        sigma: The depth at which a weight falls to 0.
        background: Weight of the background, after its ReLU and 0.1 more.
        grade: What opacities are divided by where light is taken away.
        depth: Weights fall with depth at all.
    """

    sigma: float
    background: float
    grade: float
    depth: bool


@dataclass(frozen=True, slots=True)
class CellCheckpoint:
    """Everything that inference needs.

    Attributes:
        anchors: Cells as anchors: their size is both scales of an anchor.
        visibility: Spherical harmonics of how visible each cell is, before the sigmoid, [N, K].
        weighting: How the method's renderer weighs Gaussians.
    """

    anchors: AnchorCheckpoint
    visibility: Float[Tensor, "n k"]
    weighting: Weighting


def read_cells(folder: Path, iteration: int | None = None) -> CellCheckpoint:
    """Read a checkpoint of Duplex-GS.

    Args:
        folder: What training wrote, or what is in it of an iteration.
        iteration: The last where absent.

    Raises:
        CheckpointInvalid: Something is missing, or does not fit the rest.
    """
    folder, iteration = within_run(folder, iteration)
    number, place = find_iteration(folder, iteration)
    refuse_other_method("duplex-gs", folder, place)
    cfg = read_cfg_args(folder, required=True)
    ply = required_file(place / "point_cloud.ply", "the cells")
    read = _columns(ply)
    cloud = _cloud(read)
    require_sizes(cfg, cloud, ply)
    visibility = torch.cat([read["constant"], read["rest"]], dim=1)
    wanted = (cfg.integer("max_sh_degree", _degree(visibility, ply)) + 1) ** 2
    if wanted != visibility.shape[1]:
        what = (
            f"max_sh_degree is {cfg.values['max_sh_degree']}, which takes {wanted - 1} "
            f"properties anchor_shv, but {ply.name} has {visibility.shape[1] - 1}"
        )
        raise CheckpointInvalid(what, where=str(cfg.path))
    anchors = AnchorCheckpoint(
        folder, number, cfg, cloud, read_nets(place, cfg, cloud, octree=True)
    )
    return CellCheckpoint(
        anchors, visibility, _weighting(read["info"].reshape(-1), cfg, ply)
    )


def _columns(path: Path) -> dict[str, Tensor]:
    try:
        names = ply_properties(path)
        groups = {name: numbered(pattern, names) for name, pattern in _NUMBERED.items()}
        if not groups["offset"] or len(groups["offset"]) % 3 or not groups["feature"]:
            what = (
                f"{len(groups['offset'])} properties f_offset and {len(groups['feature'])} "
            )
            what += "f_anchor_feat, expected 3 K and F"
            raise CheckpointInvalid(what, where=str(path))
        rest = groups["rest"]
        groups = {name: group for name, group in groups.items() if group}
        tables = read_ply_columns(path, _COLUMNS | groups)
    except FormatError as error:
        raise CheckpointInvalid(
            str(error).replace(f"{path}: ", ""), where=str(path)
        ) from error
    read = {name: torch.from_numpy(table) for name, table in tables.items()}
    return read if rest else read | {"rest": read["constant"][:, :0]}


def _cloud(read: Mapping[str, Tensor]) -> AnchorCloud:
    axes = read["offset"].reshape(len(read["offset"]), 3, -1)  # stored axis by axis
    return AnchorCloud(
        read["position"],
        axes.transpose(1, 2).contiguous().clamp(-1.0, 1.0),
        read["feature"],
        torch.cat([read["size"], read["size"]], dim=1),
        read["rotation"],
        *(read[name].reshape(-1) for name in ("level", "extra_level", "info")),
    )


def _degree(visibility: Tensor, path: Path) -> int:
    squares = {(degree + 1) ** 2: degree for degree in range(_MAX_DEGREE + 1)}
    if visibility.shape[1] not in squares:
        what = f"{visibility.shape[1] - 1} properties anchor_shv, expected 0, 3, 8 or 15"
        raise CheckpointInvalid(what, where=str(path))
    return squares[visibility.shape[1]]


def _weighting(info: Tensor, cfg: CfgArgs, path: Path) -> Weighting:
    if len(info) < _INFO:
        what = f"has {len(info)} cells; info holds {_INFO} numbers in the first rows"
        raise CheckpointInvalid(what, where=str(path))
    sigma, background, grade = (_written(float(value)) for value in info[2:_INFO])
    if not (
        sigma > 0 and grade > 0 and all(map(math.isfinite, (sigma, background, grade)))
    ):
        what = (
            f"info is {info[:_INFO].tolist()}, expected finite numbers, and sigma and ET_grade "
            "above 0"
        )
        raise CheckpointInvalid(what, where=str(path))
    weight = _written(max(background, 0.0) + _LEAST_BACKGROUND)
    return Weighting(sigma, weight, grade, cfg.flag("depth_correct"))


def _written(value: float) -> float:
    """Return a number of float32 as people write it: 0.15, not 0.15000000596."""
    return float(str(np.float32(value)))


def describe_cells(read: CellCheckpoint) -> str:
    """Say in one line what a checkpoint holds."""
    how = read.weighting
    depth = f", which falls to 0 at depth {how.sigma:.4g}" if how.depth else ""
    text = describe_anchors(read.anchors).replace(" anchors × ", " cells × ")
    degree = round(read.visibility.shape[1] ** 0.5) - 1
    return (
        f"{text}, visibility of degree {degree}; weighted sum{depth}, background "
        f"{how.background:.4g}, ET {how.grade:.4g}"
    )
