"""GauHuman: Gaussians in a big pose that linear blend skinning moves, with learned corrections.

Hu, Hu and Liu 2024, "GauHuman: Articulated Gaussian Splatting from Monocular Human Videos":
equations 4 to 8 move a point from the big pose to the pose and its covariance with it, and a network
corrects each joint's turn. What does not change with the pose is baked: where each Gaussian was
before the big pose, and what it hangs on.
"""

__all__ = ["GauHuman"]

from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.avatars import rest
from gsgen.reference_plugins.avatars.actors import ActorInputs, Rotation
from gsgen.reference_plugins.avatars.follow import (
    applied,
    blended,
    covariance,
    multiplied,
    planes_from,
    repeated,
    rows_of,
)
from gsgen.reference_plugins.avatars.limbs import Limbs
from gsgen.reference_plugins.checkpoints.bodies import Body
from gsgen.reference_plugins.checkpoints.canonical import Canonical
from gsgen.reference_plugins.checkpoints.pose_nets import PoseNets, weight_offsets
from gsgen.sdk import GaussianGenerator, Gaussians

# Added to the skinning weights before their logarithm (GauHuman, scene/gaussian_model.py).
LEAST_WEIGHT = 1e-9


@final
class GauHuman(GaussianGenerator):
    """A person, or several of the same, who move as they are told."""

    family = "avatar"

    which: Tensor
    weights: Tensor
    root: Tensor
    place: Tensor
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
        """
        super().__init__()
        free = body.shape_dirs.shape[2] if shape is None else 0
        self.actors = ActorInputs(body.joints, rotation, shape=free, bodies=bodies)
        self.inputs = self.actors.declared()
        xyz = canonical.position.double().numpy()
        pose = rest.big_pose(body)
        vertex = rest.nearest(xyz, rest.posed_vertices(body, pose, np.zeros(0)))
        used, which = np.unique(vertex, return_inverse=True)
        weights = skinning_weights(body.weights[vertex], nets, canonical.position)
        there = np.einsum("nj,jab->nab", weights, big_transforms(body))
        back = np.linalg.inv(there[:, :, :3])
        place = np.einsum("nab,nb->na", back, xyz - there[:, :, 3])
        scale = np.exp(canonical.log_scale.double().numpy())
        turn = rest.rotation_of(canonical.rotation.double().numpy())
        baked = None if shape is None else np.asarray(shape)
        self.limbs = Limbs(body, used, baked, nets, add_hands=add_hands)
        self.register_buffer("which", torch.from_numpy(which.astype(np.int32)))
        self.register_buffer("weights", planes_from(weights))
        self.register_buffer("place", planes_from(place)[None])
        self.register_buffer("root", planes_from(back @ (turn * scale[:, None]))[None])
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)

    def forward(self, *given: Tensor) -> Gaussians:
        """Return the Gaussians of all bodies, body after body.

        Args:
            given: The declared inputs, in order.
        """
        joints, added = self.limbs(self.actors.taken(given))
        made = blended(joints, self.weights)
        place = self.place + torch.index_select(added, 2, self.which)
        bodies = self.actors.bodies
        return Gaussians(
            position=rows_of(applied(made, place)),
            opacity=repeated(self.opacity, bodies),
            covariance=rows_of(covariance(multiplied(made, self.root))),
            sh=repeated(self.sh, bodies),
        )


def big_transforms(body: Body) -> Float[np.ndarray, "j 3 4"]:
    """Return the transforms of a body without shape in the pose of training."""
    turns = rest.rodrigues(rest.big_pose(body))
    return rest.joint_transforms(turns, rest.joints_of(body, np.zeros(0)), body.parents)


def skinning_weights(
    weights: Float[np.ndarray, "n j"],
    nets: PoseNets | None,
    points: Float[Tensor, "n 3"],
) -> Float[np.ndarray, "n j"]:
    """Return the skinning weights of points, corrected by the network where there is one."""
    if nets is None:
        return weights
    logarithm = torch.from_numpy(np.log(weights + LEAST_WEIGHT))
    return torch.softmax(logarithm + weight_offsets(nets, points), dim=1).numpy()
