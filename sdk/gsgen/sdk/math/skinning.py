"""Linear blend skinning: Gaussians follow rotating joints by their skinning weights.

A kinematic chain is a loop over joints, which graph capture does not support. Here every joint's
transform is multiplied by that of its parent, the products by those of their parents, and so on.
After k rounds of one gather and one batched product, 2ᵏ joints of a chain are combined (pointer
jumping), so the 24 joints of SMPL need four rounds.
"""

__all__ = ["NO_PARENT_JOINT", "skin", "skinning_transforms", "smpl_chain"]

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.math.rotations import transform_points

# The number for "no parent" in kinematic trees that are stored as unsigned integers.
NO_PARENT_JOINT = (1 << 32) - 1


def skinning_transforms(
    turns: Float[Tensor, "j 3 3"],
    joints: Float[Tensor, "j 3"],
    parents: Sequence[int],
    translation: Float[Tensor, "3"] | None = None,
) -> Float[Tensor, "j 3 4"]:
    """Return each joint's transform from the rest pose to the pose (Loper et al. 2015, "SMPL").

    Args:
        turns: Rotation of each joint in its parent's frame; see
            :func:`gsgen.sdk.math.axis_angle_to_matrix`.
        joints: Joint positions in the rest pose.
        parents: The parent of each joint; −1 for a root.
        translation: Added to the whole body.

    Returns:
        [R | t] of every joint, so that a point p of the rest pose moves to R p + t.

    Raises:
        GeneratorInvalid: The parents have another number, are not joints, or form a cycle.
    """
    count = turns.shape[0]
    parent_indices = _parent_indices(parents, count, tuple(joints.shape))
    chain = _chain_transforms(_local_transforms(turns, joints, parent_indices), parent_indices)
    rotation, origin = chain[:, :3, :3], chain[:, :3, 3:4]
    translations = origin - (rotation * joints[:, None, :]).sum(dim=2, keepdim=True)
    if translation is not None:
        translations = translations + translation.reshape(1, 3, 1)
    return torch.cat([rotation, translations], dim=2)


def smpl_chain(
    turns: Float[Tensor, "j 3 3"], joints: Float[Tensor, "j 3"], parents: Sequence[int] | Tensor
) -> tuple[Float[Tensor, "j 3"], Float[Tensor, "j 4 4"]]:
    """Return the posed joints and their transforms, as SMPL's code does (Loper et al. 2015, eq. 4).

    It takes the place of ``batch_rigid_transform`` in ``smplx.lbs``, without the batch axis.

    Args:
        turns: Rotation of each joint in its parent's frame.
        joints: Joint positions in the rest pose.
        parents: The parent of each joint; −1 for a root. A tensor must be a constant.

    Returns:
        The joints in the pose, and matrices that move homogeneous points of the rest pose.

    Raises:
        GeneratorInvalid: The parents have another number, are not joints, or form a cycle.
    """
    indices = parents.tolist() if isinstance(parents, Tensor) else parents
    transforms = skinning_transforms(turns, joints, indices)
    posed = transform_points(transforms[:, :, :3], joints) + transforms[:, :, 3]
    last_row = torch.eye(4, dtype=turns.dtype, device=turns.device)[3].expand(len(joints), 1, 4)
    return posed, torch.cat([transforms, last_row], dim=1)


def skin(
    position: Float[Tensor, "n 3"],
    weights: Float[Tensor, "n j"],
    transforms: Float[Tensor, "j 3 4"],
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3 3"]]:
    """Move points with the joints, by their skinning weights.

    Args:
        position: Points of the rest pose.
        weights: Skinning weight of each joint for each point; rows add up to 1.
        transforms: The result of :func:`skinning_transforms`.

    Returns:
        The points in the pose, and each point's blended linear map for
        :func:`gsgen.sdk.math.rotate_covariance`.
    """
    blended_transforms = (weights @ transforms.reshape(-1, 12)).reshape(-1, 3, 4)
    rotation, translations = blended_transforms[:, :, :3], blended_transforms[:, :, 3]
    return transform_points(rotation, position) + translations, rotation


def _local_transforms(
    turns: Tensor, joints: Tensor, parents: Sequence[int]
) -> Float[Tensor, "j 4 4"]:
    """Return each joint's rigid transform in the frame of its parent joint."""
    origin = torch.cat([joints, torch.zeros_like(joints[:1])], dim=0)
    offset = joints - origin.index_select(0, _index_tensor(parents, joints))
    last = torch.eye(4, dtype=turns.dtype, device=turns.device)[3].expand(len(parents), 1, 4)
    return torch.cat([torch.cat([turns, offset[:, :, None]], dim=2), last], dim=1)


def _chain_transforms(
    local_transforms: Float[Tensor, "j 4 4"], parents: Sequence[int]
) -> Float[Tensor, "j 4 4"]:
    """Multiply each joint's local transform by those of all its ancestors."""
    root = torch.eye(4, dtype=local_transforms.dtype, device=local_transforms.device)[None]
    transforms = torch.cat([local_transforms, root], dim=0)
    for ancestors in _ancestor_rounds(parents):
        transforms = (
            transforms.index_select(0, _index_tensor(ancestors, local_transforms)) @ transforms
        )
    return transforms[: len(parents)]


def _ancestor_rounds(parents: Sequence[int]) -> Iterator[list[int]]:
    """Yield each joint's ancestor 1, 2, 4, … levels up; the joint count means no ancestor."""
    root_parent_index = len(parents)
    ancestors = [*parents, root_parent_index]
    while any(ancestor != root_parent_index for ancestor in ancestors):
        yield ancestors
        ancestors = [ancestors[ancestor] for ancestor in ancestors]


def _index_tensor(values: Sequence[int], reference_tensor: Tensor) -> Tensor:
    return torch.tensor(list(values), dtype=torch.int32, device=reference_tensor.device)


def _parent_indices(parents: Sequence[int], count: int, shape: tuple[int, ...]) -> list[int]:
    """Validate and return the parent index of each joint; a root's becomes the joint count."""
    where = "skinning_transforms, parents"
    if len(parents) != count or shape != (count, 3):
        message = (
            f"{count} rotations, {len(parents)} parents and joint positions of shape {list(shape)}"
        )
        raise GeneratorInvalid(f"{message} differ in number", where=where)
    for joint, parent in enumerate(parents):
        if parent not in (-1, NO_PARENT_JOINT) and not 0 <= parent < count:
            message = f"joint {joint} has parent {parent}, expected -1 to {count - 1}"
            raise GeneratorInvalid(message, where=where)
    indices = [
        count if parent_index in (-1, NO_PARENT_JOINT) else int(parent_index)
        for parent_index in parents
    ]
    for joint in range(count):
        steps, ancestor = 0, joint
        while ancestor != count:
            ancestor, steps = indices[ancestor], steps + 1
            if steps > count:
                raise GeneratorInvalid(f"joint {joint} is its own ancestor", where=where)
    return indices
