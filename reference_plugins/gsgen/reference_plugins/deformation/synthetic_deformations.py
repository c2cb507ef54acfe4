"""Writes synthetic checkpoints of methods that deform Gaussians, as their training code does.

The Gaussians are a torus knot; the weights are noise, large enough to move it visibly.
"""

__all__ = ["HexPlaneOptions", "write_deformable", "write_hexplane", "write_sc_gs"]

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

from gsgen.formats import write_ply
from gsgen.reference_plugins.deformation.hexplane_checkpoint import HEAD_SIZES
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.reference_plugins.writing.random_layers import random_linear
from gsgen.reference_plugins.writing.run_files import splat_columns, write_cfg_args, write_columns

_UNUSED_PREFIXES = ("time_poc", "pos_poc", "rotation_scaling_poc", "opacity_poc")


@dataclass(frozen=True, slots=True, kw_only=True)
class HexPlaneOptions:
    """Sizes and options of a synthetic 4DGaussians checkpoint."""

    count: int = 64  # number of Gaussians
    channels: int = 4  # channels of each plane
    resolution: tuple[int, int, int, int] = (8, 8, 8, 6)  # cells along x, y, z and t
    # factors of the cells along x, y and z, one for each set of planes
    multires: tuple[int, ...] = (1, 2)
    width: int = 16  # width of the network
    depth: int = 1  # number of layers behind the planes; 0 means 1
    # options of ``cfg_args`` that differ from the defaults, such as ``no_dshs=False``
    flags: Mapping[str, bool] = field(default_factory=dict)
    degree: int = 3  # SH degree
    sway: float = 0.15  # approximate movement of Gaussians; the knot is three units wide
    seed: int = 0  # seed of all random numbers


def write_hexplane(folder: Path, options: HexPlaneOptions = HexPlaneOptions()) -> Path:
    """Write a synthetic checkpoint of 4DGaussians, and return the folder."""
    iteration_folder = folder / "point_cloud" / "iteration_30000"
    cfg = {
        "kplanes_config": {
            "grid_dimensions": 2,
            "input_coordinate_dim": 4,
            "output_coordinate_dim": options.channels,
            "resolution": list(options.resolution),
        },
        "multires": list(options.multires),
        "defor_depth": options.depth,
        "net_width": options.width,
        "no_dx": False,
        "no_ds": False,
        "no_dr": False,
        "no_do": True,
        "no_dshs": True,
        "bounds": 1.6,
    }
    write_cfg_args(folder, cfg | dict(options.flags))
    iteration_folder.mkdir(parents=True, exist_ok=True)
    write_ply(
        iteration_folder / "point_cloud.ply",
        torus_knot(options.count, degree=options.degree, seed=options.seed),
    )
    torch.save(_hexplane_state(options), iteration_folder / "deformation.pth")
    return folder


def _hexplane_state(options: HexPlaneOptions) -> dict[str, Tensor]:
    noise = torch.Generator().manual_seed(options.seed)
    net = "deformation_net."
    # The knot extends beyond the box, so that tests cover its border.
    state = {f"{net}grid.aabb": torch.tensor([[1.2, 0.5, 1.3], [-1.1, -0.5, -1.2]])}
    for scale, factor in enumerate(options.multires):
        sizes = [*(factor * size for size in options.resolution[:3]), options.resolution[3]]
        for index, (a, b) in enumerate(combinations(range(4), 2)):
            shape = (1, options.channels, sizes[b], sizes[a])
            # Six planes are multiplied: their values are bounded, so that no product is an outlier
            # which throws a few Gaussians far away from their neighbours.
            cells = 1 + 0.3 * torch.tanh(torch.randn(shape, generator=noise))
            state[f"{net}grid.grids.{scale}.{index}"] = cells
    width = options.width
    for layer in range(max(1, options.depth)):
        inputs = options.channels * len(options.multires) if layer == 0 else width
        state |= random_linear(f"{net}feature_out.{2 * layer}", inputs, width, noise)
    for name, outputs in HEAD_SIZES.items():
        state |= random_linear(f"{net}{name}_deform.1", width, width, noise)
        output_gain = options.sway if name == "pos" else 0.15
        state |= random_linear(f"{net}{name}_deform.3", width, outputs, noise, output_gain)
    if options.flags.get("static_mlp"):
        state |= random_linear(f"{net}static_mlp.1", width, width, noise)
        state |= random_linear(f"{net}static_mlp.3", width, 1, noise)
    if options.flags.get("empty_voxel"):
        state[f"{net}empty_voxel.grid"] = torch.rand((1, 1, 5, 6, 7), generator=noise)
    return state | {name: torch.ones(4) for name in _UNUSED_PREFIXES}


def write_deformable(
    folder: Path,
    *,
    count: int = 64,
    blender: bool = True,
    six_degrees: bool = False,
    width: int = 32,
    sway: float = 0.2,
    seed: int = 0,
) -> Path:
    """Write a synthetic checkpoint of Deformable-3D-Gaussians, and return the folder.

    ``blender`` encodes time by a network of its own, and ``six_degrees`` moves points by screw
    motions. ``width`` is 256 in the published code; ``sway`` is the approximate movement.
    """
    noise = torch.Generator().manual_seed(seed)
    state = _time_network("", 63 + (30 if blender else 21), width, noise)
    for name in ("branch_w", "branch_v") if six_degrees else ("gaussian_warp",):
        state |= random_linear(name, width, 3, noise, sway)
    state |= random_linear("gaussian_rotation", width, 4, noise, 0.2)
    state |= random_linear("gaussian_scaling", width, 3, noise, 0.004)
    write_cfg_args(folder, {"is_blender": blender, "is_6dof": six_degrees, "sh_degree": 3})
    for subfolder in ("point_cloud/iteration_40000", "deform/iteration_40000"):
        (folder / subfolder).mkdir(parents=True, exist_ok=True)
    write_ply(folder / "point_cloud/iteration_40000/point_cloud.ply", torus_knot(count, seed=seed))
    torch.save(state, folder / "deform/iteration_40000/deform.pth")
    return folder


def write_sc_gs(
    folder: Path,
    *,
    count: int = 64,
    nodes: int = 12,
    blender: bool = True,
    width: int = 32,
    options: Mapping[str, object] | None = None,
    sway: float = 0.2,
    seed: int = 0,
) -> Path:
    """Write a synthetic checkpoint of SC-GS, and return the folder.

    ``options`` go to ``cfg_args``; ``local_frame``, ``pred_opacity``, ``pred_color`` and
    ``gs_with_motion_mask`` add their tensors, and ``hyper_dim`` is 2 by default. ``width`` is 256
    in the published code; ``sway`` is the approximate movement.
    """
    noise = torch.Generator().manual_seed(seed)
    cfg = {"is_blender": blender, "K": 3, "deform_type": "node", "hyper_dim": 2, **(options or {})}
    knot_splats = torus_knot(count, seed=seed)
    hyper_size = int(str(cfg["hyper_dim"]))
    centres = torch.from_numpy(torus_knot(nodes, seed=seed + 1).position)
    embedded_size = 63 + (30 if blender else 21)
    state = _time_network("network.", embedded_size, width, noise)
    state |= random_linear("network.gaussian_warp", width, 3, noise, sway)
    state |= random_linear("network.gaussian_rotation", width, 4, noise, 0.2)
    state |= random_linear("network.gaussian_scaling", width, 3, noise, 0.004)
    if cfg.get("local_frame"):
        state |= random_linear("network.local_rotation", width, 4, noise, 0.2)
    if cfg.get("pred_opacity"):
        state |= random_linear("network.gaussian_opacity", width, 1, noise, 0.1)
    if cfg.get("pred_color"):
        sizes = (embedded_size + width, width, width, 3)
        for index, layer in enumerate((0, 2, 4)):
            inputs, outputs = sizes[index], sizes[index + 1]
            state |= random_linear(f"network.gaussian_color.{layer}", inputs, outputs, noise)
    state["nodes"] = torch.cat(
        [centres, 0.1 * torch.randn((nodes, hyper_size), generator=noise)], dim=1
    )
    state["_node_radius"] = -1.5 + 0.2 * torch.randn(nodes, generator=noise)
    state["_node_weight"] = torch.randn((nodes, 1), generator=noise)
    state["inited"] = torch.tensor(True)
    write_cfg_args(folder, cfg)
    features = hyper_size + bool(cfg.get("gs_with_motion_mask"))
    table = 0.1 * torch.randn((count, features), generator=noise)
    for subfolder in ("point_cloud/iteration_80000", "deform/iteration_80000"):
        (folder / subfolder).mkdir(parents=True, exist_ok=True)
    columns = splat_columns(knot_splats) | {
        f"fea_{i}": table[:, i].numpy() for i in range(features)
    }
    write_columns(folder / "point_cloud/iteration_80000/point_cloud.ply", columns)
    torch.save(state, folder / "deform/iteration_80000/deform.pth")
    return folder


def _time_network(
    prefix: str, embedded_size: int, width: int, noise: torch.Generator
) -> dict[str, Tensor]:
    """Return random weights of a deformation MLP: eight layers; Blender scenes have two more."""
    state: dict[str, Tensor] = {}
    for layer in range(8):
        inputs = {0: embedded_size, 5: width + embedded_size}.get(layer, width)
        state |= random_linear(f"{prefix}linear.{layer}", inputs, width, noise, 1.5)
    for layer in (0, 5):  # weaken high frequencies in space, so that neighbours move alike
        state[f"{prefix}linear.{layer}.weight"][:, 3:63] *= 0.4 ** (torch.arange(60) // 6)
    if embedded_size == 63 + 30:
        state |= random_linear(f"{prefix}timenet.0", 13, width, noise)
        state |= random_linear(f"{prefix}timenet.2", width, 30, noise)
    return state
