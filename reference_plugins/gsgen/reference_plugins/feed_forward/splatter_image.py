"""Splatter Image: a U-Net predicts one Gaussian for each pixel (Szymanowicz et al. 2024, section 3).

A pixel's Gaussian lies on its ray at a predicted depth, moved by a predicted offset (equation 4);
its parameters are in the frame of the picture's camera, and are turned into the world here.
"""

__all__ = ["SplatterImage"]

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.feed_forward.splatter_image_checkpoint import SplatterImageCheckpoint
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import quaternion_to_matrix, upper_triangle

_MAX_PERIOD = 10000.0
# Harmonics of degree 1 are, but for the order and signs of their axes, a vector: −y, z, −x.
_VECTOR_OF_HARMONICS = ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


class SplatterImage(GaussianGenerator):
    """Gaussians of one object, one for each pixel of its pictures."""

    family = "feed-forward"
    head_weight: Tensor
    head_bias: Tensor
    rays: Tensor
    axes: Tensor
    frequencies: Tensor

    def __init__(self, checkpoint: SplatterImageCheckpoint) -> None:
        super().__init__()
        options = checkpoint.options
        self.options, self.unet = options, checkpoint.unet
        self.smaller = ()
        background = (1.0, 1.0, 1.0) if options.is_on_white else None
        side = options.resolution
        declared: list[Input] = [
            inputs.images(options.pictures, (side, side), background=background),
            inputs.image_views(options.pictures),
        ]
        if options.has_measured_lens:
            focal = float(side)
            lens = (focal, focal, side / 2, side / 2)
            declared.append(inputs.image_intrinsics(options.pictures, default=lens))
        self.inputs = tuple(declared)
        weight, bias = checkpoint.head
        self.register_buffer("head_weight", weight)
        self.register_buffer("head_bias", bias)
        self.register_buffer("rays", checkpoint.rays)
        self.register_buffer("axes", torch.tensor(_VECTOR_OF_HARMONICS))
        frequencies = torch.arange(options.pose_frequencies // 2) / max(
            options.pose_frequencies // 2, 1
        )
        self.register_buffer("frequencies", _MAX_PERIOD**-frequencies)

    def forward(
        self,
        image: Float[Tensor, "v 3 h w"],
        image_view: Float[Tensor, "v 4 4"],
        image_intrinsics: Float[Tensor, "v 3 3"] | None = None,
    ) -> Gaussians:
        """Return the Gaussians of all pixels, in the space of the cameras."""
        # Step 1: the tensor holds the transposed view, so its block turns camera axes into the world.
        to_world = image_view[:, :3, :3]
        center = -(to_world @ image_view[:, 3, :3, None])[:, :, 0]
        # Step 2: the network, and its last layer.
        features = self.unet(image, self._camera_code(to_world, center))
        features = functional.conv2d(features, self.head_weight, self.head_bias)
        channels = list(self.options.channels)
        parts = torch.split(features.flatten(2).transpose(1, 2), channels, dim=2)
        depth, *offset, opacity, log_scale, rotation, constant = parts[
            : 6 if self.options.has_offset else 5
        ]
        # Step 3: centres along the rays, then in the world.
        low, high = self.options.depth_range
        depth = torch.sigmoid(depth) * (high - low) + low
        if self.options.adds_distance:
            depth = depth - (center[:, None] @ to_world[:, :, 2:])  # to the origin, along the axis
        local = self._rays(image_intrinsics) * depth
        local = local + offset[0] if offset else local
        position = local @ to_world.transpose(1, 2) + center[:, None]
        # Step 4: covariances, turned into the world.
        if self.options.is_isotropic:
            log_scale = log_scale[:, :, :1].expand(-1, -1, 3)
        axes = to_world[:, None] @ quaternion_to_matrix(rotation)
        spread = axes * torch.exp(log_scale)[:, :, None]
        covariance = upper_triangle((spread @ spread.transpose(2, 3)).flatten(0, 1))
        # Step 5: colours; harmonics of degree 1 turn as vectors do.
        sh = constant[:, :, None]
        if self.options.degree:
            rest = torch.unflatten(parts[-1], 2, (3, 3))  # harmonics, then red, green and blue
            turn = self.axes.T @ to_world.transpose(1, 2) @ self.axes
            sh = torch.cat([sh, turn.transpose(1, 2)[:, None] @ rest], dim=2)
        return Gaussians(
            position.flatten(0, 1),
            torch.sigmoid(opacity).flatten(0, 1),
            covariance=covariance,
            sh=sh.flatten(0, 1),
        )

    def _rays(self, intrinsics: Float[Tensor, "v 3 3"] | None) -> Float[Tensor, "v n 3"]:
        """Return the ray of each pixel at depth 1, in the frame of its camera."""
        rays = self.rays.flatten(2).transpose(1, 2)
        if intrinsics is None:
            return rays
        focal = torch.stack([intrinsics[:, 0, 0], intrinsics[:, 1, 1]], dim=1)
        pixels = rays[:, :, :2] / focal.clamp_min(1e-3)[:, None]
        return torch.cat([pixels, rays[:, :, 2:].expand(pixels.shape[0], -1, -1)], dim=2)

    def _camera_code(
        self, to_world: Float[Tensor, "v 3 3"], center: Float[Tensor, "v 3"]
    ) -> Float[Tensor, "v e"] | None:
        """Return the encoded pose of each camera in the frame of the first one."""
        if not self.options.pose_frequencies:
            return None
        first = to_world[:1]
        relative_center = (center - center[:1])[:, None] @ first
        axis = to_world[:, None, :, 2] @ first
        pose = torch.cat([relative_center, axis], dim=2)[:, 0]
        angles = pose[:, :, None] * self.frequencies
        # The network exchanges the two halves of the whole code, so the last three numbers lead.
        code = torch.cat([torch.cos(angles), torch.sin(angles)], dim=2).flatten(1)
        return torch.cat([code[:, code.shape[1] // 2 :], code[:, : code.shape[1] // 2]], dim=1)
