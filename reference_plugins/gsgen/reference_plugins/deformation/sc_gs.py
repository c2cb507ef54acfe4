"""SC-GS: sparse control nodes, moved by a network, carry the Gaussians around them.

Huang et al. 2024, "SC-GS: Sparse-Controlled Gaussian Splatting for Editable Dynamic Scenes",
equations 3 to 6. Each Gaussian follows its K nearest nodes, with weights that do not depend on
time: only the nodes go through the network.
"""

__all__ = ["ScGs", "node_weights"]

import math
from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.deformation.deformation_network import DeformationNetwork
from gsgen.reference_plugins.deformation.sc_gs_checkpoint import ControlNodes, ScGsCheckpoint
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import (
    covariance_planes,
    planes_of,
    rotation_columns,
    stack_planes,
)
from gsgen.reference_plugins.tensors.positional_encoding import POINT_OCTAVES, positional_encoding
from gsgen.sdk import GaussianGenerator, Gaussians, inputs

# The published code adds this to each weight before they are normalised.
_MIN_WEIGHT = 1e-7
_CHUNK_ROWS = 8192  # rows whose distances to all nodes are in memory at once


def node_weights(
    points: Float[Tensor, "n d"], nodes: ControlNodes, neighbours: int
) -> tuple[Int[Tensor, "n k"], Float[Tensor, "n k"]]:
    """Return the nearest control nodes of points, and the float64 weights, which sum to 1."""
    centres = torch.cat([nodes.position, nodes.hyper_features], dim=1).double()
    radius = torch.exp(nodes.log_radius.double())
    weight_share = torch.sigmoid(nodes.logit_weight.double())
    indices, weights = [], []
    for part in points.double().split(_CHUNK_ROWS):  # type: ignore[no-untyped-call]
        squared_distance = (part[:, None] - centres[None]).square().sum(dim=2)
        nearest, index = squared_distance.topk(neighbours, dim=1, largest=False)
        weight = (
            torch.exp(-nearest / (2 * radius[index].square())) * weight_share[index] + _MIN_WEIGHT
        )
        indices.append(index)
        weights.append(weight / weight.sum(dim=1, keepdim=True))
    return torch.cat(indices), torch.cat(weights)


@final
class ScGs(GaussianGenerator):
    """SC-GS as a generator model, whose Gaussians follow control nodes over time."""

    family = "4d"

    position: Tensor
    scale: Tensor
    rotation: Tensor
    opacity: Tensor
    sh: Tensor
    mask: Tensor

    def __init__(self, read: ScGsCheckpoint, time: Input | None = None) -> None:
        super().__init__()
        self.inputs = (time or inputs.time(),)
        self.nodes = _NodeMotion(read.nodes, read.options.max_scale)
        canonical = read.canonical
        hyper_coordinates = read.hyper_features.expand(len(canonical), -1)
        index, weight = node_weights(
            torch.cat([canonical.position, hyper_coordinates], dim=1),
            read.nodes,
            read.options.neighbours,
        )
        self.neighbours = index.shape[1]
        for neighbour in range(self.neighbours):
            self.register_buffer(f"index_{neighbour}", index[:, neighbour].int())
            self.register_buffer(
                f"weight_{neighbour}", weight[:, neighbour : neighbour + 1].float()
            )
        self.register_buffer("position", canonical.position)
        self.register_buffer("scale", torch.exp(canonical.log_scale))
        identity = torch.tensor([1.0, 0, 0, 0]) if read.options.adds_identity else torch.zeros(4)
        self.register_buffer("rotation", canonical.rotation + identity)
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)
        self.has_mask = read.logit_mask is not None
        if read.logit_mask is not None:
            self.register_buffer("mask", torch.sigmoid(read.logit_mask))

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the Gaussians at a given time, as moved by the control nodes around them."""
        table = self.nodes(time)
        blended_motion = sum(
            (self._weighted_columns(table, neighbour) for neighbour in range(1, self.neighbours)),
            start=self._weighted_columns(table, 0),
        )
        parts = dict(
            zip(self.nodes.widths, _columns(blended_motion, self.nodes.widths), strict=True)
        )
        translation = parts["translation"]
        if "turn" in parts:
            turn, x = parts["turn"], self.position
            rows = [(turn[:, i : i + 3] * x).sum(dim=1, keepdim=True) for i in (0, 3, 6)]
            translation = translation + torch.cat(rows, dim=1) - x
        if self.has_mask:
            translation = self.mask * translation
            parts = {name: self.mask * part for name, part in parts.items()}
        opacity, sh = self.opacity, self.sh
        if "opacity" in parts:
            opacity = (opacity + parts["opacity"]).clamp(0.0, 1.0)
        if "color" in parts:
            constant_sh = sh[:, :1] + parts["color"][:, None]
            sh = constant_sh if sh.shape[1] == 1 else torch.cat([constant_sh, sh[:, 1:]], dim=1)
        covariance = covariance_planes(
            planes_of(self.scale + parts["scaling"]), planes_of(self.rotation + parts["rotation"])
        )
        return Gaussians(
            position=self.position + translation,
            opacity=opacity,
            covariance=stack_planes(covariance),
            sh=sh,
        )

    def _weighted_columns(self, table: Tensor, neighbour: int) -> Tensor:
        index, weight = (getattr(self, f"{name}_{neighbour}") for name in ("index", "weight"))
        weighted: Tensor = weight * table.index_select(0, index)
        return weighted


def _columns(table: Tensor, widths: dict[str, int]) -> list[Tensor]:
    columns, start = [], 0
    for width in widths.values():
        columns.append(table[:, start : start + width])
        start += width
    return columns


class _NodeMotion(nn.Module):
    """Computes a row of motion parameters per control node, which Gaussians around it blend.

    A node that turns its surroundings maps x to R (x − c) + c + T. Its columns are R, and the
    translation c + T − R c, so that blends of both are blends of the maps.
    """

    encoded: Tensor
    centre: Tensor

    def __init__(self, nodes: ControlNodes, max_scale: float) -> None:
        super().__init__()
        self.network = DeformationNetwork(nodes.net)
        self.log_max_scale = math.log(max_scale) if max_scale > 0 else None
        self.register_buffer("centre", nodes.position)
        self.register_buffer("encoded", positional_encoding(nodes.position, POINT_OCTAVES))
        self.widths = {"translation": 3, "scaling": 3, "rotation": 4}
        heads = {
            "translation": nodes.net.warp[0],
            "scaling": nodes.net.scaling,
            "rotation": nodes.net.rotation,
        }
        if nodes.opacity is not None:
            self.widths["opacity"], heads["opacity"] = 1, nodes.opacity
        self.heads = nn.ModuleDict({name: Dense(*layer) for name, layer in heads.items()})
        self.color = nn.ModuleList(Dense(*layer) for layer in nodes.color or ())
        if nodes.color is not None:
            self.widths["color"] = 3
        self.local = None if nodes.local_rotation is None else Dense(*nodes.local_rotation)
        if self.local is not None:
            self.widths["turn"] = 9

    def forward(self, time: Float[Tensor, "1"]) -> Float[Tensor, "m c"]:
        moment = self.network.moment(time)
        hidden = self.network(self.encoded, moment)
        columns = {name: head(hidden) for name, head in self.heads.items()}
        if self.log_max_scale is not None:
            columns["scaling"] = torch.tanh(columns["scaling"]) * self.log_max_scale
        if len(self.color):
            count = self.encoded.shape[0]
            parts = [self.encoded, moment.expand(count, -1), hidden]
            value = torch.cat(parts, dim=1)
            for index, layer in enumerate(self.color):
                value = layer(torch.relu(value) if index else value)
            columns["color"] = value
        if self.local is not None:
            quaternion = planes_of(self.local(hidden))
            first_column, second_column, third_column = rotation_columns(
                [quaternion[0] + 1, *quaternion[1:]]
            )
            turn = [
                plane
                for row in zip(first_column, second_column, third_column, strict=True)
                for plane in row
            ]
            columns["turn"] = stack_planes(turn)
            x, y, z = planes_of(self.centre)
            rotated_positions = stack_planes(
                [a * x + b * y + c * z for a, b, c in (turn[:3], turn[3:6], turn[6:])]
            )
            columns["translation"] = columns["translation"] + self.centre - rotated_positions
        return _concatenate_parts([columns[name] for name in self.widths])


def _concatenate_parts(parts: Sequence[Tensor]) -> Tensor:
    """Concatenate tensors along their columns, at most four tensors at once."""
    while len(parts) > 1:
        parts = [torch.cat(tuple(parts[i : i + 4]), dim=1) for i in range(0, len(parts), 4)]
    return parts[0]
