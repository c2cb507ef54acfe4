"""GauHuman: linear blend skinning of Gaussians from a big pose, with learned corrections.

Hu, Hu and Liu 2024, "GauHuman: Articulated Gaussian Splatting from Monocular Human Videos":
equations 4 to 8 move a point from the big pose to the pose and its covariance with it, and a network
corrects each joint's rotation. Values that do not depend on the pose are baked: rest positions and
skinning weights, or the tables from which they follow.
"""

__all__ = ["GauHuman"]

from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Space
from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import PersonInputs, Rotation
from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_blendshapes import PoseBlendshapes
from gsgen.reference_plugins.bodies.pose_networks import PoseNets
from gsgen.reference_plugins.bodies.skinning import (
    blend_transforms,
    covariance,
    multiply_matrices,
    planes_to_rows,
    repeat_rows,
    transform_points,
)
from gsgen.reference_plugins.bodies.skinning_weights import BigPoseGaussians
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.tensors.baked_constants import Bake, Constants
from gsgen.sdk import GaussianGenerator, Gaussians


@final
class GauHuman(GaussianGenerator):
    """A GauHuman avatar, or several copies of it, whose poses are inputs of the model."""

    family = "avatar"
    space = Space(up="+y")

    vertex: Tensor
    opacity: Tensor
    sh: Tensor

    def __init__(
        self,
        canonical: Canonical,
        body: Body,
        nets: PoseNets | None = None,
        *,
        shape: Sequence[float] | None = None,
        rotation: Rotation = "matrix",
        bodies: int = 1,
        add_hands: bool = False,
        bake: Bake = "auto",
    ) -> None:
        """Transform the Gaussians of GauHuman from the big pose to the rest pose.

        Without ``shape``, the shape coefficients are an input. ``add_hands`` adds the mean pose of
        SMPL-X's hands to poses; ``bake`` stores the baked values, or the tables behind them.
        """
        super().__init__()
        free_shape_count = body.shape_dirs.shape[2] if shape is None else 0
        self.actors = PersonInputs(
            joints=body.joints, rotation=rotation, shape=free_shape_count, bodies=bodies
        )
        self.inputs = self.actors.declared()
        xyz = canonical.position.double().numpy()
        vertices = rest_pose.posed_vertices(body, rest_pose.big_pose(body), np.zeros(0))
        used, vertex = np.unique(rest_pose.nearest(xyz, vertices), return_inverse=True)
        baked_shape = None if shape is None else np.asarray(shape)
        self.pose_blendshapes = PoseBlendshapes(body, used, baked_shape, nets, add_hands=add_hands)
        self.register_buffer("vertex", torch.from_numpy(vertex.astype(np.int32)))
        scale = torch.exp(canonical.log_scale.double()).float()
        gaussians = (canonical.position, scale, canonical.rotation)
        big_pose_gaussians = BigPoseGaussians(
            body.weights[used], self.vertex, big_pose_transforms(body), gaussians, nets
        )
        self.rest = Constants(big_pose_gaussians, (), bake)
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)

    def forward(self, *tensors: Tensor) -> Gaussians:
        """Return the posed Gaussians of all bodies, body after body."""
        joints, added = self.pose_blendshapes(self.actors.actor_from(tensors))
        weights, rest_position, root = self.rest()
        transforms = blend_transforms(joints, weights)
        position = rest_position + torch.index_select(added, 2, self.vertex)
        bodies = self.actors.bodies
        return Gaussians(
            position=planes_to_rows(transform_points(transforms, position)),
            opacity=repeat_rows(self.opacity, bodies),
            covariance=planes_to_rows(covariance(multiply_matrices(transforms, root))),
            sh=repeat_rows(self.sh, bodies),
        )


def big_pose_transforms(body: Body) -> Float[np.ndarray, "j 3 4"]:
    """Return the joint transforms from the rest pose to the big pose, for the mean shape."""
    rotations = rest_pose.rodrigues(rest_pose.big_pose(body))
    return rest_pose.joint_transforms(
        rotations, rest_pose.joints_of(body, np.zeros(0)), body.parents
    )
