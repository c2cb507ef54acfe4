"""Computes joint transforms and blendshape offsets of vertices from a pose (SMPL).

Both start from the rotations of the joints, which GauHuman's network corrects. Vertices without a
Gaussian are left out.
"""

__all__ = ["PoseBlendshapes"]

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import AnimatedPerson
from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_networks import PoseNets
from gsgen.reference_plugins.bodies.rotations import gauhuman_rotation_matrices, rotation_matrices
from gsgen.reference_plugins.bodies.skinning import posed_transforms
from gsgen.reference_plugins.tensors.layers import Dense


class PoseBlendshapes(nn.Module):
    """Pose and shape blendshapes of the vertices that Gaussians are attached to."""

    joints: Tensor
    joint_dirs: Tensor
    pose_dirs: Tensor
    shape_dirs: Tensor
    offset: Tensor
    unit: Tensor
    hands: Tensor | None

    def __init__(
        self,
        body: Body,
        vertices: Int[np.ndarray, " u"],
        shape: Float[np.ndarray, " s"] | None,
        nets: PoseNets | None,
        *,
        add_hands: bool = False,
    ) -> None:
        """Store the blendshapes of selected vertices of a body model.

        Without ``shape``, the shape coefficients are an input; ``add_hands`` adds the mean pose of
        the hands to poses.
        """
        super().__init__()
        mean = body.hand_mean if add_hands else None
        zero_pose = np.zeros(3 * body.joints - (0 if mean is None else len(mean)))
        hands = None if mean is None else np.concatenate([zero_pose, mean]).reshape(1, -1, 3)
        self.register_buffer("hands", None if hands is None else _float_tensor(hands))
        self.parents = body.parents
        self.is_shape_free = shape is None
        fixed_shape = np.zeros(0) if shape is None else np.asarray(shape, np.float64)
        dirs, pose_dirs = body.shape_dirs[vertices], body.pose_dirs[vertices]
        # The Gaussians were trained in the big pose: subtract its pose blendshapes.
        joint_matrices = rest_pose.rodrigues(rest_pose.big_pose(body))
        offsets = dirs[:, :, : len(fixed_shape)] @ fixed_shape - pose_dirs @ rest_pose.pose_feature(
            joint_matrices
        )
        register = self.register_buffer
        register("joints", _float_tensor(rest_pose.joints_of(body, fixed_shape)))
        register("offset", _float_tensor(offsets.T)[None])
        register("pose_dirs", _float_tensor(pose_dirs.transpose(2, 1, 0)).flatten(1))
        register("unit", torch.eye(3)[None, None])
        if self.is_shape_free:
            joint_shape_dirs = np.einsum("jv,vas->sja", body.regressor, body.shape_dirs)
            register("joint_dirs", _float_tensor(joint_shape_dirs).flatten(1))
            register("shape_dirs", _float_tensor(dirs.transpose(2, 1, 0)).flatten(1))
        layers = nets.pose if nets is not None else ()
        self.refiner = nn.ModuleList(Dense(*layer) for layer in layers)

    def forward(
        self, actor: AnimatedPerson
    ) -> tuple[Float[Tensor, "k j 3 4"], Float[Tensor, "k 3 u"]]:
        """Return joint transforms, and the offsets of each template vertex by pose and shape."""
        pose = actor.pose if self.hands is None else actor.pose + self.hands
        joint_matrices = self._joint_rotations(pose)
        bodies = joint_matrices.shape[0]
        feature = (joint_matrices[:, 1:] - self.unit).reshape(bodies, -1)
        pose_offsets = (feature @ self.pose_dirs).reshape(bodies, 3, -1) + self.offset
        joints = self.joints
        if actor.shape is not None:
            shape = actor.shape.reshape(1, -1)
            pose_offsets = pose_offsets + (shape @ self.shape_dirs).reshape(1, 3, -1)
            joints = joints + (shape @ self.joint_dirs).reshape(-1, 3)
        return posed_transforms(
            joint_matrices, joints, self.parents, actor.turn, actor.shift
        ), pose_offsets

    def _joint_rotations(self, pose: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
        joint_matrices = rotation_matrices(pose)
        if not len(self.refiner):
            return joint_matrices
        hidden = pose[:, 1:].reshape(pose.shape[0], -1)
        for index, layer in enumerate(self.refiner):
            hidden = layer(torch.relu(hidden) if index else hidden)
        corrections = gauhuman_rotation_matrices(hidden.reshape(pose.shape[0], -1, 3))
        return torch.cat([joint_matrices[:, :1], joint_matrices[:, 1:] @ corrections], dim=1)


def _float_tensor(array: Float[np.ndarray, "..."]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, np.float32))
