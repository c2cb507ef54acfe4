"""From a pose to the transforms of joints, and to what it adds to the vertices that are in use.

Both start from the turns of the joints, which GauHuman's network corrects. Vertices that no
Gaussian hangs on are left out.
"""

__all__ = ["Limbs"]

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.actors import Actor
from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_networks import PoseNets
from gsgen.reference_plugins.bodies.rotations import nearly_turned, turned
from gsgen.reference_plugins.bodies.skinning import chained
from gsgen.reference_plugins.tensors.layers import Dense


class Limbs(nn.Module):
    """Joints and the vertices that Gaussians hang on."""

    joints: Tensor
    joint_dirs: Tensor
    pose_dirs: Tensor
    shape_dirs: Tensor
    still: Tensor
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
        """Keep what concerns ``vertices``.

        Args:
            body: The body model.
            vertices: Which of its vertices are in use.
            shape: Shape coefficients to bake; an input where absent.
            nets: What corrects the turns of joints.
            add_hands: Poses come without the mean pose of the hands.
        """
        super().__init__()
        mean = body.hand_mean if add_hands else None
        before = np.zeros(3 * body.joints - (0 if mean is None else len(mean)))
        hands = None if mean is None else np.concatenate([before, mean]).reshape(1, -1, 3)
        self.register_buffer("hands", None if hands is None else _float(hands))
        self.parents = body.parents
        self.free = shape is None
        fixed = np.zeros(0) if shape is None else np.asarray(shape, np.float64)
        dirs, pose_dirs = body.shape_dirs[vertices], body.pose_dirs[vertices]
        # The Gaussians were trained in the big pose: what it had added is taken back.
        turns = rest_pose.rodrigues(rest_pose.big_pose(body))
        still = dirs[:, :, : len(fixed)] @ fixed - pose_dirs @ rest_pose.pose_feature(turns)
        keep = self.register_buffer
        keep("joints", _float(rest_pose.joints_of(body, fixed)))
        keep("still", _float(still.T)[None])
        keep("pose_dirs", _float(pose_dirs.transpose(2, 1, 0)).flatten(1))
        keep("unit", torch.eye(3)[None, None])
        if self.free:
            along = np.einsum("jv,vas->sja", body.regressor, body.shape_dirs)
            keep("joint_dirs", _float(along).flatten(1))
            keep("shape_dirs", _float(dirs.transpose(2, 1, 0)).flatten(1))
        layers = nets.pose if nets is not None else ()
        self.refiner = nn.ModuleList(Dense(*layer) for layer in layers)

    def forward(
        self, actor: Actor
    ) -> tuple[Float[Tensor, "k j 3 4"], Float[Tensor, "k 3 u"]]:
        """Return the joints' transforms and what is added to each vertex at rest."""
        pose = actor.pose if self.hands is None else actor.pose + self.hands
        turns = self._turns(pose)
        bodies = turns.shape[0]
        feature = (turns[:, 1:] - self.unit).reshape(bodies, -1)
        added = (feature @ self.pose_dirs).reshape(bodies, 3, -1) + self.still
        joints = self.joints
        if actor.shape is not None:
            shape = actor.shape.reshape(1, -1)
            added = added + (shape @ self.shape_dirs).reshape(1, 3, -1)
            joints = joints + (shape @ self.joint_dirs).reshape(-1, 3)
        return chained(turns, joints, self.parents, actor.turn, actor.shift), added

    def _turns(self, pose: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
        turns = turned(pose)
        if not len(self.refiner):
            return turns
        hidden = pose[:, 1:].reshape(pose.shape[0], -1)
        for index, layer in enumerate(self.refiner):
            hidden = layer(torch.relu(hidden) if index else hidden)
        more = nearly_turned(hidden.reshape(pose.shape[0], -1, 3))
        return torch.cat([turns[:, :1], turns[:, 1:] @ more], dim=1)


def _float(array: Float[np.ndarray, "..."]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, np.float32))
