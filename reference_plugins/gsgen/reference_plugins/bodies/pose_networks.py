"""The two small networks of GauHuman that correct joints and skinning weights; R3-Avatar has them, too.

``BodyPoseRefiner`` turns a pose into further turns of the joints, ``LBSOffsetDecoder`` a point into
changes of its skinning weights' logarithms (skhu101/GauHuman, ``nets/``).
"""

__all__ = ["SKIP", "PoseNets", "read_pose_nets", "weight_offsets"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.loading.states import Shape, require_tensors
from gsgen.reference_plugins.tensors.positional_encoding import (
    POINT_OCTAVES,
    encoded_size,
    positional_encoding,
)

Layer = tuple[Float[Tensor, "o i"], Float[Tensor, " o"]]

_EMBEDDED = encoded_size(3, POINT_OCTAVES)
# The layer that sees the embedded point once more.
SKIP = 3


@dataclass(frozen=True, slots=True)
class PoseNets:
    """Their layers.

    Attributes:
        pose: Three, from 3(J−1) axis-angles to as many.
        weights: Five, from an embedded point to J offsets.
    """

    pose: tuple[Layer, ...]
    weights: tuple[Layer, ...]


def read_pose_nets(
    path: Path, pose: Mapping[str, Any], weights: Mapping[str, Any], joints: int
) -> PoseNets:
    """Check both state dicts and take the layers out of them.

    Raises:
        CheckpointInvalid: A tensor is missing, unexpected or of another shape.
    """
    turns = 3 * (joints - 1)
    wide = _width(pose.get("block_mlps.0.weight"))
    sizes = [(turns, wide), (wide, wide), (wide, turns)]
    names = [f"block_mlps.{2 * index}" for index in range(3)]
    wanted: dict[str, Shape] = {}
    for name, (inputs, outputs) in zip(names, sizes, strict=True):
        wanted |= {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
    read = require_tensors(path, pose, wanted)
    first = tuple((read[f"{n}.weight"], read[f"{n}.bias"]) for n in names)
    wide = _width(weights.get("bw_linears.0.weight"))
    inputs_of = [_EMBEDDED, wide, wide, wide and _EMBEDDED + wide]
    names = [f"bw_linears.{index}" for index in range(4)] + ["bw_fc"]
    wanted = {}
    for name, inputs in zip(names, [*inputs_of, wide], strict=True):
        outputs = joints if name == "bw_fc" else wide
        wanted |= {f"{name}.weight": (outputs, inputs, 1), f"{name}.bias": (outputs,)}
    read = require_tensors(path, weights, wanted)
    second = tuple((read[f"{n}.weight"][:, :, 0], read[f"{n}.bias"]) for n in names)
    return PoseNets(first, second)


def _width(weight: Any) -> int | None:
    return weight.shape[0] if isinstance(weight, Tensor) and weight.ndim else None


def weight_offsets(nets: PoseNets, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n j"]:
    """Return what is added to the logarithms of the skinning weights at ``points``, in float64."""
    first = hidden = positional_encoding(points.double(), POINT_OCTAVES)
    *inner, last = nets.weights
    for index, (weight, bias) in enumerate(inner):
        if index == SKIP:
            hidden = torch.cat([first, hidden], dim=1)
        hidden = torch.relu(hidden @ weight.double().t() + bias.double())
    made: Tensor = hidden @ last[0].double().t() + last[1].double()
    return made
