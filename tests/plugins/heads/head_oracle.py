"""What GaussianAvatars computes, vertex by vertex and Gaussian by Gaussian in float64."""

import numpy as np
import torch
from scipy.linalg import expm

from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import GaussianAvatarsCheckpoint
from support.checkpoints.plugin_oracles import ExpectedGaussians
from support.checkpoints.spacetime_oracles import rotation_matrix, upper


def _turn(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    matrix: np.ndarray = expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return matrix


def face_vertices(
    read: GaussianAvatarsCheckpoint, pose: np.ndarray, expression: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Return the vertices of FLAME (Li et al. 2017, equations 2 to 5)."""
    body = read.body
    shaped = body.template + read.offset
    shaped = shaped + body.shape_dirs[:, :, : len(read.shape)] @ read.shape
    shaped = shaped + body.shape_dirs[:, :, 300 : 300 + len(expression)] @ expression
    joints = body.regressor @ shaped
    turns = [_turn(vector) for vector in pose.astype(np.float64)]
    feature = np.concatenate([(turn - np.eye(3)).ravel() for turn in turns[1:]])
    posed_points = shaped + body.pose_dirs @ feature
    globals_: list[np.ndarray] = []
    for joint, parent in enumerate(body.parents):
        local = np.eye(4)
        local[:3, :3] = turns[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
        globals_.append(local if parent < 0 else globals_[parent] @ local)
    vertices = np.zeros_like(posed_points)
    for vertex, point in enumerate(posed_points):
        for joint, matrix in enumerate(globals_):
            moved = matrix[:3, :3] @ (point - joints[joint]) + matrix[:3, 3]
            vertices[vertex] += body.weights[vertex, joint] * moved
    return vertices + shift


def bound_gaussians(read: GaussianAvatarsCheckpoint, vertices: np.ndarray) -> ExpectedGaussians:
    """Return Gaussians in the frames of their triangles (Qian et al. 2024, section 3.2)."""
    canonical = read.canonical
    position, log_scale, rotation = (
        value.double().numpy()
        for value in (canonical.position, canonical.log_scale, canonical.rotation)
    )
    centers, covariances = [], []
    for row, triangle in enumerate(read.binding):
        a, b, c = vertices[read.body.faces[triangle]]
        edge = (b - a) / np.linalg.norm(b - a)
        normal = np.cross(edge, c - a)
        normal /= np.linalg.norm(normal)
        side = -np.cross(normal, edge)
        frame = np.stack([edge, normal, side], axis=1)
        scale = (np.linalg.norm(b - a) + abs(side @ (c - a))) / 2
        centers.append(scale * frame @ position[row] + (a + b + c) / 3)
        root = frame @ rotation_matrix(rotation[row]) @ np.diag(scale * np.exp(log_scale[row]))
        covariances.append(upper(root @ root.T))
    return ExpectedGaussians(
        np.ones(len(centers), bool),
        np.array(centers),
        torch.sigmoid(canonical.logit_opacity.double())[:, 0].numpy(),
        np.array(covariances),
        canonical.sh.double().flatten(1).numpy(),
    )
