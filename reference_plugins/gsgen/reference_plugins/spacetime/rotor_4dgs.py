"""Rotor 4DGS: Gaussians in space and time; each frame is a slice of them at one time.

Yang et al. 2024, "Real-time Photorealistic Dynamic Scene Representation and Rendering with 4D
Gaussian Splatting", equations 5 to 9. A 4-D covariance Σ, of two unit quaternions and four scales,
is conditioned on the time: the centre moves at constant speed, the shape is constant, and the
opacity follows the Gaussian of time. Colours are SH whose coefficients are cosine series of time.
"""

__all__ = ["Rotor4DGS", "TimeSlices", "slices_of"]

import math
from dataclasses import dataclass
from typing import Literal, final

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.spacetime.rotor_checkpoint import RotorSplats
from gsgen.reference_plugins.tensors.harmonics import harmonic_sum, max_brightness
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import camera_centre, covariance_upper, safe_normalize, upper_triangle

# Gaussians of a smaller factor of time are not drawn (its rasteriser's condition).
_MIN_TIME_WEIGHT = 0.05
# 1 / variance is at most this, so that its product with a squared time is finite in float32.
_MAX_RATE = 1e30


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSlices:
    """Constants (float64) that give the 3-D slices of N 4-D Gaussians at times from 0 to 1."""

    velocity: Float[Tensor, "n 3"]  # movement of the centre
    covariance: Float[Tensor, "n 6"]  # xx xy xz yy yz zz of each slice
    variance: Float[Tensor, "n 1"]  # variance in time
    centre: Float[Tensor, "n 1"]  # temporal centre


def slices_of(splats: RotorSplats, duration: tuple[float, float]) -> TimeSlices:
    """Condition 4-D Gaussians on time, which is scaled from ``duration`` to 0 … 1."""
    start, length = duration[0], duration[1] - duration[0]
    centre = (splats.temporal_centre.double() - start) / length
    scale = torch.exp(splats.log_scale.double())
    temporal_scale = torch.exp(splats.log_temporal_scale.double())
    if splats.right_rotation is None:  # the published code takes the scale of time for a variance
        covariance = covariance_upper(scale, splats.rotation.double())
        zero_scale = torch.zeros_like(scale)
        return TimeSlices(
            velocity=zero_scale,
            covariance=covariance,
            variance=temporal_scale / length**2,
            centre=centre,
        )
    left_matrices = _left_product(_unit_quaternion(splats.rotation))
    # The product x ↦ x r̄ is the transpose of x ↦ x r.
    right_matrices = _right_product(_unit_quaternion(splats.right_rotation)).transpose(1, 2)
    # Quaternions count time, z, y, x; Gaussians x, y, z, time.
    rotation = (left_matrices @ right_matrices).flip(1, 2)
    root = rotation * torch.cat([scale, temporal_scale], dim=1)[:, None]
    whole = root @ root.transpose(1, 2)
    variance = whole[:, 3:, 3]
    velocity = whole[:, :3, 3] / variance
    covariance = whole[:, :3, :3] - variance[:, :, None] * velocity[:, :, None] * velocity[:, None]
    return TimeSlices(
        velocity=velocity * length,
        covariance=upper_triangle(covariance),
        variance=variance / length**2,
        centre=centre,
    )


def _unit_quaternion(quaternion: Tensor) -> Tensor:
    return torch.nn.functional.normalize(quaternion.double(), dim=1)


def _left_product(quaternion: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4 4"]:
    """Return the 4×4 matrices of quaternion products x ↦ q x."""
    a, b, c, d = quaternion.unbind(1)
    rows = ((a, -b, -c, -d), (b, a, -d, c), (c, d, a, -b), (d, -c, b, a))
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def _right_product(quaternion: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4 4"]:
    """Return the 4×4 matrices of quaternion products x ↦ x q."""
    a, b, c, d = quaternion.unbind(1)
    rows = ((a, -b, -c, -d), (b, a, d, -c), (c, -d, a, b), (d, c, -b, a))
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


@final
class Rotor4DGS(GaussianGenerator):
    """Rotor 4DGS as a generator model of 3-D slices of space-time Gaussians at a given time.

    ``color`` is ``sh`` for coefficients, which renderers evaluate towards the moved centre, or
    ``rgb`` for the method's colours, towards the stored centre, which need the camera.
    """

    family = "4d"
    count_semantics = "upper-bound"
    smaller = ("--color rgb", "--dtype float16")

    position: Tensor
    velocity: Tensor
    covariance: Tensor
    opacity: Tensor
    centre: Tensor
    half_angular_rate: Tensor
    reach: Tensor
    sh: Tensor
    changing_sh: Tensor

    def __init__(
        self,
        splats: RotorSplats,
        duration: tuple[float, float],
        time: Input | None = None,
        *,
        prefilter: float = 0.0,
        color: Literal["sh", "rgb"] = "sh",
    ) -> None:
        """Compute the constants that give the 3-D slices of 4-D Gaussians at any time.

        Args:
            splats: The 4-D Gaussians.
            duration: Times of the first and the last frame, in the unit of the checkpoint.
            time: Declaration of the input.
            prefilter: Variance that is added in time (``prefilter_var`` of the training).
            color: Colours to emit.
        """
        super().__init__()
        moment = time or inputs.time()
        self.inputs = (moment,) if color == "sh" else (moment, inputs.view())
        slices = slices_of(splats, duration)
        variance = slices.variance + max(prefilter, 0.0) / (duration[1] - duration[0]) ** 2
        constants = {
            "position": splats.position,
            "velocity": slices.velocity,
            "covariance": slices.covariance,
            "opacity": torch.sigmoid(splats.logit_opacity),
            "centre": slices.centre,
            "half_angular_rate": (0.5 / variance).clamp(max=_MAX_RATE),
            "reach": torch.sqrt(-2 * math.log(_MIN_TIME_WEIGHT) * variance),
            "sh": splats.sh,
            "changing_sh": splats.changing_sh,
        }
        for name, value in constants.items():
            self.register_buffer(name, value.float())
        if color == "rgb":
            largest = splats.sh.abs()
            if splats.changing_sh.shape[1]:
                largest = largest + splats.changing_sh.abs().sum(dim=1)
            self.color_range = (0.0, max_brightness(largest))

    def forward(self, time: Float[Tensor, "1"], camera: Tensor | None = None) -> Gaussians:
        """Return the Gaussians at a time, from 0 to 1, with the colours that a camera sees."""
        time_offset = time.reshape(1, 1) - self.centre
        # A comparison of times, not of factors: a difference is exact on every machine.
        is_drawn = (time_offset.abs() < self.reach).to(time_offset.dtype)
        opacity = (
            self.opacity
            * torch.exp(-self.half_angular_rate * (time_offset * time_offset))
            * is_drawn
        )
        sh = self.sh
        for index in range(self.changing_sh.shape[1]):
            phase = torch.cos(2 * math.pi * (index + 1) * time_offset)
            sh = sh + phase[:, :, None] * self.changing_sh[:, index]
        position = self.position + time_offset * self.velocity
        covariance = self.covariance
        if camera is None:
            return Gaussians(position=position, opacity=opacity, covariance=covariance, sh=sh)
        direction = safe_normalize(self.position - camera_centre(camera)[None])
        rgb = torch.relu(0.5 + harmonic_sum(sh.unbind(1), direction))
        return Gaussians(position=position, opacity=opacity, covariance=covariance, rgb=rgb)
