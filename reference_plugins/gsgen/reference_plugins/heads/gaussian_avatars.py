"""GaussianAvatars: Gaussians in the frames of a face model's triangles.

Qian et al. 2024, "GaussianAvatars: Photorealistic Head Avatars with Rigged 3D Gaussians", section
3.2: expression and pose move FLAME; a Gaussian moves, turns and scales with its triangle.
"""

__all__ = ["GaussianAvatars"]

from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Joint, Space
from gsgen.reference_plugins.bodies.rotations import rotation_matrices
from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import GaussianAvatarsCheckpoint
from gsgen.reference_plugins.heads.teeth import SHAPE_COUNT
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import (
    covariance_upper,
    rotate_covariance,
    safe_normalize,
    skin,
    skinning_transforms,
    transform_points,
)

_JOINT_NAMES = ("root", "neck", "jaw", "left_eye", "right_eye")


@final
class GaussianAvatars(GaussianGenerator):
    """GaussianAvatars: a head that expression, pose and translation move."""

    family = "avatar"
    space = Space(up="+y")

    joints: Tensor
    joint_dirs: Tensor
    rest: Tensor
    expression_dirs: Tensor
    pose_dirs: Tensor
    weights: Tensor
    unit: Tensor
    corner_0: Tensor
    corner_1: Tensor
    corner_2: Tensor
    binding: Tensor
    covariance: Tensor
    position: Tensor
    opacity: Tensor
    sh: Tensor

    def __init__(self, read: GaussianAvatarsCheckpoint) -> None:
        super().__init__()
        body, canonical = read.body, read.canonical
        dirs = body.shape_dirs
        expression_dirs = dirs[:, :, SHAPE_COUNT : SHAPE_COUNT + read.expressions]
        rest = body.template + dirs[:, :, : len(read.shape)] @ read.shape + read.offset
        joints = body.regressor @ rest
        self.parents = body.parents
        skeleton = [
            Joint(name, None if parent < 0 else _JOINT_NAMES[parent], (x, y, z))
            for name, parent, (x, y, z) in zip(
                _JOINT_NAMES, body.parents, joints.tolist(), strict=True
            )
        ]
        self.inputs = (
            inputs.pose(body.joints, convention="flame", skeleton=skeleton),
            inputs.expression(read.expressions, convention="flame"),
            inputs.root_translation(),
        )
        # Only triangles that Gaussians are bound to, and their vertices, are computed.
        triangles, binding = np.unique(read.binding, return_inverse=True)
        vertices, corners = np.unique(body.faces[triangles], return_inverse=True)
        corners = corners.reshape(-1, 3)
        used = expression_dirs[vertices]
        constants = {
            "joints": joints,
            "joint_dirs": np.einsum("jv,vae->eja", body.regressor, expression_dirs).reshape(
                read.expressions, -1
            ),
            "rest": rest[vertices],
            "expression_dirs": used.transpose(2, 0, 1).reshape(read.expressions, -1),
            "pose_dirs": body.pose_dirs[vertices]
            .transpose(2, 0, 1)
            .reshape(-1, used[:, :, 0].size),
            "weights": body.weights[vertices],
            "unit": np.eye(3)[None],
        }
        for name, array in constants.items():
            self.register_buffer(name, torch.from_numpy(np.ascontiguousarray(array)).float())
        for corner in range(3):
            index = torch.from_numpy(corners[:, corner].astype(np.int32))
            self.register_buffer(f"corner_{corner}", index)
        self.register_buffer("binding", torch.from_numpy(binding.reshape(-1).astype(np.int32)))
        scale = torch.exp(canonical.log_scale.double())
        local_covariance = covariance_upper(scale, canonical.rotation.double())
        self.register_buffer("covariance", local_covariance.float())
        self.register_buffer("position", canonical.position)
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)

    def forward(
        self,
        pose: Float[Tensor, "5 3"],
        expression: Float[Tensor, " e"],
        root_translation: Float[Tensor, "3"],
    ) -> Gaussians:
        """Return the Gaussians of the head for given expression, pose and root translation."""
        # Edges are differences of vertices: these keep more digits before the head is translated.
        frames, centres = self._triangle_transforms(self._vertices(pose, expression))
        centres = centres + root_translation.reshape(1, 3)
        rows = torch.cat([frames.flatten(1), centres], dim=1).index_select(0, self.binding)
        frame = rows[:, :9].reshape(-1, 3, 3)
        return Gaussians(
            position=transform_points(frame, self.position) + rows[:, 9:],
            opacity=self.opacity,
            covariance=rotate_covariance(self.covariance, frame),
            sh=self.sh,
        )

    def _vertices(self, pose: Tensor, expression: Tensor) -> Float[Tensor, "u 3"]:
        """Return FLAME's vertices before translation, by blendshapes and linear skinning."""
        row = expression.reshape(1, -1)
        joints = self.joints + (row @ self.joint_dirs).reshape(-1, 3)
        joint_matrices = rotation_matrices(pose[None])[0]
        feature = (joint_matrices[1:] - self.unit).reshape(1, -1)
        vertex_offsets = row @ self.expression_dirs + feature @ self.pose_dirs
        transforms = skinning_transforms(joint_matrices, joints, self.parents)
        return skin(self.rest + vertex_offsets.reshape(-1, 3), self.weights, transforms)[0]

    def _triangle_transforms(
        self, vertices: Float[Tensor, "u 3"]
    ) -> tuple[Float[Tensor, "f 3 3"], Float[Tensor, "f 3"]]:
        """Return each triangle's rotation times the mean of base and height, and its centroid."""
        a, b, c = (
            vertices.index_select(0, index)
            for index in (self.corner_0, self.corner_1, self.corner_2)
        )
        edge_ab, edge_ac = b - a, c - a
        first_axis = safe_normalize(edge_ab)
        second_axis = safe_normalize(_cross_product(first_axis, edge_ac))
        third_axis = -safe_normalize(_cross_product(second_axis, first_axis))
        length = torch.sqrt((edge_ab * edge_ab).sum(dim=1, keepdim=True))
        height = (third_axis * edge_ac).sum(dim=1, keepdim=True).abs()
        columns = torch.stack([first_axis, second_axis, third_axis], dim=2)
        return columns * ((length + height) / 2)[:, :, None], (a + b + c) / 3


def _cross_product(a: Float[Tensor, "n 3"], b: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    ax, ay, az = a[:, 0:1], a[:, 1:2], a[:, 2:3]
    bx, by, bz = b[:, 0:1], b[:, 1:2], b[:, 2:3]
    return torch.cat([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=1)
