"""R3-Avatar: a GauHuman avatar whose Gaussians a hexplane changes from frame to frame.

Zhan et al. 2025, "R³-Avatar: Record and Retrieve Temporal Codebook for Reconstructing Photorealistic
Human Avatars": a frame's time determines offset, scale, rotation and opacity of every Gaussian, and
linear blend skinning moves it from the big pose. The offset changes the nearest vertex, so a table
holds the nearest vertex of each Gaussian in each frame.

In a pose that training did not see, each of five parts of the body takes the frame of a training
pose that is like it. A Gaussian's attributes are means over the parts, weighted by skinning weights.
"""

__all__ = ["BODY_PARTS", "R3Avatar"]

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.contract.spec.manifest import Space
from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import PersonInputs, Rotation
from gsgen.reference_plugins.bodies.pose_blendshapes import PoseBlendshapes
from gsgen.reference_plugins.bodies.pose_networks import weight_offsets
from gsgen.reference_plugins.bodies.skinning import (
    covariance,
    multiply_matrices,
    planes_to_rows,
    repeat_rows,
    transform_points,
)
from gsgen.reference_plugins.bodies.skinning_weights import MIN_SKINNING_WEIGHT, inverse
from gsgen.reference_plugins.people.appearance import Appearance
from gsgen.reference_plugins.people.gauhuman import big_pose_transforms
from gsgen.reference_plugins.people.r3_avatar_checkpoint import R3Checkpoint
from gsgen.reference_plugins.tensors.planes import rotation_columns
from gsgen.sdk import GaussianGenerator, Gaussians

BODY_PARTS = ("left_leg", "right_leg", "torso", "left_arm", "right_arm")
# The part of each joint of SMPL, and of the joints that SMPL-X has instead of SMPL's hands.
_PART_OF_JOINT = (2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 3, 4, 2, 3, 4, 3, 4, 3, 4)
_HANDS_OF_JOINTS = {24: (3, 4), 55: (2, 2, 2, *([3] * 15), *([4] * 15))}

# Decoded values (offset, root of the scale, rotation, opacity before the sigmoid), scale, vertex.
_AppearanceRow = tuple[Float[Tensor, "11 n"], Float[Tensor, "3 n"], Int[Tensor, " n"]]


@final
class R3Avatar(GaussianGenerator):
    """An R3-Avatar, or several copies of it; poses and training frames are inputs of the model."""

    family = "avatar"
    space = Space(up="+y")

    position: Tensor
    big: Tensor
    near: Tensor
    factor: Tensor
    vertex: Tensor
    sh: Tensor
    parts: Tensor | None
    rest: Tensor | None

    def __init__(
        self,
        read: R3Checkpoint,
        poses: Sequence[int],
        *,
        shape: Sequence[float] | None = None,
        rotation: Rotation = "matrix",
        bodies: int = 1,
        add_hands: bool = False,
        novel: bool = False,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Compute R3-Avatar's values for all training frames, such as the nearest body vertices.

        ``poses`` has the pose id of each frame; other options are as in GauHuman. With ``novel``,
        each part of the only body has a frame of its own. ``progress`` is called with the number of
        finished frames.
        """
        super().__init__()
        body = read.body
        free_shape_count = body.shape_dirs.shape[2] if shape is None else 0
        self.actors = PersonInputs(
            joints=body.joints, rotation=rotation, shape=free_shape_count, frames=len(poses), bodies=bodies,
            parts=BODY_PARTS if novel else (),
        )  # fmt: skip
        self.inputs = self.actors.declared()
        self.appearance = Appearance(read, poses)
        xyz = read.canonical.position
        rest = rest_pose.posed_vertices(body, rest_pose.big_pose(body), np.zeros(0))
        vertex = self._nearest_vertices(xyz.double().numpy(), rest, len(poses), progress)
        used, table_index = np.unique(vertex, return_inverse=True)
        baked_shape = None if shape is None else np.asarray(shape)
        self.pose_blendshapes = PoseBlendshapes(
            body, used, baked_shape, read.nets, add_hands=add_hands
        )
        offsets = weight_offsets(read.nets, xyz)
        # softmax(log w + b) = w eᵇ / Σ w eᵇ, so no logarithm is computed per frame.
        factor = torch.exp(offsets - offsets.max(dim=1, keepdim=True).values)
        register = self.register_buffer
        register("position", xyz.t().contiguous()[None])
        register("factor", factor.float())
        near = body.weights[used] + MIN_SKINNING_WEIGHT
        register("near", torch.from_numpy(near.astype(np.float32)))
        big = big_pose_transforms(body).reshape(body.joints, 12).astype(np.float32)
        ones_column = np.ones((body.joints, 1), np.float32)
        register("big", torch.from_numpy(np.concatenate([big, ones_column], axis=1)))
        # With many frames this is the largest table: int16, cast once when a runtime loads the model.
        numbers = table_index.reshape(vertex.shape).astype(np.int16)
        register("vertex", torch.from_numpy(numbers))
        register("sh", read.canonical.sh)
        joint_parts = np.array([*_PART_OF_JOINT, *_HANDS_OF_JOINTS[body.joints]])
        one_hot = np.eye(len(BODY_PARTS) + 1, dtype=np.float32)[joint_parts]
        one_hot[:, -1] = 1  # the sum of all weights
        register("parts", torch.from_numpy(one_hot) if novel else None)
        register("rest", torch.from_numpy(rest[used].astype(np.float32)) if novel else None)

    @torch.no_grad()
    def _nearest_vertices(
        self,
        xyz: Float[np.ndarray, "n 3"],
        rest: Float[np.ndarray, "v 3"],
        frames: int,
        progress: Callable[[int], None] | None,
    ) -> Int[np.ndarray, "f n"]:
        """Return the body vertex nearest to each Gaussian in each training frame."""
        from scipy.spatial import cKDTree

        tree = cKDTree(rest)
        vertices = []
        for frame in range(frames):
            frame_offset = self.appearance(torch.tensor([frame], dtype=torch.int32))[:3]
            vertices.append(tree.query(xyz + frame_offset.t().double().numpy())[1])
            if progress is not None:
                progress(frame + 1)
        return np.stack(vertices).astype(np.int64)

    def forward(self, *tensors: Tensor) -> Gaussians:
        """Return the posed Gaussians of all bodies, body after body."""
        actor = self.actors.actor_from(tensors)
        joints, added = self.pose_blendshapes(actor)
        assert actor.frame is not None
        appearance_rows = (
            [self._appearance_row(frame) for frame in actor.frame]
            if self.parts is None
            else [self._mixed_appearance(actor.frame)]
        )
        parts = [
            self._body_gaussians(*appearance_row, joints[index], added[index : index + 1])
            for index, appearance_row in enumerate(appearance_rows)
        ]
        position, opacity, covariance_planes = (
            body_rows[0] if len(body_rows) == 1 else torch.cat(body_rows)
            for body_rows in zip(*parts, strict=True)
        )
        return Gaussians(
            position=position,
            opacity=opacity,
            covariance=covariance_planes,
            sh=repeat_rows(self.sh, self.actors.bodies),
        )

    def _appearance_row(self, frame: Int[Tensor, "1"]) -> _AppearanceRow:
        """Return Gaussians' decoded attributes, scales and nearest vertices in a training frame."""
        attributes = self.appearance(frame)
        scale = attributes[3:6] * attributes[3:6]
        vertex = torch.index_select(self.vertex.to(torch.int32), 0, frame).reshape(-1)
        return attributes, scale, vertex

    def _mixed_appearance(self, frames: tuple[Int[Tensor, "1"], ...]) -> _AppearanceRow:
        """Return Gaussian attributes blended from several training frames, one for each body part.

        As in the published code, the last part's frame determines the weights of the parts. Of the
        vertices that are nearest in one of the frames, the one nearest to the mixed offset counts.
        """
        assert self.parts is not None
        assert self.rest is not None
        appearance_rows = [self._appearance_row(frame) for frame in frames]
        weights = torch.index_select(self.near, 0, appearance_rows[-1][2]) * self.factor
        part_shares = (weights @ self.parts).transpose(0, 1)
        part_shares = part_shares[:-1] / part_shares[-1:]
        mixed_values, mixed_scale = (part_shares[:1] * table for table in appearance_rows[0][:2])
        for index, (attributes, scale, _) in enumerate(appearance_rows[1:], 1):
            mixed_values = mixed_values + part_shares[index : index + 1] * attributes
            mixed_scale = mixed_scale + part_shares[index : index + 1] * scale
        point = (self.position[0] + mixed_values[:3]).transpose(0, 1)
        vertex = appearance_rows[0][2]
        nearest_distance = self._squared_distance(point, vertex)
        for _, _, candidate in appearance_rows[1:]:
            squared_distance = self._squared_distance(point, candidate)
            vertex = torch.where(squared_distance < nearest_distance, candidate, vertex)
            nearest_distance = torch.minimum(squared_distance, nearest_distance)
        return mixed_values, mixed_scale, vertex

    def _squared_distance(
        self, point: Float[Tensor, "n 3"], vertex: Int[Tensor, " n"]
    ) -> Float[Tensor, " n"]:
        """Return squared distances of points to vertices of the body in GauHuman's big pose."""
        assert self.rest is not None
        offset = point - torch.index_select(self.rest, 0, vertex)
        return (offset * offset).sum(dim=1)

    def _body_gaussians(
        self,
        attributes: Float[Tensor, "11 n"],
        scale: Float[Tensor, "3 n"],
        vertex: Int[Tensor, " n"],
        joints: Tensor,
        added: Float[Tensor, "1 3 u"],
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return position, opacity and covariance of the Gaussians of one body, as rows."""
        weights = torch.index_select(self.near, 0, vertex) * self.factor
        transform_table = torch.cat([joints.reshape(-1, 12), self.big], dim=1)
        mixed_values = (weights @ transform_table).transpose(0, 1)
        mixed_values = mixed_values[:24] / mixed_values[24:25]
        posed_transforms, big = mixed_values.reshape(2, 1, 3, 4, -1).unbind(dim=0)
        inverse_big_pose = inverse(big)
        position = self.position + attributes[None, :3] - big[:, :, 3]
        position = _rotate_points(inverse_big_pose, position) + torch.index_select(added, 2, vertex)
        columns = rotation_columns([attributes[index : index + 1] for index in range(6, 10)])
        turn = torch.stack([torch.cat(column) for column in columns], dim=1)
        root = multiply_matrices(
            posed_transforms, multiply_matrices(inverse_big_pose, (turn * scale[None])[None])
        )
        opacity = torch.sigmoid(attributes[10:11]).transpose(0, 1)
        return (
            planes_to_rows(transform_points(posed_transforms, position)),
            opacity,
            planes_to_rows(covariance(root)),
        )


def _rotate_points(
    matrix: Float[Tensor, "1 3 3 n"], point: Float[Tensor, "1 3 n"]
) -> Float[Tensor, "1 3 n"]:
    rotated_point = matrix[:, :, 0] * point[:, 0:1]
    for axis in (1, 2):
        rotated_point = rotated_point + matrix[:, :, axis] * point[:, axis : axis + 1]
    return rotated_point
