"""Reads the networks of GauHuman and R3-Avatar that correct joints and skinning weights.

``BodyPoseRefiner`` maps a pose to additional joint rotations. ``LBSOffsetDecoder`` maps a point to
offsets of the logarithms of its skinning weights (skhu101/GauHuman, ``nets/``).
"""

__all__ = ["SKIP_LAYER", "PoseNets", "read_pose_nets", "weight_offsets"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.loading.states import (
    Layer,
    Shape,
    layer_of,
    linear_shapes,
    require_tensors,
)
from gsgen.reference_plugins.tensors.positional_encoding import (
    POINT_OCTAVES,
    encoded_size,
    positional_encoding,
)

_EMBEDDED_SIZE = encoded_size(3, POINT_OCTAVES)
# Index of the layer whose input includes the encoded point again.
SKIP_LAYER = 3


@dataclass(frozen=True, slots=True)
class PoseNets:
    """Layers of the networks that correct joint rotations and skinning weights."""

    pose: tuple[Layer, ...]  # three layers, from 3(J−1) axis-angles to as many
    weights: tuple[Layer, ...]  # five layers, from an encoded point to J offsets


def read_pose_nets(
    path: Path, pose: Mapping[str, Any], weights: Mapping[str, Any], joints: int
) -> PoseNets:
    """Extract GauHuman's two correction networks from their state dicts, and check all shapes."""
    rotation_count = 3 * (joints - 1)
    width = _weight_width(pose.get("block_mlps.0.weight"))
    sizes = [(rotation_count, width), (width, width), (width, rotation_count)]
    names = [f"block_mlps.{2 * index}" for index in range(3)]
    expected: dict[str, Shape] = {}
    for name, (inputs, outputs) in zip(names, sizes, strict=True):
        expected |= linear_shapes(name, inputs, outputs)
    read = require_tensors(path, pose, expected)
    first_layers = tuple(layer_of(read, name) for name in names)
    width = _weight_width(weights.get("bw_linears.0.weight"))
    input_sizes = [_EMBEDDED_SIZE, width, width, width and _EMBEDDED_SIZE + width]
    names = [f"bw_linears.{index}" for index in range(4)] + ["bw_fc"]
    expected = {}
    for name, inputs in zip(names, [*input_sizes, width], strict=True):
        outputs = joints if name == "bw_fc" else width
        expected |= {f"{name}.weight": (outputs, inputs, 1), f"{name}.bias": (outputs,)}
    read = require_tensors(path, weights, expected)
    second_layers = tuple((read[f"{n}.weight"][:, :, 0], read[f"{n}.bias"]) for n in names)
    return PoseNets(first_layers, second_layers)


def _weight_width(weight: Any) -> int | None:
    return weight.shape[0] if isinstance(weight, Tensor) and weight.ndim else None


def weight_offsets(nets: PoseNets, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n j"]:
    """Return GauHuman's learnt offsets to the log of skinning weights at points, in float64."""
    first_layers = hidden = positional_encoding(points.double(), POINT_OCTAVES)
    *hidden_layers, output_layer = nets.weights
    for index, (weight, bias) in enumerate(hidden_layers):
        if index == SKIP_LAYER:
            hidden = torch.cat([first_layers, hidden], dim=1)
        hidden = torch.relu(hidden @ weight.double().t() + bias.double())
    offsets: Tensor = hidden @ output_layer[0].double().t() + output_layer[1].double()
    return offsets
