"""Evaluates body models in float64 NumPy, for values that are computed once, at export.

The formulas are those of SMPL (Loper et al. 2015, equations 2 to 10): joints from vertices, joint
transforms from rotations, and vertices by linear blend skinning.
"""

__all__ = [
    "big_pose", "joint_transforms", "joints_of", "nearest", "pose_feature", "posed_vertices",
    "rodrigues",
]  # fmt: skip

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from gsgen.reference_plugins.bodies.body_models import Body

# Legs and arms apart: entry of the pose vector → degrees (GauHuman, dataset_readers.py).
_BIG_POSE_ANGLES = {5: 45.0, 8: -45.0, 23: -30.0, 26: 30.0}
_FIRST_HAND_VALUE = 75


def rodrigues(vectors: Float[np.ndarray, "j 3"]) -> Float[np.ndarray, "j 3 3"]:
    """Convert rotation vectors to matrices: I + sin θ K + (1 − cos θ) K²."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.maximum(angle, 1e-300)[:, None]
    x, y, z = axis.T
    zero = np.zeros_like(x)
    cross_matrices = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, one_minus_cosine = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    matrices: np.ndarray = (
        np.eye(3) + sine * cross_matrices + one_minus_cosine * (cross_matrices @ cross_matrices)
    )
    return matrices


def joints_of(body: Body, shape: Float[np.ndarray, " s"]) -> Float[np.ndarray, "j 3"]:
    """Return the joint positions of a body's rest pose for given shape coefficients."""
    used_dirs = body.shape_dirs[:, :, : len(shape)]
    joints: np.ndarray = body.regressor @ (body.template + used_dirs @ shape)
    return joints


def joint_transforms(
    rotations: Float[np.ndarray, "j 3 3"], joints: Float[np.ndarray, "j 3"], parents: Sequence[int]
) -> Float[np.ndarray, "j 3 4"]:
    """Return the transform [R | t] of each joint from the rest pose to the pose."""
    chain: list[np.ndarray] = []
    for joint, parent in enumerate(parents):
        local_transform = np.eye(4)
        local_transform[:3, :3] = rotations[joint]
        local_transform[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
        chain.append(chain[parent] @ local_transform if parent >= 0 else local_transform)
    transforms = np.stack(chain)[:, :3]
    transforms[:, :, 3] -= np.einsum("jab,jb->ja", transforms[:, :, :3], joints)
    return transforms


def pose_feature(rotations: Float[np.ndarray, "j 3 3"]) -> Float[np.ndarray, " p"]:
    """Return the coefficients of the pose blendshapes: R − I of all joints but the root."""
    return (rotations[1:] - np.eye(3)).ravel()


def posed_vertices(
    body: Body, pose: Float[np.ndarray, "j 3"], shape: Float[np.ndarray, " s"]
) -> Float[np.ndarray, "v 3"]:
    """Return the vertices of a body in a pose, by linear blend skinning."""
    rotations = rodrigues(pose)
    used_dirs = body.shape_dirs[:, :, : len(shape)]
    rest_vertices = body.template + used_dirs @ shape + body.pose_dirs @ pose_feature(rotations)
    transforms = joint_transforms(rotations, joints_of(body, shape), body.parents)
    blended_transforms = np.einsum("vj,jab->vab", body.weights, transforms)
    vertices: np.ndarray = (
        np.einsum("vab,vb->va", blended_transforms[:, :, :3], rest_vertices)
        + blended_transforms[:, :, 3]
    )
    return vertices


def big_pose(body: Body) -> Float[np.ndarray, "j 3"]:
    """Return the big pose of GauHuman's training: legs and arms apart.

    The hands of SMPL-X have their mean pose, if the file has one.
    """
    pose = np.zeros(3 * body.joints)
    for entry, degrees in _BIG_POSE_ANGLES.items():
        pose[entry] = np.deg2rad(degrees)
    if body.joints == 55 and body.hand_mean is not None:
        pose[_FIRST_HAND_VALUE:] = body.hand_mean
    return pose.reshape(-1, 3)


def nearest(
    points: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "v 3"]
) -> Int[np.ndarray, " n"]:
    """Return the index of the vertex nearest to each point."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(vertices).query(points)[1], np.int64)
