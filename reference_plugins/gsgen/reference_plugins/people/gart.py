"""GART: Gaussians that follow the joints of SMPL and additional bones, which a network moves.

Lei et al. 2024, "GART: Gaussian Articulated Template Models": a Gaussian's weights of joints and
bones are constant (equations 5 and 8), the transform that they blend moves its centre and its axes,
and its colour depends on the direction of the camera in these axes.
"""

__all__ = ["Gart"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from gsgen.contract.spec.manifest import Space
from gsgen.reference_plugins.bodies.actors import AnimatedPerson, PersonInputs
from gsgen.reference_plugins.bodies.rotations import rotation_matrices
from gsgen.reference_plugins.bodies.skinning import (
    blend_transforms,
    covariance,
    multiply_matrices,
    planes_to_rows,
    posed_transforms,
    repeat_rows,
    transform_points,
)
from gsgen.reference_plugins.people.gart_checkpoint import JOINTS, GartCheckpoint
from gsgen.reference_plugins.tensors.harmonics import harmonic_sum, max_brightness
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import camera_centre, quaternion_to_matrix

_LEAKY_SLOPE = 0.01
_MIN_SQUARED_LENGTH = 1e-24


class _Bones(nn.Module):
    """The additional bones in the canonical pose, of a network or of a training frame."""

    identity: Tensor
    frames: Tensor

    def __init__(self, read: GartCheckpoint) -> None:
        super().__init__()
        self.layers = nn.ModuleList(Dense(*layer) for layer in read.bone_layers)
        self.count = read.weights.shape[1] - JOINTS
        self.is_network = read.bone_head is not None
        if read.bone_head is not None:
            # The network's quaternions are relative to the identity.
            identity = torch.tensor([1.0, *6 * [0.0]]).repeat(self.count)
            self.head = Dense(read.bone_head, identity)
        elif read.bone_frames is not None:
            self.register_buffer("frames", read.bone_frames.flatten(1))

    def forward(self, actor: AnimatedPerson) -> Float[Tensor, "k b 3 4"]:
        if not self.is_network:
            rows = [self.frames.index_select(0, frame) for frame in actor.frame or ()]
            return torch.cat(rows).reshape(-1, self.count, 3, 4)
        hidden = actor.pose[:, 1:].flatten(1)
        for layer in self.layers:
            hidden = functional.leaky_relu(layer(hidden), _LEAKY_SLOPE)
        numbers = self.head(hidden).reshape(-1, self.count, 7)
        rotation = quaternion_to_matrix(numbers[:, :, :4])
        return torch.cat([rotation, numbers[:, :, 4:, None]], dim=3)


@final
class Gart(GaussianGenerator):
    """A GART avatar, or several copies of it, whose poses are inputs of the model."""

    family = "avatar"
    space = Space(up="+y")

    joints: Tensor
    to_rest: Tensor
    root: Tensor
    weights: Tensor
    position: Tensor
    axes: Tensor
    scale: Tensor
    opacity: Tensor
    sh: Tensor

    def __init__(self, read: GartCheckpoint, *, bodies: int = 1) -> None:
        """Store an avatar's Gaussians as planes, one tensor for each component."""
        super().__init__()
        frames = 0 if read.bone_frames is None else len(read.bone_frames)
        self.actors = PersonInputs(joints=JOINTS, frames=frames, bodies=bodies)
        self.degree = read.degree
        self.inputs = (*self.actors.declared(), *([inputs.view()] if self.degree else []))
        self.parents = read.parents
        self.color_range = (0.0, max_brightness(read.sh))
        self.bones = _Bones(read) if read.weights.shape[1] > JOINTS else None
        tables = {
            "joints": read.joints,
            "to_rest": read.to_rest,
            "root": torch.cat([torch.zeros(3, 3), read.root[:, None]], dim=1),
            "weights": read.weights.t(),
            "position": read.position.t()[None],
            "axes": quaternion_to_matrix(read.rotation.double()).float().permute(1, 2, 0)[None],
            "scale": read.scale.t()[None, None],
            "opacity": read.opacity,
            "sh": read.sh.permute(1, 2, 0)[:, None],
        }
        for name, table in tables.items():
            self.register_buffer(name, table.contiguous())

    def forward(self, *tensors: Tensor) -> Gaussians:
        """Return the posed Gaussians of all bodies, body after body."""
        values, camera = (tensors[:-1], tensors[-1]) if self.degree else (tensors, None)
        actor, bodies = self.actors.actor_from(values), self.actors.bodies
        rotations = rotation_matrices(actor.pose)
        # 1. The joints' transforms from the canonical pose, then the bones', which the root turns.
        transforms = posed_transforms(rotations, self.joints, self.parents) @ self.to_rest
        if self.bones is not None:
            bones = rotations[:, :1] @ (self.bones(actor) - self.root) + self.root
            transforms = torch.cat([transforms, bones], dim=1)
        # 2. Weights need not add up to 1, so the root translation is added after blending.
        blended = blend_transforms(transforms, self.weights)
        position = transform_points(blended, self.position) + actor.shift[:, :, None]
        axes = multiply_matrices(blended, self.axes)
        # 3. Colours are seen from the camera's direction in the Gaussian's own, distorted axes.
        direction = self.position
        if camera is not None:
            offset = position - camera_centre(camera).reshape(1, 3, 1)
            direction = (axes * offset[:, :, None]).sum(dim=1)
            squared_length = (direction * direction).sum(dim=1, keepdim=True)
            direction = direction * torch.rsqrt(squared_length.clamp(min=_MIN_SQUARED_LENGTH))
        rgb = torch.relu(0.5 + harmonic_sum(self.sh.unbind(0), direction))
        return Gaussians(
            position=planes_to_rows(position),
            opacity=repeat_rows(self.opacity, bodies),
            covariance=planes_to_rows(covariance(axes * self.scale)),
            rgb=planes_to_rows(rgb)
            if camera is not None
            else repeat_rows(planes_to_rows(rgb), bodies),
        )
