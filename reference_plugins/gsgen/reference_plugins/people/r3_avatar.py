"""R3-Avatar: GauHuman's body, whose Gaussians a hexplane changes from frame to frame.

Zhan et al. 2025, "R³-Avatar: Record and Retrieve Temporal Codebook for Reconstructing Photorealistic
Human Avatars": a frame's time picks shift, scale, rotation and opacity of every Gaussian, and linear
blend skinning moves it from the big pose. As Gaussians shift, the vertex nearest to each changes
from frame to frame; frames are counted, so a table says which.
"""

__all__ = ["R3Avatar"]

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import ActorInputs, Rotation
from gsgen.reference_plugins.bodies.pose_blendshapes import Limbs
from gsgen.reference_plugins.bodies.pose_networks import weight_offsets
from gsgen.reference_plugins.bodies.skinning import (
    applied,
    covariance,
    multiplied,
    repeated,
    rows_of,
)
from gsgen.reference_plugins.bodies.skinning_weights import LEAST_WEIGHT, inverse
from gsgen.reference_plugins.people.appearance import Appearance
from gsgen.reference_plugins.people.gauhuman import big_transforms
from gsgen.reference_plugins.people.r3_avatar_checkpoint import R3Checkpoint
from gsgen.reference_plugins.tensors.planes import rotation_columns
from gsgen.sdk import GaussianGenerator, Gaussians


@final
class R3Avatar(GaussianGenerator):
    """A person, or several of the same, in the frames that training saw."""

    family = "avatar"

    position: Tensor
    big: Tensor
    near: Tensor
    factor: Tensor
    vertex: Tensor
    sh: Tensor

    def __init__(
        self,
        read: R3Checkpoint,
        poses: Sequence[int],
        *,
        shape: Sequence[float] | None = None,
        rotation: Rotation = "matrix",
        bodies: int = 1,
        add_hands: bool = False,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Find the nearest vertices of every frame.

        Args:
            read: The checkpoint.
            poses: The pose id of each frame that can be asked for.
            shape: Shape coefficients to bake; an input where absent.
            rotation: How the rotation of a body as a whole is given.
            bodies: How many there are.
            add_hands: Poses come without the mean pose of SMPL-X's hands.
            progress: Told after each frame how many are done.
        """
        super().__init__()
        body = read.body
        free = body.shape_dirs.shape[2] if shape is None else 0
        self.actors = ActorInputs(
            body.joints, rotation, shape=free, frames=len(poses), bodies=bodies
        )
        self.inputs = self.actors.declared()
        self.appearance = Appearance(read, poses)
        xyz = read.canonical.position
        vertex = self._nearest(xyz.double().numpy(), read, len(poses), progress)
        used, which = np.unique(vertex, return_inverse=True)
        baked = None if shape is None else np.asarray(shape)
        self.limbs = Limbs(body, used, baked, read.nets, add_hands=add_hands)
        offsets = weight_offsets(read.nets, xyz)
        # softmax(log w + b) is w eᵇ over its sum: logarithms are not taken every frame.
        factor = torch.exp(offsets - offsets.max(dim=1, keepdim=True).values)
        keep = self.register_buffer
        keep("position", xyz.t().contiguous()[None])
        keep("factor", factor.float())
        near = body.weights[used] + LEAST_WEIGHT
        keep("near", torch.from_numpy(near.astype(np.float32)))
        big = big_transforms(body).reshape(body.joints, 12).astype(np.float32)
        ones = np.ones((body.joints, 1), np.float32)
        keep("big", torch.from_numpy(np.concatenate([big, ones], axis=1)))
        # The largest table where frames are many; it is widened once, when a model is loaded.
        numbers = which.reshape(vertex.shape).astype(np.int16)
        keep("vertex", torch.from_numpy(numbers))
        keep("sh", read.canonical.sh)

    @torch.no_grad()
    def _nearest(
        self,
        xyz: Float[np.ndarray, "n 3"],
        read: R3Checkpoint,
        frames: int,
        progress: Callable[[int], None] | None,
    ) -> Int[np.ndarray, "f n"]:
        """Return the vertex nearest to each Gaussian where it is in each frame."""
        from scipy.spatial import cKDTree

        body = read.body
        tree = cKDTree(
            rest_pose.posed_vertices(body, rest_pose.big_pose(body), np.zeros(0))
        )
        made = []
        for frame in range(frames):
            shift = self.appearance(torch.tensor([frame], dtype=torch.int32))[:3]
            made.append(tree.query(xyz + shift.t().double().numpy())[1])
            if progress is not None:
                progress(frame + 1)
        return np.stack(made).astype(np.int64)

    def forward(self, *given: Tensor) -> Gaussians:
        """Return the Gaussians of all bodies, body after body.

        Args:
            given: The declared inputs, in order.
        """
        actor = self.actors.taken(given)
        joints, added = self.limbs(actor)
        assert actor.frame is not None
        parts = [
            self._moved(frame, joints[index], added[index : index + 1])
            for index, frame in enumerate(actor.frame)
        ]
        position, opacity, spread = (
            one[0] if len(one) == 1 else torch.cat(one) for one in zip(*parts, strict=True)
        )
        return Gaussians(
            position=position,
            opacity=opacity,
            covariance=spread,
            sh=repeated(self.sh, self.actors.bodies),
        )

    def _moved(
        self, frame: Int[Tensor, "1"], joints: Tensor, added: Float[Tensor, "1 3 u"]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return position, opacity and covariance of one body, as rows."""
        said = self.appearance(frame)
        vertex = torch.index_select(self.vertex.to(torch.int32), 0, frame).reshape(-1)
        weights = torch.index_select(self.near, 0, vertex) * self.factor
        maps = torch.cat([joints.reshape(-1, 12), self.big], dim=1)
        mixed = (weights @ maps).transpose(0, 1)
        mixed = mixed[:24] / mixed[24:25]
        there, big = mixed.reshape(2, 1, 3, 4, -1).unbind(dim=0)
        back = inverse(big)
        place = self.position + said[None, :3] - big[:, :, 3]
        place = _turned(back, place) + torch.index_select(added, 2, vertex)
        scale = said[3:6] * said[3:6]
        columns = rotation_columns([said[index : index + 1] for index in range(6, 10)])
        turn = torch.stack([torch.cat(column) for column in columns], dim=1)
        root = multiplied(there, multiplied(back, (turn * scale[None])[None]))
        opacity = torch.sigmoid(said[10:11]).transpose(0, 1)
        return rows_of(applied(there, place)), opacity, rows_of(covariance(root))


def _turned(
    matrix: Float[Tensor, "1 3 3 n"], point: Float[Tensor, "1 3 n"]
) -> Float[Tensor, "1 3 n"]:
    made = matrix[:, :, 0] * point[:, 0:1]
    for axis in (1, 2):
        made = made + matrix[:, :, axis] * point[:, axis : axis + 1]
    return made
