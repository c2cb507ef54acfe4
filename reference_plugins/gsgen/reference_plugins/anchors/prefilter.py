"""Selects anchors as Scaffold-GS's own renderer does: only those with an ellipsoid in view.

Scaffold-GS and Octree-GS skip anchors before they decode any (``prefilter_voxel``; the test is
that of the rasteriser of 3DGS, ``forward.cu``). A skipped anchor may have Gaussians that reach into
view, so pictures with and without the filter differ slightly.
"""

__all__ = ["Prefilter"]

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud
from gsgen.reference_plugins.tensors.baked_constants import Constants
from gsgen.reference_plugins.tensors.planes import planes_of, rotation_columns
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.scene.camera import DEFAULT_DILATION

_NEAR_DEPTH = 0.2
# The slope beyond which the projection is linearised at the edge of the image.
_FRUSTUM_GUARD_BAND = 1.3
_MIN_SPREAD = 0.1


class _Axes(nn.Module):
    """Computes the axes of the anchors' ellipsoids, one standard deviation long."""

    reach: Tensor
    rotation: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        self.register_buffer("reach", torch.exp(cloud.log_scale[:, :3]))
        self.register_buffer("rotation", cloud.rotation)

    def forward(self) -> tuple[Float[Tensor, "n 3 3"]]:
        columns = rotation_columns(planes_of(self.rotation))
        turn = torch.stack([torch.cat(column) for column in columns], dim=1)
        return ((turn * self.reach.transpose(0, 1)[None]).permute(2, 0, 1),)


class Prefilter(nn.Module):
    """Tests whether each anchor's ellipsoid is in the image, for a centred principal point."""

    takes = ("projection", "viewport")

    anchor: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        self.register_buffer("anchor", cloud.position)
        self.axes = Constants(_Axes(cloud))

    def forward(
        self, camera: Float[Tensor, "4 4"], proj: Float[Tensor, "4 4"], viewport: Float[Tensor, "2"]
    ) -> Float[Tensor, "n 1"]:
        """Return 1 for anchors whose ellipsoid touches the image, and 0 for others.

        ``camera`` is world→camera in column order; of ``proj``, camera→clip, only the two focal
        lengths are read; ``viewport`` is in pixels.
        """
        position = self.anchor @ camera[:3, :3] + camera[3:4, :3]
        depth = position[:, 2:3]
        slope = position[:, :2] / depth.clamp(min=_NEAR_DEPTH)
        focal = torch.cat([proj[0, 0:1], proj[1, 1:2]]).abs().reshape(1, 2)
        pixel = ((slope * focal + 1) * viewport.reshape(1, 2) - 1) * 0.5
        radius = self._screen_radius(slope, depth, focal, viewport, camera[:3, :3])
        viewport_end = torch.ceil(viewport.reshape(1, 2) / TILE) * TILE
        # An image without pixels, or a focal length of 0, shows no anchor.
        usable_mask = (viewport_end > 0).float() * (focal > 0).float()
        is_visible = (
            (pixel + radius >= 1).float() * (pixel - radius < viewport_end).float() * usable_mask
        )
        return is_visible[:, 0:1] * is_visible[:, 1:2] * (depth > _NEAR_DEPTH).float()

    def _screen_radius(
        self, slope: Tensor, depth: Tensor, focal: Tensor, viewport: Tensor, turn: Tensor
    ) -> Tensor:
        """Return three standard deviations of the projected ellipse, rounded up to pixels."""
        slope_limit = _FRUSTUM_GUARD_BAND / focal.clamp(min=1e-6)
        clamped_slope = torch.minimum(torch.maximum(slope, -slope_limit), slope_limit)
        pixels = 0.5 * focal * viewport.reshape(1, 2) / depth.clamp(min=_NEAR_DEPTH)
        zero = torch.zeros_like(depth)
        x_axis = torch.cat([pixels[:, 0:1], zero, -pixels[:, 0:1] * clamped_slope[:, 0:1]], dim=1)
        y_axis = torch.cat([zero, pixels[:, 1:2], -pixels[:, 1:2] * clamped_slope[:, 1:2]], dim=1)
        u, v = (
            self._extent_along_direction(x_axis, turn),
            self._extent_along_direction(y_axis, turn),
        )
        a = (u * u).sum(dim=1, keepdim=True) + DEFAULT_DILATION
        b = (u * v).sum(dim=1, keepdim=True)
        c = (v * v).sum(dim=1, keepdim=True) + DEFAULT_DILATION
        mean_eigenvalue = 0.5 * (a + c)
        eigenvalue_spread = (mean_eigenvalue * mean_eigenvalue - (a * c - b * b)).clamp(
            min=_MIN_SPREAD
        )
        return torch.ceil(3 * torch.sqrt(mean_eigenvalue + torch.sqrt(eigenvalue_spread)))

    def _extent_along_direction(self, direction: Tensor, turn: Tensor) -> Tensor:
        """Return the component of each ellipsoid axis along a direction in camera space."""
        local_direction = direction @ turn.transpose(0, 1)
        (root,) = self.axes()
        reach: Tensor = (root * local_direction[:, :, None]).sum(dim=1)
        return reach
