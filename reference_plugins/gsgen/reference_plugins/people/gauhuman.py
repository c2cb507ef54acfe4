"""GauHuman: Gaussians in a big pose that linear blend skinning moves, with learned corrections.

Hu, Hu and Liu 2024, "GauHuman: Articulated Gaussian Splatting from Monocular Human Videos":
equations 4 to 8 move a point from the big pose to the pose and its covariance with it, and a network
corrects each joint's turn. What does not change with the pose is baked: where each Gaussian was
before the big pose, and what it hangs on,
or the tables from which that follows.
"""

__all__ = ["GauHuman"]

from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import ActorInputs, Rotation
from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_blendshapes import Limbs
from gsgen.reference_plugins.bodies.pose_networks import PoseNets
from gsgen.reference_plugins.bodies.skinning import (
    applied,
    blended,
    covariance,
    multiplied,
    repeated,
    rows_of,
)
from gsgen.reference_plugins.bodies.skinning_weights import FromBigPose
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.tensors.baked_constants import Bake, Constants
from gsgen.sdk import GaussianGenerator, Gaussians


@final
class GauHuman(GaussianGenerator):
    """A person, or several of the same, who move as they are told."""

    family = "avatar"

    which: Tensor
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
        """Take the Gaussians out of the big pose.

        Args:
            canonical: The Gaussians in it.
            body: What they follow.
            nets: What corrects joints and weights.
            shape: Shape coefficients to bake; an input where absent.
            rotation: How the rotation of a body as a whole is given.
            bodies: How many there are.
            add_hands: Poses come without the mean pose of SMPL-X's hands.
            bake: Whether what follows from tables is stored, or the tables.
        """
        super().__init__()
        free = body.shape_dirs.shape[2] if shape is None else 0
        self.actors = ActorInputs(body.joints, rotation, shape=free, bodies=bodies)
        self.inputs = self.actors.declared()
        xyz = canonical.position.double().numpy()
        vertices = rest_pose.posed_vertices(body, rest_pose.big_pose(body), np.zeros(0))
        used, which = np.unique(rest_pose.nearest(xyz, vertices), return_inverse=True)
        baked = None if shape is None else np.asarray(shape)
        self.limbs = Limbs(body, used, baked, nets, add_hands=add_hands)
        self.register_buffer("which", torch.from_numpy(which.astype(np.int32)))
        scale = torch.exp(canonical.log_scale.double()).float()
        gaussians = (canonical.position, scale, canonical.rotation)
        hanging = FromBigPose(
            body.weights[used], self.which, big_transforms(body), gaussians, nets
        )
        self.rest = Constants(hanging, (), bake)
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)

    def forward(self, *given: Tensor) -> Gaussians:
        """Return the Gaussians of all bodies, body after body.

        Args:
            given: The declared inputs, in order.
        """
        joints, added = self.limbs(self.actors.taken(given))
        weights, rest_place, root = self.rest()
        made = blended(joints, weights)
        place = rest_place + torch.index_select(added, 2, self.which)
        bodies = self.actors.bodies
        return Gaussians(
            position=rows_of(applied(made, place)),
            opacity=repeated(self.opacity, bodies),
            covariance=rows_of(covariance(multiplied(made, root))),
            sh=repeated(self.sh, bodies),
        )


def big_transforms(body: Body) -> Float[np.ndarray, "j 3 4"]:
    """Return the transforms of a body without shape in the pose of training."""
    turns = rest_pose.rodrigues(rest_pose.big_pose(body))
    return rest_pose.joint_transforms(
        turns, rest_pose.joints_of(body, np.zeros(0)), body.parents
    )
