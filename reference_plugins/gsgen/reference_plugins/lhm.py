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

from gsgen.reference_plugins.avatars import rest
from gsgen.reference_plugins.avatars.actors import ActorInputs
from gsgen.reference_plugins.avatars.follow import (
    applied,
    blended,
    chained,
    covariance,
    multiplied,
    planes_from,
    repeated,
    rows_of,
)
from gsgen.reference_plugins.avatars.turns import nearest_rotation, turned
from gsgen.reference_plugins.checkpoints.lhm import (
    EXPRESSIONS,
    FIRST_EXPRESSION,
    Face,
    LHMCheckpoint,
)
from gsgen.sdk import GaussianGenerator, Gaussians


@final
class LHM(GaussianGenerator):
    """A person, or several of the same, who move as they are told."""

    family = "avatar"

    joints: Tensor
    weights: Tensor
    place: Tensor
    neutral: Tensor
    stiff: Tensor
    root: Tensor
    opacity: Tensor
    rgb: Tensor
    face: Tensor
    which: Tensor

    def __init__(
        self,
        read: LHMCheckpoint,
        face: Face | None = None,
        *,
        expression: bool = True,
        bodies: int = 1,
    ) -> None:
        """Bring the Gaussians to the neutral pose, in the person's shape.

        Args:
            read: The avatar.
            face: What expressions move; SMPL-X's own where absent.
            expression: Whether the expression is an input.
            bodies: How many there are.
        """
        super().__init__()
        body, betas = read.body, read.betas.double().numpy()
        self.actors = ActorInputs(
            body.joints, expression=EXPRESSIONS if expression else 0, bodies=bodies
        )
        self.inputs = self.actors.declared()
        self.parents = body.parents
        vertex = rest.nearest(read.samples, body.template)
        weights = body.weights[vertex]
        back = np.einsum("nj,jab->nab", weights, read.neutral.double().numpy()[:, :3])
        place = np.einsum("nab,nb->na", back[:, :, :3], read.position.double().numpy())
        place += back[:, :, 3] + body.shape_dirs[vertex][:, :, : len(betas)] @ betas
        scale, turn = read.scale.double().numpy(), read.rotation.double().numpy()
        keep = self.register_buffer
        joints = rest.joints_of(body, betas)
        keep("joints", torch.from_numpy(joints.astype(np.float32)))
        keep("weights", planes_from(weights))
        keep("place", planes_from(place)[None])
        keep("neutral", planes_from(back[:, :, :3])[None])
        keep("stiff", torch.from_numpy(read.stiff[vertex].astype(np.float32)[None]))
        keep("root", planes_from(rest.rotation_of(turn) * scale[:, None])[None])
        keep("opacity", read.opacity)
        keep("rgb", read.rgb)
        if expression:
            self._keep_face(body_dirs(read, face), vertex, back[:, :, :3])

    def _keep_face(
        self,
        dirs: Float[np.ndarray, "v 3 e"],
        vertex: Float[np.ndarray, " n"],
        back: Float[np.ndarray, "n 3 3"],
    ) -> None:
        """Keep the vertices that some expression moves, and which of them each Gaussian is at."""
        moved = np.abs(dirs).max(axis=(1, 2)) > 0
        used, first, which = np.unique(vertex, return_index=True, return_inverse=True)
        faces = np.flatnonzero(moved[used])
        # All Gaussians of a vertex share its weights, and so its way to the neutral pose.
        there = np.einsum("fab,fbe->fae", back[first[faces]], dirs[used[faces]])
        still = np.zeros((1, 3, EXPRESSIONS))  # what most Gaussians find
        table = np.concatenate([there, still]).transpose(2, 1, 0)
        number = np.full(len(used), len(faces), np.int32)
        number[faces] = np.arange(len(faces))
        flat = np.ascontiguousarray(table.reshape(EXPRESSIONS, -1), np.float32)
        self.register_buffer("face", torch.from_numpy(flat))
        self.register_buffer("which", torch.from_numpy(number[which]))

    def forward(self, *given: Tensor) -> Gaussians:
        """Return the Gaussians of all bodies, body after body.

        Args:
            given: The declared inputs, in order.
        """
        actor, bodies = self.actors.taken(given), self.actors.bodies
        joints = chained(turned(actor.pose), self.joints, self.parents, None, actor.shift)
        made, place = blended(joints, self.weights), self.place
        if actor.expression is not None:
            moved = (actor.expression @ self.face).reshape(bodies, 3, -1)
            place = place + torch.index_select(moved, 2, self.which)
        turn = nearest_rotation(multiplied(made, self.neutral), self.stiff)
        return Gaussians(
            position=rows_of(applied(made, place)),
            opacity=repeated(self.opacity, bodies),
            covariance=rows_of(covariance(multiplied(turn, self.root))),
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
