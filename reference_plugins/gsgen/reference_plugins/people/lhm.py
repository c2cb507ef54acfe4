"""LHM: a person made from one picture, whom SMPL-X moves.

Qiu et al. 2025, "LHM: Large Animatable Human Reconstruction Model from a Single Image in Seconds":
Gaussians on the surface of SMPL-X go to the neutral pose, take the person's shape, and follow the
joints. Each turns by the rotation that is nearest to its blended transform, and keeps its scale.
"""

__all__ = ["LHM"]

from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import ActorInputs
from gsgen.reference_plugins.bodies.rotations import nearest_rotation, turned
from gsgen.reference_plugins.bodies.skinning import (
    applied,
    blended,
    chained,
    covariance,
    multiplied,
    repeated,
    rows_of,
)
from gsgen.reference_plugins.bodies.skinning_weights import FromSurface
from gsgen.reference_plugins.people.lhm_checkpoint import (
    EXPRESSIONS,
    FIRST_EXPRESSION,
    Face,
    LHMCheckpoint,
)
from gsgen.reference_plugins.tensors.baked_constants import Bake, Constants
from gsgen.sdk import GaussianGenerator, Gaussians


@final
class LHM(GaussianGenerator):
    """A person, or several of the same, who move as they are told."""

    family = "avatar"

    joints: Tensor
    opacity: Tensor
    rgb: Tensor
    face: Tensor
    which: Tensor
    number: Tensor

    def __init__(
        self,
        read: LHMCheckpoint,
        face: Face | None = None,
        *,
        expression: bool = True,
        bodies: int = 1,
        bake: Bake = "auto",
    ) -> None:
        """Bring the Gaussians to the neutral pose, in the person's shape.

        Args:
            read: The avatar.
            face: What expressions move; SMPL-X's own where absent.
            expression: Whether the expression is an input.
            bodies: How many there are.
            bake: Whether what follows from tables is stored, or the tables.
        """
        super().__init__()
        body, betas = read.body, read.betas.double().numpy()
        self.actors = ActorInputs(
            body.joints, expression=EXPRESSIONS if expression else 0, bodies=bodies
        )
        self.inputs = self.actors.declared()
        self.parents = body.parents
        used, which = np.unique(
            rest_pose.nearest(read.samples, body.template), return_inverse=True
        )
        keep = self.register_buffer
        joints = rest_pose.joints_of(body, betas)
        keep("joints", torch.from_numpy(joints.astype(np.float32)))
        keep("which", torch.from_numpy(which.astype(np.int32)))
        neutral = read.neutral.double().numpy()[:, :3]
        hanging = FromSurface(
            body.weights[used],
            self.which,
            body.shape_dirs[used][:, :, : len(betas)] @ betas,
            read.stiff[used],
            neutral,
            (read.position, read.scale, read.rotation),
        )
        self.rest = Constants(hanging, (), bake)
        keep("opacity", read.opacity)
        keep("rgb", read.rgb)
        if expression:
            back = np.einsum("uj,jab->uab", body.weights[used], neutral[:, :, :3])
            self._keep_face(body_dirs(read, face)[used], back)

    def _keep_face(
        self, dirs: Float[np.ndarray, "u 3 e"], back: Float[np.ndarray, "u 3 3"]
    ) -> None:
        """Keep what expressions add to the vertices that some expression moves, and which they are."""
        faces = np.flatnonzero(np.abs(dirs).max(axis=(1, 2)) > 0)
        # All Gaussians of a vertex share its weights, and so its way to the neutral pose.
        there = np.einsum("fab,fbe->fae", back[faces], dirs[faces])
        still = np.zeros((1, 3, EXPRESSIONS))  # what most Gaussians find
        table = np.concatenate([there, still]).transpose(2, 1, 0)
        number = np.full(len(dirs), len(faces), np.int32)
        number[faces] = np.arange(len(faces))
        flat = np.ascontiguousarray(table.reshape(EXPRESSIONS, -1), np.float32)
        self.register_buffer("face", torch.from_numpy(flat))
        self.register_buffer("number", torch.from_numpy(number))

    def forward(self, *given: Tensor) -> Gaussians:
        """Return the Gaussians of all bodies, body after body.

        Args:
            given: The declared inputs, in order.
        """
        actor, bodies = self.actors.taken(given), self.actors.bodies
        joints = chained(turned(actor.pose), self.joints, self.parents, None, actor.shift)
        weights, place, neutral, stiff, root = self.rest()
        made = blended(joints, weights)
        if actor.expression is not None:
            moved = (actor.expression @ self.face).reshape(bodies, 3, -1)
            number = torch.index_select(self.number, 0, self.which)
            place = place + torch.index_select(moved, 2, number)
        turn = nearest_rotation(multiplied(made, neutral), stiff)
        return Gaussians(
            position=rows_of(applied(made, place)),
            opacity=repeated(self.opacity, bodies),
            covariance=rows_of(covariance(multiplied(turn, root))),
            rgb=repeated(self.rgb, bodies),
        )


def body_dirs(read: LHMCheckpoint, face: Face | None) -> Float[np.ndarray, "v 3 e"]:
    """Return what expressions add to the vertices of the body."""
    last = FIRST_EXPRESSION + EXPRESSIONS
    dirs = read.body.shape_dirs[:, :, FIRST_EXPRESSION:last]
    if face is not None:
        dirs = dirs.copy()
        dirs[face.vertices] = face.dirs
    return dirs
