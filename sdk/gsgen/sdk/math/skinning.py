"""Linear blend skinning: joints turn, and Gaussians follow the joints they hang on.

A kinematic chain is a loop over joints, and graph capture knows no loops. Here every joint's
transform is multiplied by that of its parent, the products by those of their parents, and so on:
after k rounds of one gather and one batched product each, 2ᵏ joints of the chain are joined (pointer
jumping), so the 24 joints of SMPL take four rounds.
"""

__all__ = ["skin", "skinning_transforms"]

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid

# What stands for "no parent" in kinematic trees that were stored as unsigned integers.
_NO_PARENT = (1 << 32) - 1


def skinning_transforms(
    turns: Float[Tensor, "j 3 3"],
    joints: Float[Tensor, "j 3"],
    parents: Sequence[int],
    translation: Float[Tensor, "3"] | None = None,
) -> Float[Tensor, "j 3 4"]:
    """Return the map of each joint from the rest pose to the pose (Loper et al. 2015, "SMPL").

    Args:
        turns: Rotation of each joint in its parent's frame; see
            :func:`gsgen.sdk.math.axis_angle_to_matrix`.
        joints: Where the joints are at rest.
        parents: The parent of each joint; −1 for a root.
        translation: Added to the whole body.

    Returns:
        [R | t] of every joint, so that a point p of the rest pose goes to R p + t.

    Raises:
        GeneratorInvalid: The parents are of another number, are none, or form a circle.
    """
    count = turns.shape[0]
    known = _checked(parents, count, tuple(joints.shape))
    chain = _chained(_local(turns, joints, known), known)
    turn, place = chain[:, :3, :3], chain[:, :3, 3:4]
    shift = place - (turn * joints[:, None, :]).sum(dim=2, keepdim=True)
    if translation is not None:
        shift = shift + translation.reshape(1, 3, 1)
    return torch.cat([turn, shift], dim=2)


def skin(
    position: Float[Tensor, "n 3"],
    weights: Float[Tensor, "n j"],
    transforms: Float[Tensor, "j 3 4"],
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3 3"]]:
    """Move points with the joints they hang on.

    Args:
        position: Points of the rest pose.
        weights: How much each point hangs on each joint; rows add up to 1.
        transforms: What :func:`skinning_transforms` returns.

    Returns:
        The points in the pose, and each point's blended linear map, by which
        :func:`gsgen.sdk.math.rotate_covariance` turns its Gaussian.
    """
    blended = (weights @ transforms.reshape(-1, 12)).reshape(-1, 3, 4)
    turn, shift = blended[:, :, :3], blended[:, :, 3]
    return (turn * position[:, None, :]).sum(dim=2) + shift, turn


def _local(turns: Tensor, joints: Tensor, parents: Sequence[int]) -> Float[Tensor, "j 4 4"]:
    """Return each joint's transform in its parent's frame."""
    origin = torch.cat([joints, torch.zeros_like(joints[:1])], dim=0)
    offset = joints - origin.index_select(0, _indices(parents, joints))
    last = torch.eye(4, dtype=turns.dtype, device=turns.device)[3].expand(
        len(parents), 1, 4
    )
    return torch.cat([torch.cat([turns, offset[:, :, None]], dim=2), last], dim=1)


def _chained(
    local: Float[Tensor, "j 4 4"], parents: Sequence[int]
) -> Float[Tensor, "j 4 4"]:
    """Multiply every transform by those of all its ancestors."""
    root = torch.eye(4, dtype=local.dtype, device=local.device)[None]
    made = torch.cat([local, root], dim=0)
    for ancestors in _jumps(parents):
        made = made.index_select(0, _indices(ancestors, local)) @ made
    return made[: len(parents)]


def _jumps(parents: Sequence[int]) -> Iterator[list[int]]:
    """Yield, for each round, the joint whose product comes before each; the last means none."""
    none = len(parents)
    ancestors = [*parents, none]
    while any(one != none for one in ancestors):
        yield ancestors
        ancestors = [ancestors[one] for one in ancestors]


def _indices(values: Sequence[int], like: Tensor) -> Tensor:
    return torch.tensor(list(values), dtype=torch.int32, device=like.device)


def _checked(parents: Sequence[int], count: int, shape: tuple[int, ...]) -> list[int]:
    """Return the parents with ``count`` for none."""
    where = "skinning_transforms, parents"
    if len(parents) != count or shape != (count, 3):
        what = f"{count} turns, {len(parents)} parents and joints of shape {list(shape)}"
        raise GeneratorInvalid(f"{what} do not fit each other", where=where)
    for joint, parent in enumerate(parents):
        if parent not in (-1, _NO_PARENT) and not 0 <= parent < count:
            what = f"joint {joint} has parent {parent}, wanted -1 to {count - 1}"
            raise GeneratorInvalid(what, where=where)
    known = [count if one in (-1, _NO_PARENT) else int(one) for one in parents]
    for joint in range(count):
        steps, at = 0, joint
        while at != count:
            at, steps = known[at], steps + 1
            if steps > count:
                raise GeneratorInvalid(f"joint {joint} is its own ancestor", where=where)
    return known
