"""LGM: a U-Net turns four pictures around an object into Gaussians (Tang et al. 2024, section 3.3).

The pictures are seen from azimuths 0°, 90°, 180° and 270°, at elevation 0°. Each pixel comes with
the Plücker coordinates of its ray, so that the network knows the cameras.
"""

__all__ = ["Lgm", "plucker_rays"]

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gsgen.contract.spec.manifest import Space
from gsgen.reference_plugins.feed_forward.lgm_checkpoint import LgmCheckpoint
from gsgen.reference_plugins.feed_forward.multi_view_unet import PICTURES
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import safe_normalize

_FIELD_OF_VIEW = 49.1  # degrees
_CAMERA_DISTANCE = 1.5
# Mean and deviation of colours in ImageNet, by which pictures are normalised.
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_LARGEST_SCALE_SLOPE = 0.1
_WHITE = (1.0, 1.0, 1.0)


class Lgm(GaussianGenerator):
    """Gaussians of one object, one for each pixel of the network's output."""

    family = "feed-forward"
    space = Space(up="+y")
    head_weight: Tensor
    head_bias: Tensor
    rays: Tensor
    mean: Tensor
    deviation: Tensor

    def __init__(self, checkpoint: LgmCheckpoint, side: int = 256) -> None:
        super().__init__()
        self.unet = checkpoint.unet
        self.inputs = (inputs.images(PICTURES, (side, side), background=_WHITE),)
        weight, bias = checkpoint.head
        self.register_buffer("head_weight", weight)
        self.register_buffer("head_bias", bias)
        self.register_buffer("rays", plucker_rays(side))
        self.register_buffer("mean", torch.tensor(_MEAN)[:, None, None])
        self.register_buffer("deviation", torch.tensor(_DEVIATION)[:, None, None])

    def forward(self, image: Float[Tensor, "4 3 h w"]) -> Gaussians:
        """Return the Gaussians of all pixels; the object lies within ±1."""
        # Step 1: normalised colours and rays.
        colors = (image - self.mean) / self.deviation
        features = self.unet(torch.cat([colors, self.rays], dim=1))
        features = functional.conv2d(features, self.head_weight, self.head_bias)
        # Step 2: a Gaussian for each pixel, picture after picture, row after row.
        rows = features.flatten(2).transpose(1, 2).flatten(0, 1)
        position, opacity, scale, rotation, color = torch.split(rows, [3, 1, 3, 4, 3], dim=1)
        return Gaussians(
            position.clamp(-1.0, 1.0),
            torch.sigmoid(opacity),
            _LARGEST_SCALE_SLOPE * functional.softplus(scale),
            safe_normalize(rotation),
            rgb=0.5 * torch.tanh(color) + 0.5,
        )


def plucker_rays(side: int) -> Float[Tensor, "4 6 h w"]:
    """Return moment and direction of each pixel's ray, in a world whose y points up.

    The rays of a pixel are those of cameras that look at the origin; y of a picture points down.
    """
    focal = side / 2 / math.tan(math.radians(_FIELD_OF_VIEW) / 2)
    steps = (torch.arange(side, dtype=torch.float64) + 0.5 - side / 2) / focal
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    local = torch.stack([x, -y, -torch.ones_like(x)], dim=-1)  # x right, y up, z backwards
    rays = []
    for number in range(PICTURES):
        azimuth = math.radians(360 * number / PICTURES)
        backward = torch.tensor([math.sin(azimuth), 0.0, math.cos(azimuth)], dtype=torch.float64)
        right = torch.tensor([math.cos(azimuth), 0.0, -math.sin(azimuth)], dtype=torch.float64)
        up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
        direction = functional.normalize(local @ torch.stack([right, up, backward]), dim=-1)
        origin = (_CAMERA_DISTANCE * backward).expand_as(direction)
        moment = torch.linalg.cross(origin, direction)
        rays.append(torch.cat([moment, direction], dim=-1).permute(2, 0, 1))
    return torch.stack(rays).to(torch.float32)
