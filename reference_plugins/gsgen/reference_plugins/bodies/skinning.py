"""Gaussians that follow joints, for K bodies at once, in forms that survive export and capture.

Numbers lie in planes, [K, …, N]: every step is a kernel over contiguous memory, and the weights of
linear blend skinning are multiplied once for all bodies. A body's own rotation and place are part
of the transforms of its joints, so they cost nothing for each Gaussian.
"""

__all__ = [
    "applied",
    "blended",
    "chained",
    "covariance",
    "multiplied",
    "repeated",
    "rows_of",
]

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.sdk.math import skinning_transforms

_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def chained(
    turns: Float[Tensor, "k j 3 3"],
    joints: Float[Tensor, "j 3"],
    parents: Sequence[int],
    turn: Float[Tensor, "k 3 3"] | None,
    shift: Float[Tensor, "k 3"],
) -> Float[Tensor, "k j 3 4"]:
    """Return the transforms of all joints, the body's own rotation and place after them.

    Args:
        turns: Of each joint in its parent's frame.
        joints: At rest; the same for all bodies.
        parents: −1 for the root.
        turn: Rotation of each body; none if its root joint's is all.
        shift: Where each body is moved.
    """
    bodies, count = turns.shape[:2]
    # Many bodies are one forest: their chains are joined in the same rounds.
    forest = [p if p < 0 else p + count * body for body in range(bodies) for p in parents]
    rest = joints if bodies == 1 else torch.cat([joints] * bodies, dim=0)
    made = skinning_transforms(turns.reshape(-1, 3, 3), rest, forest)
    made = made.reshape(bodies, count, 3, 4)
    if turn is not None:
        made = turn[:, None] @ made
    place = made[:, :, :, 3:] + shift[:, None, :, None]
    return torch.cat([made[:, :, :, :3], place], dim=3)


def blended(
    transforms: Float[Tensor, "k j 3 4"], weights: Float[Tensor, "j n"]
) -> Float[Tensor, "k 3 4 n"]:
    """Return each Gaussian's mean of the transforms that it hangs on."""
    bodies, joints = transforms.shape[:2]
    flat = transforms.reshape(bodies, joints, 12).transpose(1, 2)
    return (flat @ weights).reshape(bodies, 3, 4, -1)


def applied(
    transform: Float[Tensor, "k 3 4 n"], point: Float[Tensor, "*k 3 n"]
) -> Float[Tensor, "k 3 n"]:
    """Move points."""
    made = transform[:, :, 3]
    for axis in range(3):
        made = made + transform[:, :, axis] * point[:, axis : axis + 1]
    return made


def multiplied(
    left: Float[Tensor, "k 3 c n"], right: Float[Tensor, "*k 3 3 n"]
) -> Float[Tensor, "k 3 3 n"]:
    """Multiply 3×3 matrices; further columns of ``left`` are passed over."""
    made = left[:, :, 0:1] * right[:, 0:1]
    for axis in (1, 2):
        made = made + left[:, :, axis : axis + 1] * right[:, axis : axis + 1]
    return made


def covariance(root: Float[Tensor, "k 3 3 n"]) -> Float[Tensor, "k 6 n"]:
    """Return xx, xy, xz, yy, yz, zz of M Mᵀ."""
    rows = root.unbind(dim=1)
    return torch.stack([(rows[a] * rows[b]).sum(dim=1) for a, b in _PAIRS], dim=1)


def rows_of(planes: Float[Tensor, "k c n"]) -> Float[Tensor, "m c"]:
    """Turn planes into rows, body after body."""
    return planes.transpose(1, 2).reshape(-1, planes.shape[1])


def repeated(rows: Float[Tensor, "n ..."], bodies: int) -> Float[Tensor, "m ..."]:
    """Say the same of every body; it is stored once."""
    return rows if bodies == 1 else torch.cat([rows] * bodies, dim=0)
