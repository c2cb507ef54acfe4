"""Reads checkpoints of 4DGaussians: a 3DGS PLY, a hexplane and its networks.

``deformation.pth`` is the state dict of ``deform_network`` (hustvl/4DGaussians,
``scene/deformation.py``, ``scene/hexplane.py``). Sizes follow from its tensors; only
``cfg_args`` tells which parts are active.
"""

__all__ = ["HEAD_SIZES", "DeformationFlags", "HexPlaneCheckpoint", "HexPlaneNets", "read_hexplanes"]

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.loading.canonical import Canonical, read_canonical
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
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
from gsgen.reference_plugins.tensors.hexplane import PLANE_COUNT

# Head, named after the values that it changes → number of its outputs.
HEAD_SIZES = {"pos": 3, "scales": 3, "rotations": 4, "opacity": 1, "shs": 48}

_NETWORK_PREFIX = "deformation_net."
_GRID_NAME = re.compile(r"grid\.grids\.(\d+)\.(\d+)")
_OUTPUT_NAME = re.compile(r"feature_out\.(\d+)\.weight")
# Tensors of an earlier encoding of time; inference does not need them.
_UNUSED_PREFIXES = ("timenet.", "time_poc", "pos_poc", "rotation_scaling_poc", "opacity_poc")


@dataclass(frozen=True, slots=True)
class DeformationFlags:
    """The parts of the 4DGaussians networks that are active."""

    active_heads: tuple[str, ...]  # names of the active heads, in the order of ``HEADS``
    apply_rotation: bool  # multiply the rotation by the change, instead of adding it
    mask: str  # factor of the canonical values: ``static_mlp``, ``empty_voxel`` or empty

    @classmethod
    def of(cls, cfg: CfgArgs) -> "DeformationFlags":
        """Read from 4DGaussians' training options which parts of its networks are active.

        An absent option has the default of the published code.
        """
        if cfg.flag("no_grid"):
            hint = "The published code fails with it, too."
            raise CheckpointInvalid(
                "the training option no_grid is True, expected False",
                where=str(cfg.path),
                hint=hint,
            )
        if cfg.integer("grid_pe", 0) > 1:
            message = f"grid_pe is {cfg.values['grid_pe']}, expected 0 or 1"
            raise CheckpointInvalid(message, where=str(cfg.path))
        is_disabled = {
            "pos": cfg.flag("no_dx"),
            "scales": cfg.flag("no_ds"),
            "rotations": cfg.flag("no_dr"),
            "opacity": cfg.flag("no_do", default=True),
            "shs": cfg.flag("no_dshs", default=True),
        }
        active_heads = tuple(head for head in HEAD_SIZES if not is_disabled[head])
        if not active_heads:
            message = "no_dx, no_ds, no_dr, no_do and no_dshs are all True: nothing moves"
            hint = "Export the PLY with `gsgen export static`."
            raise CheckpointInvalid(message, where=str(cfg.path), hint=hint)
        mask = "static_mlp" if cfg.flag("static_mlp") else ""
        mask = mask or ("empty_voxel" if cfg.flag("empty_voxel") else "")
        return cls(active_heads, cfg.flag("apply_rotation"), mask)


@dataclass(frozen=True, slots=True, kw_only=True)
class HexPlaneNets:
    """The hexplane of 4DGaussians and the networks that read the hexplane's features."""

    aabb: Float[Tensor, "2 3"]  # box of the planes; the first row is the upper corner
    # for each resolution six planes [C, second axis, first axis], of the axes xy xz xt yz yt zt
    grids: tuple[tuple[Tensor, ...], ...]
    feature: tuple[Layer, ...]  # layers behind the planes, with ReLU between them
    # for each active head two layers, with ReLU before each
    heads: Mapping[str, tuple[Layer, Layer]]
    # two layers of the mask of static parts, if there is one
    static: tuple[Layer, Layer] | None = None
    # voxel grid [x, y, z] with its lower and upper corner, if there is one
    voxels: tuple[Tensor, Tensor, Tensor] | None = None


@dataclass(frozen=True, slots=True)
class HexPlaneCheckpoint:
    """The Gaussians, hexplane and networks of a 4DGaussians checkpoint."""

    run: TrainingRun
    flags: DeformationFlags  # the active parts of the networks
    canonical: Canonical  # the canonical Gaussians
    nets: HexPlaneNets  # the hexplane and its networks

    def describe(self) -> str:
        """Return the sizes and the active networks of a 4DGaussians checkpoint as one line."""
        grids = self.nets.grids
        sizes = ["×".join(map(str, _sizes(planes))) for planes in grids]
        parts = [
            self.canonical.describe(),
            f"planes of {grids[0][0].shape[0]} channels at {', '.join(sizes)}",
            f"{len(self.nets.feature)} layers of {self.nets.feature[0][0].shape[0]}",
            f"heads {', '.join(self.flags.active_heads)}",
        ]
        parts += ["rotations multiplied"] if self.flags.apply_rotation else []
        parts += [f"masked by {self.flags.mask}"] if self.flags.mask else []
        return f"{self.run}, {', '.join(parts)}"


def _sizes(planes: tuple[Tensor, ...]) -> tuple[int, int, int, int]:
    return (planes[0].shape[2], planes[0].shape[1], planes[1].shape[1], planes[2].shape[1])


def read_hexplanes(folder: Path, iteration: int | None = None) -> HexPlaneCheckpoint:
    """Read a checkpoint of 4DGaussians.

    Without ``iteration``, the last one of the fine stage is read.
    """
    run = open_run("hexplane-4dgs", folder, iteration, needs_cfg=True)
    flags = DeformationFlags.of(run.cfg)
    canonical = read_canonical(run.files / "point_cloud.ply")
    if "shs" in flags.active_heads and canonical.degree != 3:
        message = f"SH of degree {canonical.degree}, but no_dshs is False: expected degree 3"
        raise CheckpointInvalid(message, where=str(run.files / "point_cloud.ply"))
    nets = _read_hexplane_networks(run.files / "deformation.pth", flags)
    return HexPlaneCheckpoint(run, flags, canonical, nets)


def _read_hexplane_networks(path: Path, flags: DeformationFlags) -> HexPlaneNets:
    state = load_state(path, "the deformation network")
    net = entries_below(state, _NETWORK_PREFIX)
    scales, layers = _counts(path, net)
    expected = _expected_shapes(path, net, flags, scales, layers)
    # Inactive heads and masks are saved, too.
    unused_prefixes = [
        f"{_NETWORK_PREFIX}{head}_deform." for head in HEAD_SIZES if head not in flags.active_heads
    ]
    unused_prefixes += [
        f"{_NETWORK_PREFIX}{mask}." for mask in ("static_mlp", "empty_voxel") if mask != flags.mask
    ]
    read = require_tensors(
        path,
        state,
        {_NETWORK_PREFIX + k: v for k, v in expected.items()},
        (*_UNUSED_PREFIXES, *unused_prefixes),
    )
    read = entries_below(read, _NETWORK_PREFIX)
    grids = tuple(
        tuple(read[f"grid.grids.{s}.{p}"][0] for p in range(PLANE_COUNT)) for s in range(scales)
    )
    _require_sizes(path, grids)
    if (read["grid.aabb"][0] == read["grid.aabb"][1]).any():
        message = f"{_NETWORK_PREFIX}grid.aabb is {read['grid.aabb'].tolist()}, expected a box with a volume"
        raise CheckpointInvalid(message, where=str(path))
    static = _layer_pair(read, "static_mlp") if flags.mask == "static_mlp" else None
    return HexPlaneNets(
        aabb=read["grid.aabb"],
        grids=grids,
        feature=tuple(layer_of(read, f"feature_out.{2 * i}") for i in range(layers)),
        heads={head: _layer_pair(read, f"{head}_deform") for head in flags.active_heads},
        static=static,
        voxels=_read_voxels(read) if flags.mask == "empty_voxel" else None,
    )


def _counts(path: Path, net: Mapping[str, Any]) -> tuple[int, int]:
    """Return the number of a hexplane's resolutions, and of the feature network's layers."""
    scales = {int(match[1]) for name in net if (match := _GRID_NAME.fullmatch(name))}
    layers = {int(match[1]) for name in net if (match := _OUTPUT_NAME.fullmatch(name))}
    if scales != set(range(len(scales))) or not scales or not layers:
        message = f"{len(scales)} resolutions of planes, {len(layers)} layers behind them"
        hint = "Expected deformation_net.grid.grids.S.P and deformation_net.feature_out.L."
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    return len(scales), len(layers)


def _expected_shapes(
    path: Path, net: Mapping[str, Any], flags: DeformationFlags, scales: int, layers: int
) -> dict[str, Shape]:
    first = net.get("feature_out.0.weight")
    plane = net.get("grid.grids.0.0")
    if not isinstance(first, Tensor) or not isinstance(plane, Tensor) or plane.ndim != 4:
        message = "has no deformation_net.feature_out.0.weight or grid.grids.0.0"
        raise CheckpointInvalid(message, where=str(path))
    width, channels = first.shape[0], plane.shape[1]
    expected: dict[str, Shape] = {"grid.aabb": (2, 3)}
    for scale in range(scales):
        for index in range(PLANE_COUNT):
            expected[f"grid.grids.{scale}.{index}"] = (1, channels, None, None)
    for layer in range(layers):
        expected |= linear_shapes(
            f"feature_out.{2 * layer}", channels * scales if layer == 0 else width, width
        )
    output_sizes = {f"{head}_deform": HEAD_SIZES[head] for head in flags.active_heads}
    output_sizes |= {"static_mlp": 1} if flags.mask == "static_mlp" else {}
    for name, output_size in output_sizes.items():
        expected |= linear_shapes(f"{name}.1", width, width) | linear_shapes(
            f"{name}.3", width, output_size
        )
    if flags.mask == "empty_voxel":
        expected["empty_voxel.grid"] = (1, 1, None, None, None)
        for corner in ("xyz_min", "xyz_max"):
            if f"empty_voxel.{corner}" in net:
                expected[f"empty_voxel.{corner}"] = (3,)
    return expected


def _layer_pair(read: Mapping[str, Tensor], name: str) -> tuple[Layer, Layer]:
    return layer_of(read, f"{name}.1"), layer_of(read, f"{name}.3")


def _read_voxels(read: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Return a checkpoint's voxel grid and its two corners, by default those of the hexplane."""
    upper_corner, lower_corner = read["grid.aabb"]
    low_corner = read.get("empty_voxel.xyz_min", lower_corner)
    return read["empty_voxel.grid"][0, 0], low_corner, read.get("empty_voxel.xyz_max", upper_corner)


def _require_sizes(path: Path, grids: tuple[tuple[Tensor, ...], ...]) -> None:
    """Raise if the six planes of a hexplane differ in the resolution along an axis."""
    pairs = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
    for scale, planes in enumerate(grids):
        size = _sizes(planes)
        for index, (first, second) in enumerate(pairs):
            actual, expected = tuple(planes[index].shape[1:]), (size[second], size[first])
            if actual != expected or min(actual) < 2:
                message = f"{_NETWORK_PREFIX}grid.grids.{scale}.{index} is {actual}, expected {expected} with sizes of at least 2"
                raise CheckpointInvalid(message, where=str(path))
