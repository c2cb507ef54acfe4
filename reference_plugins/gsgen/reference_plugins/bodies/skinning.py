"""Moves Gaussians with the joints of K bodies (linear blend skinning), ready for graph capture.

Tensors are planes [K, …, N], so every step is a kernel over contiguous memory, and one product
applies the skinning weights to all bodies. Root rotation and translation are part of the joint
transforms, so they cost nothing per Gaussian.
"""

__all__ = [
    "blend_transforms", "covariance", "multiply_matrices", "planes_to_rows", "posed_transforms",
    "repeat_rows", "transform_points",
]  # fmt: skip

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.layout import UPPER_TRIANGLE
from gsgen.sdk.math import skinning_transforms


def posed_transforms(
    rotations: Float[Tensor, "k j 3 3"],
    joints: Float[Tensor, "j 3"],
    parents: Sequence[int],
    root_rotation: Float[Tensor, "k 3 3"] | None = None,
    root_translation: Float[Tensor, "k 3"] | None = None,
) -> Float[Tensor, "k j 3 4"]:
    """Return the rigid transforms of all joints, followed by root rotation and translation.

    ``rotations`` are in the parent's frame, and ``joints`` in the rest pose. Without ``root_rotation``, the root
    joint's rotation is the only one.
    """
    bodies, count = rotations.shape[:2]
    # All bodies form one forest, so their chains are multiplied in the same rounds.
    parent_forest = [p if p < 0 else p + count * body for body in range(bodies) for p in parents]
    rest_joints = joints if bodies == 1 else torch.cat([joints] * bodies, dim=0)
    transforms = skinning_transforms(rotations.reshape(-1, 3, 3), rest_joints, parent_forest)
    transforms = transforms.reshape(bodies, count, 3, 4)
    if root_rotation is not None:
        transforms = root_rotation[:, None] @ transforms
    if root_translation is None:
        return transforms
    translation = transforms[:, :, :, 3:] + root_translation[:, None, :, None]
    return torch.cat([transforms[:, :, :, :3], translation], dim=3)


def blend_transforms(
    transforms: Float[Tensor, "k j 3 4"], weights: Float[Tensor, "j n"]
) -> Float[Tensor, "k 3 4 n"]:
    """Return each Gaussian's blended transform: the joint transforms, averaged by weights."""
    bodies, joints = transforms.shape[:2]
    flat_transforms = transforms.reshape(bodies, joints, 12).transpose(1, 2)
    return (flat_transforms @ weights).reshape(bodies, 3, 4, -1)


def transform_points(
    transform: Float[Tensor, "k 3 4 n"], point: Float[Tensor, "*k 3 n"]
) -> Float[Tensor, "k 3 n"]:
    """Apply a transform [R | t] to each point."""
    translation_part = transform[:, :, 3]
    for axis in range(3):
        translation_part = translation_part + transform[:, :, axis] * point[:, axis : axis + 1]
    return translation_part


def multiply_matrices(
    left_matrix: Float[Tensor, "k 3 c n"], right_matrix: Float[Tensor, "*k 3 3 n"]
) -> Float[Tensor, "k 3 3 n"]:
    """Multiply two 3×3 matrices per Gaussian; a translation column in ``left_matrix`` is ignored."""
    product = left_matrix[:, :, 0:1] * right_matrix[:, 0:1]
    for axis in (1, 2):
        product = product + left_matrix[:, :, axis : axis + 1] * right_matrix[:, axis : axis + 1]
    return product


def covariance(root: Float[Tensor, "k 3 3 n"]) -> Float[Tensor, "k 6 n"]:
    """Return the covariance M Mᵀ of a matrix M, as components xx, xy, xz, yy, yz, zz."""
    rows = root.unbind(dim=1)
    return torch.stack([(rows[a] * rows[b]).sum(dim=1) for a, b in UPPER_TRIANGLE], dim=1)


def planes_to_rows(planes: Float[Tensor, "k c n"]) -> Float[Tensor, "m c"]:
    """Convert one tensor per component (planes) to rows of Gaussians, body after body."""
    return planes.transpose(1, 2).reshape(-1, planes.shape[1])


def repeat_rows(rows: Float[Tensor, "n ..."], bodies: int) -> Float[Tensor, "m ..."]:
    """Repeat the rows of Gaussians, which are stored once, for each of K bodies."""
    return rows if bodies == 1 else torch.cat([rows] * bodies, dim=0)
