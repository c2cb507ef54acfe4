"""LHM: an avatar from one image, animated by SMPL-X poses.

Qiu et al. 2025, "LHM: Large Animatable Human Reconstruction Model from a Single Image in Seconds":
Gaussians on the surface of SMPL-X are transformed to the neutral pose, take the person's shape, and
follow the joints. Each rotates by the rotation nearest to its blended transform, and keeps its
scale.
"""

__all__ = ["LHM"]

from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Space
from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import PersonInputs
from gsgen.reference_plugins.bodies.rotations import nearest_rotation, rotation_matrices
from gsgen.reference_plugins.bodies.skinning import (
    blend_transforms,
    covariance,
    multiply_matrices,
    planes_to_rows,
    posed_transforms,
    repeat_rows,
    transform_points,
)
from gsgen.reference_plugins.bodies.skinning_weights import SurfaceGaussians
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
    """An LHM avatar, or several copies of it, whose SMPL-X poses are inputs of the model."""

    family = "avatar"
    space = Space(up="+y")

    joints: Tensor
    opacity: Tensor
    rgb: Tensor
    face: Tensor
    vertex: Tensor
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
        """Transform the Gaussians of an LHM avatar to the neutral pose, in the person's shape.

        Without ``face``, expressions are those of SMPL-X; ``bake`` is as in GauHuman.
        """
        super().__init__()
        body, betas = read.body, read.betas.double().numpy()
        self.actors = PersonInputs(
            joints=body.joints, expression=EXPRESSIONS if expression else 0, bodies=bodies
        )
        self.inputs = self.actors.declared()
        self.parents = body.parents
        used, vertex = np.unique(
            rest_pose.nearest(read.samples, body.template), return_inverse=True
        )
        register = self.register_buffer
        joints = rest_pose.joints_of(body, betas)
        register("joints", torch.from_numpy(joints.astype(np.float32)))
        register("vertex", torch.from_numpy(vertex.astype(np.int32)))
        neutral_transforms = read.neutral.double().numpy()[:, :3]
        surface_gaussians = SurfaceGaussians(
            body.weights[used],
            self.vertex,
            body.shape_dirs[used][:, :, : len(betas)] @ betas,
            read.stiff[used],
            neutral_transforms,
            (read.position, read.scale, read.rotation),
        )
        self.rest = Constants(surface_gaussians, (), bake)
        register("opacity", read.opacity)
        register("rgb", read.rgb)
        if expression:
            inverse_rotations = np.einsum(
                "uj,jab->uab", body.weights[used], neutral_transforms[:, :, :3]
            )
            self._register_face(expression_dirs(read, face)[used], inverse_rotations)

    def _register_face(
        self, dirs: Float[np.ndarray, "u 3 e"], inverse_rotations: Float[np.ndarray, "u 3 3"]
    ) -> None:
        """Store the expression offsets of the body vertices that any expression moves."""
        faces = np.flatnonzero(np.abs(dirs).max(axis=(1, 2)) > 0)
        # All Gaussians of a vertex share its weights, and so its transform to the neutral pose.
        neutral_dirs = np.einsum("fab,fbe->fae", inverse_rotations[faces], dirs[faces])
        zeros = np.zeros((1, 3, EXPRESSIONS))  # for the Gaussians of all other vertices
        table = np.concatenate([neutral_dirs, zeros]).transpose(2, 1, 0)
        number = np.full(len(dirs), len(faces), np.int32)
        number[faces] = np.arange(len(faces))
        flat_table = np.ascontiguousarray(table.reshape(EXPRESSIONS, -1), np.float32)
        self.register_buffer("face", torch.from_numpy(flat_table))
        self.register_buffer("number", torch.from_numpy(number))

    def forward(self, *tensors: Tensor) -> Gaussians:
        """Return the posed Gaussians of all bodies, body after body."""
        actor, bodies = self.actors.actor_from(tensors), self.actors.bodies
        joints = posed_transforms(
            rotation_matrices(actor.pose), self.joints, self.parents, None, actor.shift
        )
        weights, position, neutral_transforms, stiff, root = self.rest()
        transforms = blend_transforms(joints, weights)
        if actor.expression is not None:
            moved = (actor.expression @ self.face).reshape(bodies, 3, -1)
            number = torch.index_select(self.number, 0, self.vertex)
            position = position + torch.index_select(moved, 2, number)
        turn = nearest_rotation(multiply_matrices(transforms, neutral_transforms), stiff)
        return Gaussians(
            position=planes_to_rows(transform_points(transforms, position)),
            opacity=repeat_rows(self.opacity, bodies),
            covariance=planes_to_rows(covariance(multiply_matrices(turn, root))),
            rgb=repeat_rows(self.rgb, bodies),
        )


def expression_dirs(read: LHMCheckpoint, face: Face | None) -> Float[np.ndarray, "v 3 e"]:
    """Return the offset of each body vertex per expression coefficient."""
    last_expression = FIRST_EXPRESSION + EXPRESSIONS
    dirs = read.body.shape_dirs[:, :, FIRST_EXPRESSION:last_expression]
    if face is not None:
        dirs = dirs.copy()
        dirs[face.vertices] = face.dirs
    return dirs
