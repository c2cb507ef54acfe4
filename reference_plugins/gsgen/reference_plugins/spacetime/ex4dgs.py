"""Ex4DGS: Gaussians that are interpolated between key frames, among others that only drift.

Lee et al. 2024, "Fully Explicit Dynamic Gaussian Splatting", sections 4.1 to 4.3: centres follow a
cubic Hermite spline, rotations a spherical interpolation, and the opacity rises to and falls from a
plateau.
"""

__all__ = ["Ex4DGS"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.spacetime.ex4dgs_checkpoint import (
    DriftingSplats,
    Ex4DGSCheckpoint,
    KeyFrameSplats,
    KeyFrameTimes,
)
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stack_planes
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import safe_normalize

# The published code bounds the cosine of the angle between key frames by 1 minus this, and takes
# the first rotation where the sum of an interpolated quaternion's parts is smaller.
_MIN_DIFFERENCE = 1e-4
# The opacity jumps at a moment, which is a whole number of these ticks, as precise as float32: no
# form of the model rounds whole numbers.
_TICKS = 1 << 23
_MAX_TICK = 1 << 30


@final
class Ex4DGS(GaussianGenerator):
    """Ex4DGS as a generator model: drifting Gaussians, then those with key frames."""

    family = "4d"
    count_semantics = "upper-bound"
    # Its rasteriser widens Gaussians by 0.1 pixels², and fades them as much.
    antialias = "mip"

    origin: Tensor
    drift: Tensor
    drifting_opacity: Tensor
    drifting_covariance: Tensor
    key_position: Tensor
    key_rotation: Tensor
    key_angle: Tensor
    steps: Tensor
    scale: Tensor
    opacity: Tensor
    first_tick: Tensor
    visible_to: Tensor
    rising: Tensor
    falling: Tensor
    sh: Tensor

    def __init__(self, read: Ex4DGSCheckpoint, time: Input | None = None) -> None:
        super().__init__()
        self.inputs = (time or inputs.time(),)
        times = read.times
        self.interpolation = times.interpolation
        self.rate = times.last_frame / times.interval  # key frames from time 0 to 1
        self.first_key = times.shift / times.interval  # at time 0
        # The earliest and the latest key frame that can be the one before a moment.
        first, last = times.needed
        self.bounds = (float(-first), float(read.moving.position.shape[1] - 1 - last))
        self.register_buffer("steps", torch.arange(first, last + 1, dtype=torch.int32))
        constants = (
            _drifting_constants(read.drifting, times)
            | _motion_constants(read.moving)
            | _opacity_constants(read.moving, times)
        )
        for name, value in constants.items():
            number = value.float() if value.is_floating_point() else value
            self.register_buffer(name, number.contiguous())
        self.register_buffer("sh", torch.cat([read.drifting.sh, read.moving.sh]))

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the Gaussians at a time, from 0 to 1: the first frame and the last."""
        moment = time.reshape(1, 1)
        key_time = moment * self.rate + self.first_key
        key = torch.floor(key_time).clamp(*self.bounds)
        share = key_time - key
        index = key.reshape(1).to(torch.int32)
        centres = torch.cat(
            [self.origin + moment * self.drift, self._positions(index, share)], dim=1
        )
        covariance = stack_planes(
            covariance_planes(planes_of(self.scale), self._rotations(index, share))
        )
        return Gaussians(
            position=centres.transpose(0, 1),
            opacity=torch.cat([self.drifting_opacity, self._opacities(moment)]),
            covariance=torch.cat([self.drifting_covariance, covariance]),
            sh=self.sh,
        )

    def _positions(self, index: Tensor, share: Tensor) -> Float[Tensor, "3 m"]:
        """Interpolate centres between the key frames around a moment."""
        keys = self.key_position.index_select(0, index + self.steps)
        if self.interpolation == "linear":
            start, end = keys.unbind(0)
            return start * (1 - share) + end * share
        before, start, end, after = keys.unbind(0)
        if self.interpolation == "pchip":
            start_slope = _monotone_slope(start - before, end - start)
            end_slope = _monotone_slope(end - start, after - end)
        else:
            start_slope, end_slope = (end - before) / 2, (after - start) / 2
        # The cubic that has these values and slopes at its ends (Hermite).
        change = end - start
        quadratic = 3 * change - 2 * start_slope - end_slope
        cubic = start_slope + end_slope - 2 * change
        return start + share * (start_slope + share * (quadratic + share * cubic))

    def _rotations(self, index: Tensor, share: Tensor) -> list[Tensor]:
        """Interpolate quaternions between key frames on the sphere, not normalised."""
        start = self.key_rotation.index_select(0, index)[0]
        end = self.key_rotation.index_select(0, index + 1)[0]
        angle = self.key_angle.index_select(0, index)
        start_weight, end_weight = torch.sin((1 - share) * angle), torch.sin(share * angle)
        total = start_weight + end_weight  # not zero: angles are between 0 and π
        rotation = start * (start_weight / total) + end * (end_weight / total)
        # Halfway between opposite quaternions there is none.
        size = rotation.abs().sum(dim=0, keepdim=True)
        rotation = torch.where(size > _MIN_DIFFERENCE, rotation, start)
        return planes_of(rotation.transpose(0, 1))

    def _opacities(self, moment: Tensor) -> Float[Tensor, "m 1"]:
        is_started = (moment * _TICKS).to(torch.int32) > self.first_tick
        since_end = moment - self.visible_to
        # Before the start, too, the method measures the distance from the end.
        distance = since_end * torch.where(is_started, self.falling, self.rising)
        factor = torch.exp(-(distance * distance))
        is_between = is_started & (since_end < 0)
        return self.opacity * torch.where(is_between, torch.ones_like(factor), factor)


def _monotone_slope(left: Tensor, right: Tensor) -> Tensor:
    """Return the harmonic mean of two differences, or 0 if they have different signs."""
    product = left * right
    is_monotone = product > 0
    total = torch.where(is_monotone, left + right, torch.ones_like(product))
    return torch.where(is_monotone, 2 * product / total, torch.zeros_like(product))


def _drifting_constants(splats: DriftingSplats, times: KeyFrameTimes) -> dict[str, Tensor]:
    # The rasteriser does not normalise the quaternions, and neither does the code before it.
    covariance = covariance_planes(
        planes_of(torch.exp(splats.log_scale.double())),
        planes_of(splats.rotation.double()),
        normalise=False,
    )
    drift = splats.drift.double() * (times.last_frame / times.drift_duration)
    return {
        "origin": splats.position.t(),
        "drift": drift.t(),
        "drifting_opacity": torch.sigmoid(splats.logit_opacity.double()),
        "drifting_covariance": stack_planes(covariance),
    }


def _motion_constants(splats: KeyFrameSplats) -> dict[str, Tensor]:
    rotation = safe_normalize(splats.rotation.double())
    cosine = (rotation[:, :-1] * rotation[:, 1:]).sum(dim=2)
    cosine = cosine.clamp(_MIN_DIFFERENCE - 1, 1 - _MIN_DIFFERENCE)
    return {
        # Key frames come first, then planes: what a moment needs is contiguous.
        "key_position": splats.position.permute(1, 2, 0),
        "key_rotation": rotation.permute(1, 2, 0),
        "key_angle": torch.acos(cosine).t(),
        "scale": torch.exp(splats.log_scale.double()),
    }


def _opacity_constants(splats: KeyFrameSplats, times: KeyFrameTimes) -> dict[str, Tensor]:
    """Return the plateau of the opacity, with its ends as times from 0 to 1."""
    ends = (splats.visible.double() * times.interval - times.shift) / times.last_frame
    width = torch.exp(splats.log_width.double()) + times.min_width
    rate = times.last_frame / times.interval / width
    first_tick = torch.floor(ends.amin(dim=1, keepdim=True) * _TICKS)
    return {
        "opacity": torch.sigmoid(splats.logit_opacity.double()),
        "first_tick": first_tick.clamp(-_MAX_TICK, _MAX_TICK).int(),
        "visible_to": ends.amax(dim=1, keepdim=True),
        "rising": rate[:, :1],
        "falling": rate[:, 1:],
    }
