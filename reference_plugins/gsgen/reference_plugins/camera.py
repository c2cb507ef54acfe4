"""Where the camera stands, from the matrix that every generator is given."""

__all__ = ["camera_centre", "directions"]

import torch
from jaxtyping import Float
from torch import Tensor

# Guards for what runtimes feed before they know better: all zeros, and a camera on an anchor.
_SMALLEST_SCALE = 1e-12
_SMALLEST_SQUARE = 1e-12


def camera_centre(camera: Float[Tensor, "4 4"]) -> Float[Tensor, "1 3"]:
    """Return the camera's centre in the generator's local space.

    Args:
        camera: World→camera in the memory order ``column``: the tensor holds Mᵀ, so that a row
            vector p goes to p A + t with A = camera[:3, :3] and t = camera[3, :3].

    The rows of A have length s where the model was scaled by s, and the centre is −t Aᵀ / s².
    """
    turn, shift = camera[:3, :3], camera[3:4, :3]
    square = (turn * turn).sum().reshape(1, 1) / 3
    return -(shift @ turn.transpose(0, 1)) / square.clamp(min=_SMALLEST_SCALE)


def directions(
    position: Float[Tensor, "n 3"], centre: Float[Tensor, "1 3"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 1"]]:
    """Return unit vectors from the camera to ``position``, and the distances."""
    offset = position - centre
    square = (offset * offset).sum(dim=1, keepdim=True)
    distance = torch.sqrt(square.clamp(min=_SMALLEST_SQUARE))
    return offset / distance, distance
